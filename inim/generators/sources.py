"""Source maps: which pixel of the picture each panel pixel shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from inim.buffers import row_bands
from inim.errors import UsageError
from inim.rgbd import RGBD

__all__ = ["HOLE", "MASKED", "NO_LENS", "Sources", "colour_of", "hole_fraction"]

#: A panel pixel whose ray meets no surface.
HOLE = -1
#: A panel pixel outside the lens array: dark by construction, not a hole.
NO_LENS = -2
#: A panel pixel outside the pixel mask.
MASKED = -3

# Indices and colours of so many pixels stay in a processor's cache.
_PIXELS_AT_ONCE = 2**15

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
    if out is None:
        out = np.empty((*sources.shape, channels), palette.dtype)
    nowhere = len(palette) - 1
    for band in row_bands(sources.shape[0], sources.shape[1], _PIXELS_AT_ONCE):
        some = sources[band]
        if some.max(initial=HOLE) >= nowhere:
            raise UsageError(
                f"a source is {some.max()}; this picture has 0 to {nowhere - 1}, and {NO_LENS} and "
                f"{HOLE} mean none"
            )
        index = np.where(some >= 0, some, nowhere)
        # Not "raise", by which all of the output would be written twice.
        np.take(palette, index, axis=0, out=out[band], mode="clip")
    return out


def hole_fraction(sources: Sources) -> float:
    """Share of the lensed panel pixels, of those in the mask, that show nothing."""
    lensed = np.count_nonzero(sources > NO_LENS)
    return np.count_nonzero(sources == HOLE) / lensed if lensed else 0.0
