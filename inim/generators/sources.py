"""Source maps: which pixel of the picture each panel pixel shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from inim.rgbd import RGBD

__all__ = ["HOLE", "NOT_ASKED", "NO_LENS", "Sources", "colour_of", "hole_fraction"]

#: A panel pixel whose ray meets no surface.
HOLE = -1
#: A panel pixel outside the lens array: dark by construction, not a hole.
NO_LENS = -2
#: A panel pixel that was not asked for.
NOT_ASKED = -3

#: (rows, columns) int32: ``row * W + column`` of the picture's pixel, `HOLE` or `NO_LENS`.
Sources = NDArray[np.int32]


def colour_of(sources: Sources, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
    """Colours of a source map, (rows, columns, channels) in the picture's type.

    Where there is no source: zeros, which is black in float and transparent black in RGBA.
    """
    channels = rgbd.color.shape[2]
    # One empty pixel at the end serves holes and unlensed pixels alike.
    nothing = np.zeros((1, channels), rgbd.color.dtype)
    palette = np.concatenate([rgbd.palette.reshape(-1, channels), nothing])
    return np.take(palette, np.where(sources >= 0, sources, len(palette) - 1), axis=0, out=out)


def hole_fraction(sources: Sources) -> float:
    """Share of the lensed panel pixels asked for that show nothing."""
    lensed = np.count_nonzero(sources > NO_LENS)
    return np.count_nonzero(sources == HOLE) / lensed if lensed else 0.0
