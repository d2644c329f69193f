"""Culling: pixels that are certainly black, and layers that no ray of a display can meet.

Pixels (`BoundsGrid`): the bounding box of each triangle, splat or other shape is entered in a
coarse grid of the display frame. A pixel's bundle of rays is a prism: in a depth slab it stays
within one horizontal and one vertical interval. If no slab has an occupied cell there, no ray of
the pixel meets a shape, and it is black, because lights are invisible to cameras.

Layers (`layers_in_view`): docs/theory/layers.md, "Hidden layers", describes the search. A cell has
8 by 8 positions, one bit each of a word. The result includes too many layers, never too few.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inim.display import Display
from inim.render.library import mi
from inim.render.rays import Interval, NonSeparableRays, SeparableRays
from inim.render.splats import splat_count
from inim.system.backend.kernels import compiled, share_rows

# Cells across, down and in depth: finer than what a panel pixel sees gains little.
_CELLS = (192, 192, 24)
# What float32 rays and the renderer's own rounding may stray, in cells.
_STRAY = 0.01


@dataclass(frozen=True)
class BoundsGrid:
    """Coarse grid of the space occupied by a scene's shapes.

    * `low_mm`, `cell_mm`, (3,) float64: the grid's corner in the display frame, and the size of its
      cells.
    * `counts`, (slabs, rows + 1, columns + 1) int64: occupied cells of each slab below and left of
      each corner, summed up.
    """

    low_mm: np.ndarray
    cell_mm: np.ndarray
    counts: np.ndarray
    start_mm: float

    @classmethod
    def of(cls, scene: Any, display_from_world: np.ndarray, start_mm: float) -> BoundsGrid:
        """The bounds of all shapes that are no lights."""
        shapes = [shape for shape in scene.shapes() if not shape.is_emitter()]
        boxes = [_display_boxes(shape, display_from_world) for shape in shapes]
        lows, highs = (np.concatenate([pair[end] for pair in boxes]) for end in (0, 1))
        low, high = lows.min(axis=0), highs.max(axis=0)
        # A flat shape has a depth, too, if only of rounding.
        cell = np.maximum(high - low, 1e-6 * np.abs(np.stack([low, high])).max()) / _CELLS
        first = np.clip(np.floor((lows - low) / cell - _STRAY), 0, np.array(_CELLS) - 1)
        last = np.clip(np.floor((highs - low) / cell + _STRAY), 0, np.array(_CELLS) - 1)
        occupied = _count_boxes(first.astype(np.int64), last.astype(np.int64)) > 0
        counts = np.zeros((_CELLS[2], _CELLS[1] + 1, _CELLS[0] + 1), np.int64)
        sums = occupied.transpose(2, 1, 0).cumsum(axis=1, dtype=np.int64).cumsum(axis=2)
        counts[:, 1:, 1:] = sums
        return cls(low, cell, counts, start_mm)

    def visible_pixels(self, rays: SeparableRays | NonSeparableRays) -> np.ndarray:
        """Pixels that may show anything, (rows, columns) bool."""
        slabs = np.arange(len(self.counts) + 1)
        # Depth below the start plane, of the borders of the slabs from the farthest on.
        ends = self.start_mm - (self.low_mm[2] + slabs * self.cell_mm[2])
        is_visible = np.zeros(rays.shape, bool)
        if isinstance(rays, NonSeparableRays):
            bundles = (
                (rays.x0_mm, rays.offset_x_mm, rays.step_x_mm, rays.along_x * rays.step_y_mm,
                 self.low_mm[0], self.cell_mm[0]),
                (rays.y0_mm, rays.offset_y_mm, rays.step_y_mm, rays.along_y * rays.step_y_mm,
                 self.low_mm[1], self.cell_mm[1]),
            )  # fmt: skip
            tilt = abs(rays.tilt_x * rays.step_x_mm) + abs(rays.tilt_y * rays.step_y_mm)
            share_rows(
                _mark_bundles, len(is_visible), self.counts, ends - rays.start_mm, *bundles,
                rays.gap_mm, tilt / 2, is_visible,
            )  # fmt: skip
            return is_visible
        for k, counts in enumerate(self.counts):
            across, up = rays.reach(ends[k : k + 2])
            cells = *self._cells(across, 0), *self._cells(up, 1)
            share_rows(_mark_rows, len(is_visible), counts, *cells, is_visible)
        return is_visible

    def _cells(self, interval: Interval, axis: int) -> tuple[np.ndarray, np.ndarray]:
        """First cell of an interval and one past its last, clipped to the grid."""
        low, high = (
            (np.asarray(end, np.float64) - self.low_mm[axis]) / self.cell_mm[axis]
            for end in interval
        )
        most = self.counts.shape[2 - axis] - 1
        first = np.clip(np.floor(low - _STRAY), 0, most)
        last = np.clip(np.floor(high + _STRAY) + 1, 0, most)
        return first.astype(np.int32), last.astype(np.int32)


def world_points(shape: Any) -> np.ndarray:
    """World points whose hull contains a shape, (n, 3) float64: vertices, or corners of its box."""
    parameters = mi.traverse(shape)
    if "vertex_positions" in parameters:
        return np.asarray(parameters["vertex_positions"], np.float64).reshape(-1, 3)
    box = shape.bbox()
    ends = np.array([np.asarray(box.min).ravel(), np.asarray(box.max).ravel()], np.float64)
    picks = np.indices((2, 2, 2)).reshape(3, -1).T
    return np.stack([ends[picks[:, axis], axis] for axis in range(3)], axis=-1)


def _display_boxes(shape: Any, display_from_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Boxes in the display frame that contain a shape, low and high corners: one per triangle.

    Splats have a box per shell, other shapes one box.
    """
    turn, shift = display_from_world[:3, :3], display_from_world[:3, 3]
    if shape.is_ellipsoids() and isinstance(shape, mi.Mesh):
        points = np.asarray(shape.vertex_positions_buffer()).reshape(-1, 3)
        points = (points @ turn.T.astype(np.float32)).astype(np.float32) + shift.astype(np.float32)
        shells = points.reshape(-1, shape.vertex_count() // splat_count(shape), 3)
        # Splats too faint for `extent_adaptive_clamping` have none.
        shells = shells[np.isfinite(shells).all(axis=(1, 2))]
        return shells.min(axis=1), shells.max(axis=1)
    points, parameters = world_points(shape) @ turn.T + shift, mi.traverse(shape)
    if "faces" not in parameters:
        return points.min(axis=0)[None], points.max(axis=0)[None]
    corners = points[np.asarray(parameters["faces"]).reshape(-1, 3)]
    return corners.min(axis=1), corners.max(axis=1)


def _count_boxes(first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Number of boxes in each cell of the grid, from the cells of their corners."""
    shape = tuple(n + 1 for n in _CELLS)
    change = np.zeros(shape, np.int64)
    for picks in np.indices((2, 2, 2)).reshape(3, -1).T:
        corner = np.where(picks == 1, last + 1, first)
        flat = np.ravel_multi_index(tuple(corner.T), shape)
        sign = -1 if picks.sum() % 2 else 1
        change += sign * np.bincount(flat, minlength=change.size).reshape(shape)
    for axis in range(3):
        change = change.cumsum(axis=axis)
    return change[:-1, :-1, :-1]


@compiled
def _mark_rows(begin, end, counts, left, right, low, high, is_visible):  # type: ignore[no-untyped-def]
    """Mark pixels whose rectangle of cells, per column and per row, holds an occupied one."""
    for i in range(begin, end):
        below, above = counts[low[i]], counts[high[i]]
        for j in range(is_visible.shape[1]):
            a, b = left[j], right[j]
            is_visible[i, j] |= above[b] - above[a] - below[b] + below[a] > 0


@compiled
def _mark_bundles(begin, end, counts, travel, across, up, gap, tilt, is_visible):  # type: ignore[no-untyped-def]
    """Mark pixels whose bundle meets an occupied cell in some slab.

    * `travel`: depths of the slabs' borders below the array.
    * `across`, `up`: centres of the bundles on the array, vectors to them from the panel, widths of
      their bases, movements of the centres over a base, and the grid's corner and cell.
    * `gap`, `tilt`: gap at the middle of a bundle, and its change to the edges.
    """
    most_u, most_v = counts.shape[2] - 1, counts.shape[1] - 1
    for i in range(begin, end):
        for j in range(is_visible.shape[1]):
            u, v = _bundle(across, gap[i, j], tilt, i, j), _bundle(up, gap[i, j], tilt, i, j)
            left, right, low, high = _cells_at(u, v, travel[0])
            for k in range(1, len(travel)):
                next_left, next_right, next_low, next_high = _cells_at(u, v, travel[k])
                a, b = _cell_range(min(left, next_left), max(right, next_right), most_u)
                c, d = _cell_range(min(low, next_low), max(high, next_high), most_v)
                slab = counts[k - 1]
                if a < b and c < d and slab[d, b] - slab[d, a] - slab[c, b] + slab[c, a] > 0:
                    is_visible[i, j] = True
                    break
                left, right, low, high = next_left, next_right, next_low, next_high


@compiled(inline="always")
def _bundle(axis, gap, tilt, i, j):  # type: ignore[no-untyped-def]
    """Ends of a bundle's centre on the array and of its slopes, in cells of one axis."""
    centre, offset, step, along, corner, cell = axis
    place = (np.float64(centre[i, j]) - corner) / cell
    moves, reach = abs(along) / 2, abs(step) / 2 + abs(along) / 2
    first, last = (-reach - offset[i, j]) / cell, (reach - offset[i, j]) / cell
    return (
        place - moves / cell,
        place + moves / cell,
        min(first / (gap - tilt), first / (gap + tilt)),
        max(last / (gap - tilt), last / (gap + tilt)),
    )


@compiled(inline="always")
def _cells_at(u, v, travel):  # type: ignore[no-untyped-def]
    """Interval of a bundle at a depth below the array, across and up, in cells."""
    return (
        u[0] + min(u[2] * travel, u[3] * travel),
        u[1] + max(u[2] * travel, u[3] * travel),
        v[0] + min(v[2] * travel, v[3] * travel),
        v[1] + max(v[2] * travel, v[3] * travel),
    )


@compiled(inline="always")
def _cell_range(low, high, most):  # type: ignore[no-untyped-def]
    """First cell of an interval and one past its last, within the grid."""
    first = min(max(np.floor(low - _STRAY), 0.0), most)
    return int(first), int(min(max(np.floor(high + _STRAY) + 1.0, 0.0), most))


# Along a cell.
_PLACES = 8
# Of a place, the most that a ray crosses in a slice: below one, so that rounding adds none.
_CROSSED = 0.99
_EVERYWHERE = np.uint64(2**64 - 1)
# Rows are bytes, the upper one lowest; in a row the left place is the lowest bit.
_LEFT = np.uint64(0x0101010101010101)
_RIGHT = np.uint64(0x8080808080808080)


def layers_in_view(
    front_mm: NDArray[np.float32], back_mm: NDArray[np.float32], display: Display, pixel_mm: float
) -> NDArray[np.bool_]:
    """Mask of layer pixels that some ray of a display can meet.

    * `front_mm`, `back_mm`, (layers, rows, columns) float32: nearest first; fronts are -inf where
      there is no layer.

    Returns (layers, rows, columns) bool: the front surface always is; False where there is no
    layer.
    """
    is_in_view = np.isfinite(front_mm)
    if not is_in_view[1:].any():
        return is_in_view
    deeper = np.any(is_in_view[1:], axis=0, keepdims=True)[0]
    z_min, z_max = display.depth_range_mm
    # Samples may start off a pixel's centre, anywhere within it.
    slope = max(display.steepest_slopes) + display.pixel_pitch_mm / display.gap_mm
    travel = (z_max - z_min) * slope / pixel_mm  # cells
    bounds = np.linspace(z_max, z_min, 2 + int(travel * _PLACES / _CROSSED))
    # From farther away no ray gets there.
    part = (slice(None), *_bounding_slices(deeper, math.ceil(travel) + 1))
    is_in_view[part] = _follow_rays(front_mm[part], back_mm[part], bounds)
    return is_in_view


def _bounding_slices(cells: NDArray[np.bool_], margin: int) -> tuple[slice, slice]:
    """Rows and columns that contain all cells, with a margin on each side."""
    rows, columns = (np.flatnonzero(cells.any(axis=axis)) for axis in (1, 0))
    return (
        slice(max(rows[0] - margin, 0), rows[-1] + margin + 1),
        slice(max(columns[0] - margin, 0), columns[-1] + margin + 1),
    )


def _follow_rays(
    front: NDArray[np.float32], back: NDArray[np.float32], bounds: np.ndarray
) -> NDArray[np.bool_]:
    """`layers_in_view`, followed through slices between some depths, from near to far."""
    reachable = np.isfinite(front)
    cells = np.flatnonzero(reachable[1:].any(axis=0))
    fronts, backs = (values.reshape(len(values), -1)[1:, cells] for values in (front, back))
    hit = np.zeros(fronts.shape, bool)
    rays = np.full(front.shape[1:], _EVERYWHERE)
    across = np.empty_like(rays)
    top = np.inf  # whatever a ray begins in, it meets
    for end in bounds[1:]:
        _spread_across(rays, across)
        _spread_down(across, rays)
        hit |= (fronts >= end) & (backs <= top) & (rays.reshape(-1)[cells] != 0)
        rays[(front[0] >= end) & (back[0] <= end)] = 0
        rays.reshape(-1)[cells[((fronts >= end) & (backs <= end)).any(axis=0)]] = 0
        top = end
    reachable.reshape(len(reachable), -1)[1:, cells] &= hit
    return reachable


@compiled
def _spread_across(rays, out):  # type: ignore[no-untyped-def]
    """Rays spread to the places left and right of theirs; around the cells they are everywhere."""
    one_bit, seven = np.uint64(1), np.uint64(7)
    rows, columns = rays.shape
    for r in range(rows):
        for c in range(columns):
            own = rays[r, c]
            before = rays[r, c - 1] if c > 0 else _EVERYWHERE
            after = rays[r, c + 1] if c + 1 < columns else _EVERYWHERE
            own |= (own & ~_RIGHT) << one_bit | (own & ~_LEFT) >> one_bit
            out[r, c] = own | (before & _RIGHT) >> seven | (after & _LEFT) << seven


@compiled
def _spread_down(rays, out):  # type: ignore[no-untyped-def]
    """Rays spread to the places above and below theirs."""
    row, last = np.uint64(8), np.uint64(56)
    rows, columns = rays.shape
    for r in range(rows):
        for c in range(columns):
            own = rays[r, c]
            before = rays[r - 1, c] if r > 0 else _EVERYWHERE
            after = rays[r + 1, c] if r + 1 < rows else _EVERYWHERE
            out[r, c] = own | own << row | own >> row | before >> last | after << last
