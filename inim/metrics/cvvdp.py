"""ColorVideoVDP: how much worse a picture looks, in just-objectionable differences (JOD).

10 is no difference; one JOD less, and three of four people prefer the other one. A model of human
vision, of contrast, colour, masking and, in films, flicker; its score holds for the panel's
luminance and the distance from which it is seen. The extra `perception` installs it.
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

#: Distributions whose versions decide its scores.
PACKAGES = ("cvvdp", "torch")
_MODULE = "pycvvdp"
# Of a dark room and an ordinary panel. A display that reflects light, or glows, hides more.
_CONTRAST, _AMBIENT_LUX = 1000, 0
# Shown at most: what a lens array loses is far from what is just seen.
_HEAT_MAP_JOD = 6.0
# Where its pyramid has bands of frequencies that people see; a pixel finer than half a second of
# arc is nothing that a display is judged by.
_MOST_PIXELS_PER_DEGREE = 5000.0
_OWN = threading.local()


def is_installed() -> bool:
    """Whether the package is there; it is loaded when it is first needed, which takes seconds."""
    return find_spec(_MODULE) is not None


def _model(viewing: Viewing, heat_map: str | None = None) -> Any:
    """A model, one for each thread: it keeps what it filters with."""
    if viewing.pixels_per_degree > _MOST_PIXELS_PER_DEGREE:
        raise UsageError(
            f"CVVDP: a view of {viewing.pixels_per_degree:.4g} pixels per degree is finer than its "
            f"model goes, {_MOST_PIXELS_PER_DEGREE:g}; lower inim.view_pixels_per_lens or "
            "inim.viewing_distance_mm"
        )
    models = _OWN.__dict__.setdefault("models", {})
    key = viewing, heat_map
    if key not in models:
        torch, pycvvdp = _packages()
        models[key] = pycvvdp.cvvdp(
            display_photometry=pycvvdp.vvdp_display_photo_eotf(
                viewing.luminance_cd_m2,
                contrast=_CONTRAST,
                source_colorspace="sRGB",
                E_ambient=_AMBIENT_LUX,
            ),
            # The resolution plays no part where pixels per degree are given.
            display_geometry=pycvvdp.vvdp_display_geometry((1, 1), ppd=viewing.pixels_per_degree),
            device=torch.device("cpu"),
            heatmap=heat_map,
            quiet=True,
        )
    return models[key]


@cache
def _packages() -> tuple[Any, Any]:
    # It tells of a compiler for graphics cards that nobody asked for.
    logging.getLogger("torch.utils.cpp_extension").setLevel(logging.ERROR)
    try:
        import pycvvdp
        import torch
    except ImportError:
        raise UsageError("ColorVideoVDP is not installed: pip install 'inim[perception]'") from None
    # Scores do not depend on how many processors there are; views are scored side by side.
    torch.set_num_threads(1)
    return torch, pycvvdp


def _predicted(model: Any, test: np.ndarray, reference: np.ndarray, **how: Any) -> Any:
    """What a model says of sRGB, float32 in 0..1 or uint8."""
    torch, _ = _packages()
    with torch.no_grad():
        return model.predict(test, reference, **how)


def _jod(reference: np.ndarray, test: np.ndarray, viewing: Viewing) -> float:
    return float(_predicted(_model(viewing), test, reference, dim_order="HWC")[0])


def _lost(reference: np.ndarray, test: np.ndarray, viewing: Viewing) -> np.ndarray:
    """JOD lost at each pixel, (rows, columns)."""
    found = _predicted(_model(viewing, "raw"), test, reference, dim_order="HWC")[1]["heatmap"]
    lost: np.ndarray = 10 * found[0, 0, 0].float().numpy()
    return lost


def film_jod(
    reference: Sequence[np.ndarray],
    test: Sequence[np.ndarray],
    viewing: Viewing,
    frames_per_second: float,
) -> float:
    """Score of a film, in which flicker and jumps in time count.

    Parameters
    ----------
    reference, test : sequences of (rows, columns, 3) uint8, sRGB
        Frames.
    viewing : Viewing
    frames_per_second : float

    Raises
    ------
    UsageError
        The package is not installed.
    """
    frames = {"dim_order": "FHWC", "frames_per_second": frames_per_second}
    found = _predicted(_model(viewing), np.stack(test), np.stack(reference), **frames)
    return float(found[0])


metric = Metric(
    "cvvdp",
    _jod,
    unit="JOD",
    digits=2,
    range=(-np.inf, 10.0),
    tolerance=0.05,  # some 3 of 100 people change their mind
    reference="Mantiuk, Hanji, Ashraf, Asano and Chapiro, ACM Trans. Graph. 43 (4), 2024",
    settings={"contrast": _CONTRAST, "ambient_lux": _AMBIENT_LUX, "source_colorspace": "sRGB"},
    viewed=True,
    slow=True,
    heat_map=_lost,
    heat_map_to=_HEAT_MAP_JOD,
)
