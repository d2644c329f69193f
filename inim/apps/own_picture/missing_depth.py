"""Fill of the pixels of a depth picture that have no depth, by a rule (`FillRule`)."""

import numpy as np
from numpy.typing import NDArray

from inim.apps.own_picture.options import FillRule
from inim.system.backend.kernels import compiled, share_rows


def fill_missing_depth(
    depth: NDArray[np.float32], rule: FillRule, *, near_is_large: bool = False
) -> NDArray[np.float32]:
    """Fill the missing pixels (NaN) of a depth picture, (H, W) float32, by a rule.

    Pixels stay NaN where the rule has no depth to use. Without missing pixels, returns the input.
    """
    empty = np.isnan(depth)
    if rule == "none" or not empty.any() or empty.all():
        return depth
    if rule == "nearest":
        from scipy.ndimage import distance_transform_edt

        rows, columns = distance_transform_edt(empty, return_distances=False, return_indices=True)
        nearest: NDArray[np.float32] = depth[rows, columns]
        return nearest
    if rule == "far":
        farthest = (np.fmin if near_is_large else np.fmax).reduce(depth[~empty])
        return np.where(empty, np.float32(farthest), depth)
    filled = np.empty_like(depth)
    share_rows(_fill_behind, len(depth), depth, np.float32(-1 if near_is_large else 1), filled)
    return filled


@compiled
def _fill_behind(begin, end, depth, away, filled):  # type: ignore[no-untyped-def]
    """Give each gap in some rows the depth of its farther neighbour in the row.

    * `away`: 1 if depths grow away from the viewer, otherwise -1.
    """
    columns, step = np.uintp(depth.shape[1]), np.uintp(1)
    for i in range(begin, end):
        line, row = depth[i], filled[i]
        left, j = np.float32(np.nan), np.uintp(0)
        while j < columns:
            stop = j
            while stop < columns and np.isnan(line[stop]):
                stop += step
            right = line[stop] if stop < columns else np.float32(np.nan)
            behind = right if np.isnan(left) or right * away > left * away else left
            while j < stop:
                row[j] = behind
                j += step
            if stop < columns:
                row[stop] = right
            left, j = right, stop + step
