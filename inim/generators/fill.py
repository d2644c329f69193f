"""Painting holes of an elemental image array, each elemental image by itself.

Not part of any algorithm under test: holes are counted before, and painted only when asked.

Only holes inside the object are painted; which those are the algorithm says, as a mask. Background
stays empty, and no colour crosses from one elemental image to its neighbour, which shows the scene
from elsewhere. An elemental image without any source stays as it is.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from inim.display import Display
from inim.display.pixel_axis import PixelAxis
from inim.generators.sources import Sources, colour_of
from inim.rgbd import RGBD

__all__ = ["FILLS", "filled"]

FILLS = ("none", "nearest", "biharmonic")


def filled(
    how: str,
    sources: Sources,
    inside: NDArray[np.bool_],
    rgbd: RGBD,
    display: Display,
    out: np.ndarray,
) -> np.ndarray:
    """The EIA of a source map, its holes painted.

    Parameters
    ----------
    how : {"nearest", "biharmonic"}
        The colour of the nearest panel pixel that has one; or the smoothest surface through the
        colours around, Damelin and Hoang (2018, doi 10.1155/2018/3950312) by scikit-image, in
        linear RGB or sRGB as the picture is.
    sources : Sources
    inside : (rows, columns) bool
        Holes to paint.
    rgbd : RGBD
    display : Display
    out : (rows, columns, channels) array
        Where to write the result, in the type of the picture's colour.

    Returns
    -------
    `out`.
    """
    around, inside = _spread(sources, inside, display)
    if how == "nearest":
        return colour_of(np.where(inside, around, sources), rgbd, out)
    # From spread colours: to the solver the empty background would be a black object.
    spread = colour_of(around, rgbd).astype(np.float64)
    colour_of(sources, rgbd, out)
    for window in _elemental_images(display):
        if inside[window].any():
            _paint_smoothly(spread[window], inside[window], out[window])
    return out


def _spread(
    sources: Sources, inside: NDArray[np.bool_], display: Display
) -> tuple[Sources, NDArray[np.bool_]]:
    """Sources with the nearest one everywhere, and the holes inside that have one."""
    # Slow to import, and most runs paint nothing.
    from scipy.ndimage import distance_transform_edt

    around, paintable = sources.copy(), inside.copy()
    for window in _elemental_images(display):
        empty = sources[window] < 0
        if empty.all():
            paintable[window] = False
        elif inside[window].any():
            rows, columns = distance_transform_edt(
                empty, return_distances=False, return_indices=True
            )
            around[window] = sources[window][rows, columns]
    return around, paintable


def _paint_smoothly(spread: np.ndarray, inside: np.ndarray, out: np.ndarray) -> None:
    from skimage.restoration import inpaint_biharmonic

    # Stays within the range of the colours around.
    painted = inpaint_biharmonic(spread, inside, channel_axis=-1)[inside]
    out[inside] = np.rint(painted) if out.dtype == np.uint8 else painted


def _elemental_images(display: Display) -> Iterator[tuple[slice, slice]]:
    """The panel's rows and columns of each elemental image."""
    columns = _stretches(display.columns)
    return ((rows, across) for rows in _stretches(display.rows) for across in columns)


def _stretches(axis: PixelAxis) -> list[slice]:
    """Panel pixels of each lens of an axis that has any."""
    starts = np.flatnonzero(np.diff(axis.lens, prepend=-1, append=-1))
    ends = [*starts[1:], len(axis.lens)]
    return [slice(a, b) for a, b in zip(starts, ends, strict=False) if b > a and axis.lens[a] >= 0]
