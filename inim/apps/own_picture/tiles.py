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

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from inim.image.color import linear_from_srgb
from inim.system.backend.kernels import compiled

# Number of samples per block in which colours are converted to floats.
_BLOCK = 2**20
# Tolerance for cell centres on a border of two tiles: both cover them despite rounding.
_ON_BORDER = 1e-9


class TileFrame(NamedTuple):
    """Mapping of samples to the display frame.

    Sample (i, j) of value q is at ``x = ax (j - cx) w + ox``, ``y = -ay (i - cy) w + oy`` with
    w = 1 / q if `perspective`, else 1. Its z is ``offset_mm + slope q``, or ``+ slope / q`` if
    `over_q`, clipped to `low_mm` .. `high_mm`. Cells are `cell_mm` wide.
    """

    ax: float
    ay: float
    cx: float
    cy: float
    ox: float
    oy: float
    perspective: bool
    over_q: bool
    offset_mm: float
    slope: float
    low_mm: float
    high_mm: float
    cell_mm: float
    #: Range to which samples are clipped; samples out of range are omitted if `drop`.
    q_low: float
    q_high: float
    #: Neighbours belong to one surface if their q differ by at most ``tolerance + tolerance_share
    #: min(q)``.
    tolerance: float
    tolerance_share: float
    drop: bool


@dataclass(frozen=True)
class TileImage:
    """Cells of the display's picture."""

    color: NDArray[np.float32]  #: (rows, columns, 3) float32, linear RGB
    depth_mm: NDArray[np.float32]  #: (rows, columns) float32
    covered: NDArray[np.bool_]  #: (rows, columns) bool
    clipped: int  #: Number of samples out of range.


def draw_tiles(
    q: NDArray[np.float32],
    color: np.ndarray,
    frame: TileFrame,
    shape: tuple[int, int],
    same_mm: float,
) -> TileImage:
    """Draw samples into cells.

    * `q`, (H, W) float32: inverse distances, or depths; NaN where missing.
    * `color`, (H, W, 3) uint8 sRGB, or float32 linear RGB
    * `shape`, (rows, columns): number of cells, centred on the display's axis.
    * `same_mm`: maximum depth difference between a cell and the samples that contribute to its
      colour.
    """
    depth = np.full(shape, -np.inf)
    owner = np.full(shape, -1, np.int64)
    clipped = int(_draw(q, frame, depth, owner))
    sums, counts = np.zeros((*shape, 3)), np.zeros(shape, np.int32)
    rows = max(1, _BLOCK // q.shape[1])
    for start in range(0, len(q), rows):
        block = linear_light(color[start : start + rows])
        part = q[start : start + rows]
        _add_block_colors(part, start, block, frame, depth, same_mm, sums, counts)
    covered = owner >= 0
    cell_color = np.zeros((*shape, 3), np.float32)
    cell_color[covered] = linear_light(color.reshape(-1, 3)[owner[covered]])
    averaged = covered & (counts > 0)
    cell_color[averaged] = sums[averaged] / counts[averaged][:, None]
    return TileImage(cell_color, np.where(covered, depth, 0).astype(np.float32), covered, clipped)


def linear_light(color: np.ndarray) -> NDArray[np.float32]:
    """Linear RGB of uint8 sRGB, or of linear RGB itself."""
    if color.dtype == np.uint8:
        linear: NDArray[np.float32] = linear_from_srgb(np.arange(256) / 255)[color]
        return linear
    return np.asarray(color, np.float32)


@compiled(inline="always")
def _clip(q, frame):  # type: ignore[no-untyped-def]
    """Clip to the range; NaN stays NaN."""
    return frame.q_low if q < frame.q_low else frame.q_high if q > frame.q_high else q


@compiled(inline="always")
def _is_one_surface(a, b, frame):  # type: ignore[no-untyped-def]
    return abs(a - b) <= frame.tolerance + frame.tolerance_share * min(a, b)


@compiled(inline="always")
def _unclipped_depth(q, frame):  # type: ignore[no-untyped-def]
    return frame.offset_mm + (frame.slope / q if frame.over_q else frame.slope * q)


@compiled(inline="always")
def _display_depth(q, frame):  # type: ignore[no-untyped-def]
    return min(max(_unclipped_depth(q, frame), frame.low_mm), frame.high_mm)


@compiled(inline="always")
def _is_out_of_range(q, frame):  # type: ignore[no-untyped-def]
    """True if a sample is out of range by more than rounding."""
    z = _unclipped_depth(q, frame)
    z_tolerance = 1e-6 * (frame.high_mm - frame.low_mm)
    q_tolerance = 1e-6 * (abs(frame.q_low) + abs(frame.q_high))
    z_is_out = z < frame.low_mm - z_tolerance or z > frame.high_mm + z_tolerance
    return z_is_out or q < frame.q_low - q_tolerance or q > frame.q_high + q_tolerance


@compiled(inline="always")
def _column(j, w, frame, width):  # type: ignore[no-untyped-def]
    return (frame.ax * (j - frame.cx) * w + frame.ox) / frame.cell_mm + 0.5 * width


@compiled(inline="always")
def _row(i, w, frame, height):  # type: ignore[no-untyped-def]
    return (frame.ay * (i - frame.cy) * w - frame.oy) / frame.cell_mm + 0.5 * height


@compiled
def _corner(q, i, j, di, dj, frame, around):  # type: ignore[no-untyped-def]
    """Mean q of the samples of (i, j)'s surface at the corner (i + di/2, j + dj/2).

    `around` (4,) receives the four samples there.
    """
    rows, columns = q.shape
    top, left = i + min(di, 0), j + min(dj, 0)
    for k in range(4):
        row, column = top + k // 2, left + k % 2
        is_inside = 0 <= row < rows and 0 <= column < columns
        around[k] = _clip(np.float64(q[row, column]), frame) if is_inside else np.nan
    own = 2 * (di < 0) + (dj < 0)
    horizontal, vertical, diagonal = own ^ 1, own ^ 2, own ^ 3
    has_horizontal = _is_one_surface(around[own], around[horizontal], frame)
    has_vertical = _is_one_surface(around[own], around[vertical], frame)
    joins_horizontal = _is_one_surface(around[diagonal], around[horizontal], frame)
    joins_vertical = _is_one_surface(around[diagonal], around[vertical], frame)
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
def _draw(q, frame, depth, owner):  # type: ignore[no-untyped-def]
    """Draw all tiles; return the number of samples out of range."""
    height, width = depth.shape
    u, v, z, around = np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    clipped = 0
    for i in range(q.shape[0]):
        for j in range(q.shape[1]):
            if np.isnan(q[i, j]):
                continue
            if _is_out_of_range(np.float64(q[i, j]), frame):
                clipped += 1
                if frame.drop:
                    continue
            for k in range(4):  # top left, top right, bottom right, bottom left
                di = -1 if k < 2 else 1
                dj = 1 if k == 1 or k == 2 else -1
                corner = _corner(q, i, j, di, dj, frame, around)
                w = 1.0 / corner if frame.perspective else 1.0
                u[k] = _column(j + 0.5 * dj, w, frame, width)
                v[k] = _row(i + 0.5 * di, w, frame, height)
                z[k] = _display_depth(corner, frame)
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
def _add_block_colors(  # type: ignore[no-untyped-def]
    depth_values, first_row, color, frame, depth_mm, tolerance_mm, sums, counts
):
    """Add the colours of a block of picture rows to the cells whose surface they belong to."""
    height, width = depth_mm.shape
    for i in range(depth_values.shape[0]):
        for j in range(depth_values.shape[1]):
            value = np.float64(depth_values[i, j])
            if np.isnan(value) or (frame.drop and _is_out_of_range(value, frame)):
                continue
            centre = _clip(value, frame)
            w = 1.0 / centre if frame.perspective else 1.0
            u = _column(j, w, frame, width)
            v = _row(i + first_row, w, frame, height)
            if not (0 <= u < width and 0 <= v < height):
                continue
            row, column = int(v), int(u)
            if abs(_display_depth(centre, frame) - depth_mm[row, column]) <= tolerance_mm:
                for k in range(3):
                    sums[row, column, k] += color[i, j, k]
                counts[row, column] += 1
