"""Fill rules for missing depth. Depth is only ever copied from a neighbour, never blended.

| rule      | a missing pixel takes the depth of                                                 |
| --------- | ---------------------------------------------------------------------------------- |
| `none`    | nothing: it stays a hole                                                           |
| `nearest` | the nearest pixel that has one                                                     |
| `behind`  | the farther one of the next known pixels to its left and right: what a sensor does |
|           | not see beside an object is mostly the background's                                |
| `far`     | the farthest depth there is                                                        |
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["FILL_RULES", "fill_missing"]

FILL_RULES = ("none", "nearest", "behind", "far")


def fill_missing(
    depth: NDArray[np.float32], rule: str, *, near_is_large: bool = False
) -> NDArray[np.float32]:
    """Depth with its missing pixels, NaN, filled.

    Parameters
    ----------
    depth : (H, W) float32
    rule : str
        One of `FILL_RULES`.
    near_is_large : bool
        Whether numbers grow towards the viewer.

    Returns
    -------
    (H, W) float32
        NaN where the rule found nothing; the input itself where there is nothing to do.
    """
    empty = np.isnan(depth)
    if rule == "none" or not empty.any() or empty.all():
        return depth
    if rule == "nearest":
        from scipy.ndimage import distance_transform_edt

        rows, columns = distance_transform_edt(empty, return_distances=False, return_indices=True)
        nearest: NDArray[np.float32] = depth[rows, columns]
        return nearest
    farther = np.fmin if near_is_large else np.fmax
    if rule == "far":
        farthest = np.float32(farther.reduce(depth[~empty]))
        return np.where(empty, farthest, depth)
    filled = depth.copy()
    for row in filled:  # a row at a time: no array of the picture's size per step
        known = np.flatnonzero(~np.isnan(row))
        gaps = np.flatnonzero(np.isnan(row))
        if known.size and gaps.size:
            after = np.searchsorted(known, gaps)
            left = np.where(after > 0, row[known[after - 1]], np.float32(np.nan))
            right = row[known[np.minimum(after, known.size - 1)]]
            right = np.where(after < known.size, right, np.float32(np.nan))
            row[gaps] = farther(left, right)
    return filled
