"""ColorVideoVDP: visible difference of an image, in just-objectionable differences (JOD).

A score of 10 means no difference; at one JOD less, three of four people prefer the other image.
The metric models human vision: contrast, colour, masking and, for videos, flicker. Its score
depends on the panel's luminance and on the viewing distance. The extra `perception` installs it.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Sequence
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np

from inim.errors import UsageError
from inim.metrics.base import Metric, Viewing

#: Distributions whose versions affect the scores.
PACKAGES = ("cvvdp", "torch")
_MODULE = "pycvvdp"
# A dark room: reflected light is part of the images, if the display has any.
_AMBIENT_LUX = 0
# Maximum of heat maps: the errors of a lens array are far above the visibility threshold.
_HEAT_MAP_JOD = 6.0
# Above this, no band of the model's pyramid has visible frequencies; a display never needs pixels
# below half a second of arc.
_MAX_PIXELS_PER_DEGREE = 5000.0
_THREAD = threading.local()


def is_installed() -> bool:
    """True if the package is installed; loading it on first use takes seconds."""
    return find_spec(_MODULE) is not None


def _model(viewing: Viewing, heat_map: str | None = None) -> Any:
    """Model for these conditions, one per thread because models store their filters."""
    if viewing.pixels_per_degree > _MAX_PIXELS_PER_DEGREE:
        raise UsageError(
            f"CVVDP: a view of {viewing.pixels_per_degree:.4g} pixels per degree is above the "
            f"model's limit of {_MAX_PIXELS_PER_DEGREE:g}; lower inim.view_pixels_per_lens or "
            "inim.viewing_distance_mm"
        )
    models = _THREAD.__dict__.setdefault("models", {})
    key = viewing, heat_map
    if key not in models:
        torch, pycvvdp = _packages()
        models[key] = pycvvdp.cvvdp(
            display_photometry=pycvvdp.vvdp_display_photo_eotf(
                viewing.luminance_cd_m2,
                contrast=viewing.contrast,
                source_colorspace="sRGB",
                E_ambient=_AMBIENT_LUX,
            ),
            # The resolution has no effect if pixels per degree are given.
            display_geometry=pycvvdp.vvdp_display_geometry((1, 1), ppd=viewing.pixels_per_degree),
            device=torch.device("cpu"),
            heatmap=heat_map,
            quiet=True,
        )
    return models[key]


@cache
def _packages() -> tuple[Any, Any]:
    # Suppress a warning about a missing CUDA compiler, which is not needed.
    logging.getLogger("torch.utils.cpp_extension").setLevel(logging.ERROR)
    try:
        import pycvvdp
        import torch
    except ImportError:
        raise UsageError("ColorVideoVDP is not installed: pip install 'inim[perception]'") from None
    # One thread per model, because views are scored in parallel.
    torch.set_num_threads(1)
    return torch, pycvvdp


def _predict(model: Any, test: np.ndarray, reference: np.ndarray, **options: Any) -> Any:
    """Apply a model to sRGB images, float32 in 0..1 or uint8."""
    torch, _ = _packages()
    with torch.no_grad():
        return model.predict(test, reference, **options)


def _jod(reference: np.ndarray, test: np.ndarray, viewing: Viewing) -> float:
    return float(_predict(_model(viewing), test, reference, dim_order="HWC")[0])


def _jod_loss(reference: np.ndarray, test: np.ndarray, viewing: Viewing) -> np.ndarray:
    """JOD lost at each pixel, (rows, columns)."""
    heat_map = _predict(_model(viewing, "raw"), test, reference, dim_order="HWC")[1]["heatmap"]
    loss: np.ndarray = 10 * heat_map[0, 0, 0].float().numpy()
    return loss


def film_jod(
    reference: Sequence[np.ndarray],
    test: Sequence[np.ndarray],
    viewing: Viewing,
    frames_per_second: float,
) -> float:
    """Score of a film, including flicker and jumps in time.

    Frames are (rows, columns, 3) uint8, sRGB. Raises `UsageError` if the package is not installed.
    """
    options = {"dim_order": "FHWC", "frames_per_second": frames_per_second}
    return float(_predict(_model(viewing), np.stack(test), np.stack(reference), **options)[0])


metric = Metric(
    "cvvdp",
    _jod,
    unit="JOD",
    digits=2,
    range=(-np.inf, 10.0),
    tolerance=0.05,  # about 3 of 100 people change their preference
    reference="Mantiuk, Hanji, Ashraf, Asano and Chapiro, ACM Trans. Graph. 43 (4), 2024",
    settings={
        "contrast": Viewing.contrast,
        "ambient_lux": _AMBIENT_LUX,
        "source_colorspace": "sRGB",
    },
    needs_viewing=True,
    is_slow=True,
    heat_map=_jod_loss,
    heat_map_max=_HEAT_MAP_JOD,
)
