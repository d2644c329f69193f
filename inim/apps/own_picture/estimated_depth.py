"""Depth of a single photograph, estimated by a monocular network of `transformers`.

Some models return metres (ZoeDepth, Depth Pro, GLPN, the metric Depth Anything). Most return
inverse depth, larger for nearer objects, up to an unknown scale and shift (MiDaS, DPT, Depth
Anything). It becomes a relative distance from 1, near, to `FAR_OVER_NEAR`.
"""

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
_RETURNS_METRES = {"zoedepth": True, "depth_pro": True, "glpn": True, "dpt": False} | {
    "prompt_depth_anything": True
}


def estimate_photo(path: Path, model: str) -> DepthPhoto:
    """Read a photograph and estimate its depth.

    * `path`: a picture as for `inim.apps.own_picture.picture_files.read_color`, or HEIC.
    * `model`: folder of a depth-estimation model, or its name on huggingface.co.

    Raises `UsageError`: torch or transformers is not installed. `FileError`: the photograph or the
    model is missing, damaged or of another kind. `OutOfMemoryError`: too large a photograph.
    """
    from PIL import Image

    color = read_photo_srgb(path)
    try:
        estimator = _load_model(model)
        has_unit = _returns_metres(estimator.model.config)
        output = estimator(Image.fromarray(color))["predicted_depth"]
        numbers = np.squeeze(np.asarray(output.detach().cpu().float().numpy(), np.float32))
        if numbers.ndim != 2 or not np.isfinite(numbers).all():
            raise ValueError(f"output of shape {numbers.shape}, or values not finite")
    except MemoryError as error:
        raise OutOfMemoryError(f"{path}: not enough memory; scale the picture down") from error
    except ImportError as error:
        raise UsageError(
            f"--estimate-depth: needs torch and transformers ({error.name or error} is missing); "
            "pip install 'inim[depth]'"
        ) from error
    except Exception as error:  # of any type and length
        cause = " ".join(str(error).split())[:200] or type(error).__name__
        raise FileError(
            f"--estimate-depth {model}: failed on {path} ({cause}); give a folder with a "
            "depth-estimation model, or its name on huggingface.co while there is a network"
        ) from error
    if has_unit:
        depth = np.where(numbers > 0, numbers * np.float32(1000), np.float32(np.nan))
    else:
        depth = _relative_distance(numbers)
    kind = "metres" if has_unit else "inverse depth, converted to relative distance"
    values = DepthValues(depth, near_is_large=False, has_unit=has_unit, step=0.0, warnings=())
    return DepthPhoto(color, values, None, (f"depth estimated by {model}: {kind}",))


@lru_cache(maxsize=1)
def _load_model(model: str) -> Any:
    """Load the `transformers` pipeline of a model."""
    import torch  # noqa: F401 (the pipeline's error message is a page long)
    from transformers import pipeline

    return pipeline("depth-estimation", model=model)


def _returns_metres(config: Any) -> bool:
    """True if a model returns metres, by its configuration; otherwise it returns inverse depth."""
    stated = getattr(config, "depth_estimation_type", None)
    if stated in ("metric", "relative"):
        return bool(stated == "metric")
    kind = getattr(config, "model_type", None)
    if kind not in _RETURNS_METRES:
        kinds = ", ".join(sorted(_RETURNS_METRES))
        raise ValueError(f"the output of {kind} models is unknown, that of {kinds} is known")
    return _RETURNS_METRES[kind]


def _relative_distance(inverse: NDArray[np.float32]) -> NDArray[np.float32]:
    """Convert inverse depth, known up to scale and shift, to distances from 1 to `FAR_OVER_NEAR`.

    The inverse depth is (H, W), larger for nearer objects. A flat one becomes 1.
    """
    low, high = float(inverse.min()), float(inverse.max())
    if high == low:
        return np.ones(inverse.shape, np.float32)
    share = (inverse.astype(np.float64) - low) / (high - low)
    least = 1 / FAR_OVER_NEAR
    return np.asarray(1 / (least + (1 - least) * share), np.float32)
