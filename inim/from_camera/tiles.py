"""Rendering of a camera's samples, as tiles, into the orthographic cells of the display's picture.

Each sample is a tile that covers its camera pixel. Tiles of one surface share their corners, so
that the map cannot open gaps between them. At the edge of a surface the corners separate, and the
surface behind or a hole is visible. Two neighbours belong to one surface if the slope between them
is at most the given limit. This decides which of the four samples at a corner share it.

A cell takes the tile nearest to the viewer at its centre, and the depth of that tile there. Depth
is interpolated within one surface only. The cell's colour is the mean, in linear light, of the
samples in it that belong to this surface, which avoids aliasing of fine pictures; without such
samples it is the tile's colour.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from inim.backend.kernels import compiled
from inim.image.color import linear_from_srgb

if TYPE_CHECKING:
    from inim.from_camera.fit import DepthMap

# Number of samples per block in which colours are converted to floats.
_BLOCK = 2**20
# Tolerance for cell centres on a border of two tiles: both cover them despite rounding.
_ON_BORDER = 1e-9


@dataclass(frozen=True)
class CameraTiles:
    """Samples and their mapping to the display frame.

    Sample (i, j) of value q is at ``x = ax (j - cx) w + ox``, ``y = -ay (i - cy) w + oy`` with
    w = 1 / q if `perspective`, else 1. Its z is the `depth_map` of q, or of 1 / q if `over_q`.

    Attributes
    ----------
    q : (H, W) float32
        Inverse distances, or depths, clipped to `q_low` .. `q_high`; NaN where missing.
    tolerance, tolerance_share : float
        Neighbours belong to one surface if their q differ by at most
        ``tolerance + tolerance_share min(q)``.
    drop : bool
        Omit samples out of range instead of clipping them.
    """

    q: NDArray[np.float32]
    q_low: float
    q_high: float
    perspective: bool
    over_q: bool
    ax: float
    ay: float
    cx: float
    cy: float
    ox: float
    oy: float
    depth_map: DepthMap
    tolerance: float
    tolerance_share: float
    drop: bool


@dataclass(frozen=True)
class TileImage:
    """Cells of the display's picture.

    Attributes
    ----------
    color : (rows, columns, 3) float32, linear RGB
    depth_mm : (rows, columns) float32
    covered : (rows, columns) bool
    clipped : int
        Number of samples out of range.
    """

    color: NDArray[np.float32]
    depth_mm: NDArray[np.float32]
    covered: NDArray[np.bool_]
    clipped: int


def draw_tiles(
    tiles: CameraTiles, color: np.ndarray, shape: tuple[int, int], cell_mm: float, same_mm: float
) -> TileImage:
    """Draw samples into cells.

    Parameters
    ----------
    color : (H, W, 3) uint8 sRGB, or float32 linear RGB
    shape : (rows, columns)
        Number of cells, centred on the display's axis.
    same_mm : float
        Maximum depth difference between a cell and the samples that contribute to its colour.
    """
    t, to = tiles, tiles.depth_map
    frame = np.array(
        [
            *(t.ax, t.ay, t.cx, t.cy, t.ox, t.oy),
            *(to.offset_mm, to.slope, to.low_mm, to.high_mm, cell_mm),
        ]
    )
    limits = np.array([t.q_low, t.q_high, t.tolerance, t.tolerance_share])
    flags = (t.perspective, t.over_q, t.drop)
    depth = np.full(shape, -np.inf)
    owner = np.full(shape, -1, np.int64)
    clipped = int(_draw(t.q, frame, limits, flags, depth, owner))
    sums, counts = np.zeros((*shape, 3)), np.zeros(shape, np.int32)
    rows = max(1, _BLOCK // t.q.shape[1])
    for start in range(0, t.q.shape[0], rows):
        block = _linear(color[start : start + rows])
        part = t.q[start : start + rows]
        _add_colors(part, start, block, frame, limits, flags, depth, same_mm, sums, counts)
    covered = owner >= 0
    cell_color = np.zeros((*shape, 3), np.float32)
    cell_color[covered] = _linear(color.reshape(-1, 3)[owner[covered]])
    averaged = covered & (counts > 0)
    cell_color[averaged] = sums[averaged] / counts[averaged][:, None]
    return TileImage(cell_color, np.where(covered, depth, 0).astype(np.float32), covered, clipped)


def _linear(color: np.ndarray) -> NDArray[np.float32]:
    if color.dtype == np.uint8:
        linear: NDArray[np.float32] = linear_from_srgb(np.arange(256) / 255)[color]
        return linear
    return np.asarray(color, np.float32)


@compiled(inline="always")
def _clip(q, limits):  # type: ignore[no-untyped-def]
    """Clip to the range; NaN stays NaN."""
    return limits[0] if q < limits[0] else limits[1] if q > limits[1] else q


@compiled(inline="always")
def _is_one_surface(a, b, limits):  # type: ignore[no-untyped-def]
    return abs(a - b) <= limits[2] + limits[3] * min(a, b)


@compiled(inline="always")
def _display_depth(q, frame, over_q):  # type: ignore[no-untyped-def]
    z = frame[6] + (frame[7] / q if over_q else frame[7] * q)
    return min(max(z, frame[8]), frame[9])


@compiled(inline="always")
def _is_out_of_range(q, frame, limits, over_q):  # type: ignore[no-untyped-def]
    """True if a sample is out of range by more than rounding."""
    z = frame[6] + (frame[7] / q if over_q else frame[7] * q)
    z_tolerance = 1e-6 * (frame[9] - frame[8])
    q_tolerance = 1e-6 * (abs(limits[0]) + abs(limits[1]))
    z_is_out = z < frame[8] - z_tolerance or z > frame[9] + z_tolerance
    return z_is_out or q < limits[0] - q_tolerance or q > limits[1] + q_tolerance


@compiled
def _corner(q, i, j, di, dj, limits, around):  # type: ignore[no-untyped-def]
    """Mean q of the samples of (i, j)'s surface at the corner (i + di/2, j + dj/2).

    `around` (4,) receives the four samples there.
    """
    rows, columns = q.shape
    top, left = i + min(di, 0), j + min(dj, 0)
    for k in range(4):
        row, column = top + k // 2, left + k % 2
        is_inside = 0 <= row < rows and 0 <= column < columns
        around[k] = _clip(np.float64(q[row, column]), limits) if is_inside else np.nan
    own = 2 * (di < 0) + (dj < 0)
    horizontal, vertical, diagonal = own ^ 1, own ^ 2, own ^ 3
    has_horizontal = _is_one_surface(around[own], around[horizontal], limits)
    has_vertical = _is_one_surface(around[own], around[vertical], limits)
    joins_horizontal = _is_one_surface(around[diagonal], around[horizontal], limits)
    joins_vertical = _is_one_surface(around[diagonal], around[vertical], limits)
    has_diagonal = (has_horizontal and joins_horizontal) or (has_vertical and joins_vertical)
    has_horizontal = has_horizontal or (has_diagonal and joins_horizontal)
    has_vertical = has_vertical or (has_diagonal and joins_vertical)
    total, count = 0.0, 0
    for k in range(4):  # in row-major order, so that all tiles at a corner compute identical bits
        if (
            k == own
            or (k == horizontal and has_horizontal)
            or (k == vertical and has_vertical)
            or (k == diagonal and has_diagonal)
        ):
            total, count = total + around[k], count + 1
    return total / count


@compiled
def _draw(q, frame, limits, flags, depth, owner):  # type: ignore[no-untyped-def]
    """Draw all tiles; return the number of samples out of range."""
    perspective, over_q, drop = flags
    ax, ay, cx, cy, ox, oy = frame[:6]
    cell = frame[10]
    height, width = depth.shape
    u, v, z, around = np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    clipped = 0
    for i in range(q.shape[0]):
        for j in range(q.shape[1]):
            if np.isnan(q[i, j]):
                continue
            if _is_out_of_range(np.float64(q[i, j]), frame, limits, over_q):
                clipped += 1
                if drop:
                    continue
            for k in range(4):  # top left, top right, bottom right, bottom left
                di = -1 if k < 2 else 1
                dj = 1 if k == 1 or k == 2 else -1
                corner = _corner(q, i, j, di, dj, limits, around)
                w = 1.0 / corner if perspective else 1.0
                u[k] = (ax * (j + 0.5 * dj - cx) * w + ox) / cell + 0.5 * width
                v[k] = (ay * (i + 0.5 * di - cy) * w - oy) / cell + 0.5 * height
                z[k] = _display_depth(corner, frame, over_q)
            _fill(u, v, z, 0, 1, 2, i * q.shape[1] + j, depth, owner)
            _fill(u, v, z, 0, 2, 3, i * q.shape[1] + j, depth, owner)
    return clipped


@compiled
def _fill(u, v, z, a, b, c, number, depth, owner):  # type: ignore[no-untyped-def]
    """Draw a triangle into the cells whose centres it covers and where it is the nearest."""
    height, width = depth.shape
    left, right = min(u[a], u[b], u[c]), max(u[a], u[b], u[c])
    top, bottom = min(v[a], v[b], v[c]), max(v[a], v[b], v[c])
    if not (right > 0 and left < width and bottom > 0 and top < height):
        return
    first_column = max(int(np.ceil(left - 0.5 - _ON_BORDER)), 0)
    last_column = min(int(np.floor(right - 0.5 + _ON_BORDER)), width - 1)
    first_row = max(int(np.ceil(top - 0.5 - _ON_BORDER)), 0)
    last_row = min(int(np.floor(bottom - 0.5 + _ON_BORDER)), height - 1)
    if first_column > last_column or first_row > last_row:
        return
    area = (u[b] - u[a]) * (v[c] - v[a]) - (u[c] - u[a]) * (v[b] - v[a])
    if area == 0:
        return
    for row in range(first_row, last_row + 1):
        for column in range(first_column, last_column + 1):
            x, y = column + 0.5, row + 0.5
            wa = ((u[b] - x) * (v[c] - y) - (u[c] - x) * (v[b] - y)) / area
            wb = ((u[c] - x) * (v[a] - y) - (u[a] - x) * (v[c] - y)) / area
            wc = 1.0 - wa - wb
            if min(wa, wb, wc) >= -_ON_BORDER:
                z_cell = wa * z[a] + wb * z[b] + wc * z[c]
                if z_cell > depth[row, column]:
                    depth[row, column] = z_cell
                    owner[row, column] = number


@compiled
def _add_colors(  # type: ignore[no-untyped-def]
    q, start, color, frame, limits, flags, depth, same, sums, counts
):
    """Add the colours of a block of samples to the cells of their surface."""
    perspective, over_q, drop = flags
    ax, ay, cx, cy, ox, oy = frame[:6]
    cell = frame[10]
    height, width = depth.shape
    for i in range(q.shape[0]):
        for j in range(q.shape[1]):
            if np.isnan(q[i, j]):
                continue
            if drop and _is_out_of_range(np.float64(q[i, j]), frame, limits, over_q):
                continue
            centre = _clip(np.float64(q[i, j]), limits)
            w = 1.0 / centre if perspective else 1.0
            u = (ax * (j - cx) * w + ox) / cell + 0.5 * width
            v = (ay * (i + start - cy) * w - oy) / cell + 0.5 * height
            if not (0 <= u < width and 0 <= v < height):
                continue
            row, column = int(v), int(u)
            if abs(_display_depth(centre, frame, over_q) - depth[row, column]) <= same:
                for k in range(3):
                    sums[row, column, k] += color[i, j, k]
                counts[row, column] += 1
