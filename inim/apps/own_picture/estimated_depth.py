"""Depth of a single photograph, estimated by a monocular network of `transformers`.

Some models return metres (ZoeDepth, Depth Pro, GLPN, the metric Depth Anything). Most return
inverse depth, larger for nearer objects, up to an unknown scale and shift (MiDaS, DPT, Depth
Anything). It becomes a relative distance from 1, near, to `FAR_OVER_NEAR`.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inim.apps.own_picture.depth_photo import DepthPhoto, read_photo_srgb
from inim.apps.own_picture.depth_values import DepthValues
from inim.system.errors import FileError, OutOfMemoryError, UsageError

#: Ratio of the farthest to the nearest relative distance.
FAR_OVER_NEAR = 4.0
# By `model_type` of the model's configuration, where that alone decides.
_RETURNS_METRES = {"zoedepth": True, "depth_pro": True, "glpn": True, "dpt": False}
_RETURNS_METRES |= {"prompt_depth_anything": True}
_MM_PER_METRE = np.float32(1000)


def estimate_photo(path: Path, model: str) -> DepthPhoto:
    """Read a photograph and estimate its depth.

    * `path`: a picture as for `inim.apps.own_picture.picture_files.read_color`, or HEIC.
    * `model`: folder of a depth-estimation model, or its name on huggingface.co.

    Raises `UsageError`: torch or transformers is not installed. `FileError`: the photograph or the
    model is missing, damaged or of another kind. `OutOfMemoryError`: too large a photograph.
    """
    color = read_photo_srgb(path)
    estimator = _load_model(model)
    has_unit = returns_metres(estimator.model.config, model)
    output = _predict(estimator, color, path, model)
    if has_unit:
        depth = np.where(output > 0, output * _MM_PER_METRE, np.float32(np.nan))
    else:
        depth = relative_distance(output)
    kind = "metres" if has_unit else "inverse depth, converted to relative distance"
    values = DepthValues(depth, near_is_large=False, has_unit=has_unit, step=0.0, warnings=())
    return DepthPhoto(color, values, None, (f"depth estimated by {model}: {kind}",))


@lru_cache(maxsize=1)
def _load_model(model: str) -> Any:
    """Load the `transformers` pipeline of a model."""
    try:
        import torch  # noqa: F401 (the pipeline's error message is a page long)
        from transformers import pipeline
    except ImportError as error:
        raise UsageError(
            f"--estimate-depth: needs torch and transformers ({error.name or error} is missing); "
            "pip install 'inim[depth]'"
        ) from error
    try:
        return pipeline("depth-estimation", model=model)
    except MemoryError:
        raise
    except Exception as error:
        raise FileError(
            f"--estimate-depth {model}: cannot be loaded ({_cause(error)}); give a folder with a "
            "depth-estimation model, or its name on huggingface.co while there is a network"
        ) from error


def returns_metres(config: Any, model: str) -> bool:
    """True if a model returns metres, by its configuration; otherwise it returns inverse depth.

    Raises `FileError` for an unknown kind of model.
    """
    stated = getattr(config, "depth_estimation_type", None)
    if stated in ("metric", "relative"):
        return bool(stated == "metric")
    kind = getattr(config, "model_type", None)
    if kind not in _RETURNS_METRES:
        raise FileError(
            f"--estimate-depth {model}: the output of {kind} models is unknown; use a model of the "
            f"kind depth_anything, {', '.join(sorted(_RETURNS_METRES))}"
        )
    return _RETURNS_METRES[kind]


def _predict(
    estimator: Any, color: NDArray[np.uint8], path: Path, model: str
) -> NDArray[np.float32]:
    """Output of the model for a photograph, (H, W) float32."""
    from PIL import Image

    try:
        output = estimator(Image.fromarray(color))["predicted_depth"]
        depth = np.squeeze(np.asarray(output.detach().cpu().float().numpy(), np.float32))
    except MemoryError as error:
        raise OutOfMemoryError(f"{path}: not enough memory; scale the picture down") from error
    except Exception as error:
        raise FileError(
            f"--estimate-depth {model}: failed on {path} ({_cause(error)}); try another"
        ) from error
    if depth.ndim != 2 or not np.isfinite(depth).all():
        raise FileError(
            f"--estimate-depth {model}: its output has the shape {depth.shape}, or values not "
            "finite; it is not a depth-estimation model, or damaged"
        )
    return depth


def relative_distance(inverse: NDArray[np.float32]) -> NDArray[np.float32]:
    """Convert inverse depth, known up to scale and shift, to distances from 1 to `FAR_OVER_NEAR`.

    The inverse depth is (H, W), larger for nearer objects. A flat one becomes 1.
    """
    low, high = float(inverse.min()), float(inverse.max())
    if high == low:
        return np.ones(inverse.shape, np.float32)
    share = (inverse.astype(np.float64) - low) / (high - low)
    least = 1 / FAR_OVER_NEAR
    distance: NDArray[np.float32] = (1 / (least + (1 - least) * share)).astype(np.float32)
    return distance


def _cause(error: Exception) -> str:
    """An error's message in one short line."""
    return " ".join(str(error).split())[:200] or type(error).__name__
