"""Source maps: which pixel of the picture each panel pixel shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from inim.rgbd import RGBD

__all__ = ["HOLE", "NO_LENS", "colour_of", "hole_fraction"]

#: A panel pixel whose ray meets no surface.
HOLE = -1
#: A panel pixel outside the lens array: dark by construction, not a hole.
NO_LENS = -2


def colour_of(sources: NDArray[np.int32], rgbd: RGBD) -> NDArray[np.float32]:
    """Colours of a source map, (rows, columns, 3) float32 linear; black where there is none."""
    # One black pixel at the end serves holes and unlensed pixels alike.
    palette = np.concatenate([rgbd.color.reshape(-1, 3), np.zeros((1, 3), np.float32)])
    return palette[np.where(sources >= 0, sources, len(palette) - 1)]


def hole_fraction(sources: NDArray[np.int32]) -> float:
    """Share of the lensed panel pixels that show nothing."""
    lensed = np.count_nonzero(sources != NO_LENS)
    return np.count_nonzero(sources == HOLE) / lensed if lensed else 0.0
