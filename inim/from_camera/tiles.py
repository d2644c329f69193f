"""A camera's samples as tiles, drawn into the orthographic cells of the display's picture.

Every sample is a small tile that covers its own pixel of the camera. Where samples of one surface
meet in a pixel corner, their tiles share that corner, so that nothing shows between them, however
far the map pulls them apart; where the surface ends, they do not, and what lies behind is seen or a
hole stays. Two neighbours are of one surface where their depths differ by no more than a stated
slope allows; which samples of the four around a corner belong together follows from that.

A cell takes the tile nearest to the viewer at its centre, and the depth of that tile there:
interpolated within one surface, never between two. Its colour is the mean, in linear light, of the
samples that fall into it and belong to that surface, so that a picture finer than the cells does
not alias; the tile's own where none falls into it.
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

# Colours become floats in blocks of about this many samples.
_BLOCK = 2**20
# Cell centres on a border shared by two tiles belong to both: rounding must not lose them.
_ON_BORDER = 1e-9


@dataclass(frozen=True)
class CameraTiles:
    """Where samples lie in the display frame.

    Sample (i, j) of number q lies at ``x = ax (j - cx) w + ox``, ``y = -ay (i - cy) w + oy`` with
    w = 1 / q where `perspective`, else 1, and at the z of `depth_map`,
    with q for d, or 1 / q where `over_q`.

    Attributes
    ----------
    q : (H, W) float32
        Inverse distances, or depths; NaN where there is none. Taken to `q_low` .. `q_high`.
    apart, apart_share : float
        Neighbours are one surface where their q differ by at most ``apart + apart_share min(q)``.
    drop : bool
        Leave samples beyond the range out instead of taking them to its end.
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
    apart: float
    apart_share: float
    drop: bool


@dataclass(frozen=True)
class TileImage:
    """Cells.

    Attributes
    ----------
    color : (rows, columns, 3) float32, linear RGB
    depth_mm : (rows, columns) float32
    covered : (rows, columns) bool
    clipped : int
        Samples beyond the range.
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
    tiles : CameraTiles
    color : (H, W, 3) uint8 sRGB, or float32 linear RGB
    shape : (rows, columns)
        Of the cells, centred on the display's axis.
    cell_mm : float
    same_mm : float
        Samples in a cell this close in depth to what it shows are of the same surface.
    """
    t, to = tiles, tiles.depth_map
    frame = np.array(
        [
            *(t.ax, t.ay, t.cx, t.cy, t.ox, t.oy),
            *(to.offset_mm, to.slope, to.low_mm, to.high_mm, cell_mm),
        ]
    )
    limits = np.array([t.q_low, t.q_high, t.apart, t.apart_share])
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
    seen = np.zeros((*shape, 3), np.float32)
    flat = color.reshape(-1, 3)
    seen[covered] = _linear(flat[owner[covered]])
    several = covered & (counts > 0)
    seen[several] = sums[several] / counts[several][:, None]
    return TileImage(seen, np.where(covered, depth, 0).astype(np.float32), covered, clipped)


def _linear(color: np.ndarray) -> NDArray[np.float32]:
    if color.dtype == np.uint8:
        linear: NDArray[np.float32] = linear_from_srgb(np.arange(256) / 255)[color]
        return linear
    return np.asarray(color, np.float32)


@compiled(inline="always")
def _held(q, limits):  # type: ignore[no-untyped-def]
    """A number taken to the range; NaN stays NaN."""
    return limits[0] if q < limits[0] else limits[1] if q > limits[1] else q


@compiled(inline="always")
def _joined(a, b, limits):  # type: ignore[no-untyped-def]
    return abs(a - b) <= limits[2] + limits[3] * min(a, b)


@compiled(inline="always")
def _depth_of(q, frame, over_q):  # type: ignore[no-untyped-def]
    z = frame[6] + (frame[7] / q if over_q else frame[7] * q)
    return min(max(z, frame[8]), frame[9])


@compiled(inline="always")
def _beyond(q, frame, limits, over_q):  # type: ignore[no-untyped-def]
    """Whether a sample lies outside of the range, but for rounding."""
    z = frame[6] + (frame[7] / q if over_q else frame[7] * q)
    least = 1e-6 * (frame[9] - frame[8])
    aside = 1e-6 * (abs(limits[0]) + abs(limits[1]))
    out = z < frame[8] - least or z > frame[9] + least
    return out or q < limits[0] - aside or q > limits[1] + aside


@compiled
def _corner(q, i, j, di, dj, own, limits):  # type: ignore[no-untyped-def]
    """Mean q of the samples that meet `own`'s surface in the corner at (i + di/2, j + dj/2)."""
    rows, columns = q.shape
    nothing = np.float64(np.nan)
    beside = below = across = nothing
    row, column = i + di, j + dj
    if 0 <= column < columns:
        beside = _held(np.float64(q[i, column]), limits)
    if 0 <= row < rows:
        below = _held(np.float64(q[row, j]), limits)
        if 0 <= column < columns:
            across = _held(np.float64(q[row, column]), limits)
    with_beside = _joined(own, beside, limits)
    with_below = _joined(own, below, limits)
    with_across = False
    if with_beside and _joined(beside, across, limits):
        with_across = True
    if with_below and _joined(below, across, limits):
        with_across = True
    if with_across:
        with_beside = with_beside or _joined(across, beside, limits)
        with_below = with_below or _joined(across, below, limits)
    # Summed in the order of the picture, so that all tiles of a corner get it to the bit.
    upper, lower = (own, below) if di > 0 else (below, own)
    upper_in, lower_in = (True, with_below) if di > 0 else (with_below, True)
    upper_aside, lower_aside = (beside, across) if di > 0 else (across, beside)
    upper_aside_in, lower_aside_in = (
        (with_beside, with_across) if di > 0 else (with_across, with_beside)
    )
    if dj < 0:
        upper, upper_aside = upper_aside, upper
        upper_in, upper_aside_in = upper_aside_in, upper_in
        lower, lower_aside = lower_aside, lower
        lower_in, lower_aside_in = lower_aside_in, lower_in
    total, members = 0.0, 0
    if upper_in:
        total, members = total + upper, members + 1
    if upper_aside_in:
        total, members = total + upper_aside, members + 1
    if lower_in:
        total, members = total + lower, members + 1
    if lower_aside_in:
        total, members = total + lower_aside, members + 1
    return total / members


@compiled
def _draw(q, frame, limits, flags, depth, owner):  # type: ignore[no-untyped-def]
    """Draw all tiles; the number of samples beyond the range."""
    perspective, over_q, drop = flags
    ax, ay, cx, cy, ox, oy = frame[:6]
    cell = frame[10]
    height, width = depth.shape
    u, v, z = np.empty(4), np.empty(4), np.empty(4)
    clipped = 0
    for i in range(q.shape[0]):
        for j in range(q.shape[1]):
            if np.isnan(q[i, j]):
                continue
            if _beyond(np.float64(q[i, j]), frame, limits, over_q):
                clipped += 1
                if drop:
                    continue
            own = _held(np.float64(q[i, j]), limits)
            for k in range(4):  # top left, top right, bottom right, bottom left
                di = -1 if k < 2 else 1
                dj = 1 if k == 1 or k == 2 else -1
                corner = _corner(q, i, j, di, dj, own, limits)
                w = 1.0 / corner if perspective else 1.0
                u[k] = (ax * (j + 0.5 * dj - cx) * w + ox) / cell + 0.5 * width
                v[k] = (ay * (i + 0.5 * di - cy) * w - oy) / cell + 0.5 * height
                z[k] = _depth_of(corner, frame, over_q)
            _fill(u, v, z, 0, 1, 2, i * q.shape[1] + j, depth, owner)
            _fill(u, v, z, 0, 2, 3, i * q.shape[1] + j, depth, owner)
    return clipped


@compiled
def _fill(u, v, z, a, b, c, number, depth, owner):  # type: ignore[no-untyped-def]
    """One triangle into the cells whose centres it covers, where it is the nearest."""
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
                there = wa * z[a] + wb * z[b] + wc * z[c]
                if there > depth[row, column]:
                    depth[row, column] = there
                    owner[row, column] = number


@compiled
def _add_colors(  # type: ignore[no-untyped-def]
    q, start, color, frame, limits, flags, depth, same, sums, counts
):
    """Add the colours of a block of samples to the cells that show their surface."""
    perspective, over_q, drop = flags
    ax, ay, cx, cy, ox, oy = frame[:6]
    cell = frame[10]
    height, width = depth.shape
    for i in range(q.shape[0]):
        for j in range(q.shape[1]):
            if np.isnan(q[i, j]):
                continue
            if drop and _beyond(np.float64(q[i, j]), frame, limits, over_q):
                continue
            own = _held(np.float64(q[i, j]), limits)
            w = 1.0 / own if perspective else 1.0
            u = (ax * (j - cx) * w + ox) / cell + 0.5 * width
            v = (ay * (i + start - cy) * w - oy) / cell + 0.5 * height
            if not (0 <= u < width and 0 <= v < height):
                continue
            row, column = int(v), int(u)
            if abs(_depth_of(own, frame, over_q) - depth[row, column]) <= same:
                for k in range(3):
                    sums[row, column, k] += color[i, j, k]
                counts[row, column] += 1
