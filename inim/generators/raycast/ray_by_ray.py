"""Traversal of a picture's cells ray by ray.

The traversal is that of Amanatides and Woo (Eurographics 1987). The depth at which a ray crosses a
border is a quotient of whole numbers (see `raycast.cells`), rounded once and computed independently
for each border: no error accumulates, and corners are exact.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import numpy as np

from inim.display.pixels import least_gap_mm, row_blocks
from inim.generators.base import HOLE, PanelRays, RaySearch, Sources
from inim.generators.raycast.cells import PictureRays
from inim.generators.raycast.columns import Columns, columns_of, visible_depth
from inim.image.rgbd import RGBD
from inim.system.backend.kernels import compiled, share_rows

# Cells along a side of a tile; a power of two, so that borders of tiles are exact, too.
_TILE = 8


class TracedSurfaces(NamedTuple):
    """Columns of a picture for `first_hit`.

    * `fronts`, `backs`, `continue_behind`: as of `Columns`.
    * `tops`, float32: nearest depth in each square tile, from the upper left corner on.
    """

    fronts: np.ndarray
    backs: np.ndarray
    tops: np.ndarray
    continue_behind: bool

    @classmethod
    def of(cls, columns: Columns) -> TracedSurfaces:
        """Surfaces of columns."""
        fronts = np.stack([visible_depth(layer) for layer in columns.layers])
        backs = np.stack([layer.back_mm for layer in columns.layers])
        rows, width = (-(-n // _TILE) for n in fronts.shape[1:])
        margins = [(0, n * _TILE - m) for n, m in zip((rows, width), fronts.shape[1:], strict=True)]
        padded = np.pad(fronts[0], margins, constant_values=-np.inf)
        tops = padded.reshape(rows, _TILE, width, _TILE).max(axis=(1, 3))
        return cls(fronts, backs, tops, columns.continue_behind)


@compiled
def leaves(cell, start, slope, scale):  # type: ignore[no-untyped-def]
    """Depth at which a ray leaves a cell in one axis; never, if it does not move in it."""
    if slope == 0.0:
        return -np.inf
    return ((cell if slope > 0 else cell + 1) * scale - start) / slope


@compiled
def _enter(z, start, slope, scale):  # type: ignore[no-untyped-def]
    """The cell a ray is in just below a depth, and where it leaves it; on a border, the one it is
    about to enter.
    """
    cell = int(np.floor((start + slope * z) / scale))
    if slope == 0.0:
        return cell, -np.inf
    # The product is rounded, the borders' depths decide: at most one cell either way.
    step = -1 if slope > 0 else 1
    z_entry, z_exit = leaves(cell - step, start, slope, scale), leaves(cell, start, slope, scale)
    while z_exit >= z:
        cell += step
        z_entry, z_exit = z_exit, leaves(cell, start, slope, scale)
    while z_entry < z:
        cell -= step
        z_entry, z_exit = leaves(cell - step, start, slope, scale), z_entry
    return cell, z_exit


@compiled
def first_hit(surfaces, u0, du, u1, v0, dv, v1, z_min, z_max):  # type: ignore[no-untyped-def]
    """Walk one ray from z_max down to z_min: the source of its first hit, or `HOLE`.

    * `surfaces`: see `TracedSurfaces`.
    * `u0`, `du`, `u1`; `v0`, `dv`, `v1`: start, slope and scale of columns and rows, as of
      `CellRays`.
    """
    fronts, backs, tops, continue_behind = surfaces
    _, rows, columns = fronts.shape
    # z falls along the walk, so a ray with du < 0 moves to larger columns.
    step_u = -1 if du > 0 else 1
    step_v = -1 if dv > 0 else 1
    cells_per_mm = max(abs(du) / u1, abs(dv) / v1)
    # The walk visits tiles until one is as high as the ray, then cells.
    in_tiles, u1, v1 = True, _TILE * u1, _TILE * v1
    (u, z_u), (v, z_v) = _enter(z_max, u0, du, u1), _enter(z_max, v0, dv, v1)
    z_entry, passed_over, behind = np.inf, HOLE, False
    while True:
        z_exit = max(z_u, z_v, z_min)
        if in_tiles:
            if 0 <= u < tops.shape[1] and 0 <= v < tops.shape[0] and tops[v, u] >= z_exit:
                # A border is crossed on the way: the cell before the tile is visited, too.
                if cells_per_mm > 0:
                    z_max = min(z_max, z_entry + 1.5 / cells_per_mm)
                in_tiles, u1, v1, z_entry = False, u1 / _TILE, v1 / _TILE, np.inf
                (u, z_u), (v, z_v) = _enter(z_max, u0, du, u1), _enter(z_max, v0, dv, v1)
                continue
        elif 0 <= u < columns and 0 <= v < rows:
            hit = _is_hit(fronts, backs, v, u, z_entry, z_exit)
            if hit >= 0:
                return (hit * rows + v) * columns + u
            if hit == _OVER:
                passed_over = v * columns + u
            elif hit == _OVER_NOTHING:
                passed_over = HOLE
            else:
                behind = True
        if z_exit <= z_min:
            return passed_over if behind and continue_behind else HOLE
        z_entry = z_exit
        if z_u >= z_exit:
            u += step_u
            z_u = leaves(u, u0, du, u1)
        if z_v >= z_exit:
            v += step_v
            z_v = leaves(v, v0, dv, v1)


# How a ray leaves a cell of the picture in which it hits no layer.
_OVER, _OVER_NOTHING, _BEHIND = -1, -2, -3


@compiled
def _is_hit(fronts, backs, row, column, z_entry, z_exit):  # type: ignore[no-untyped-def]
    """The layer that a ray hits in a cell between two depths, or how it leaves it."""
    front = fronts[0, row, column]
    if front < z_exit:
        return _OVER if front > -np.inf else _OVER_NOTHING
    for layer in range(len(fronts)):
        if fronts[layer, row, column] < z_exit:
            break
        if backs[layer, row, column] <= z_entry:
            return layer
    return _BEHIND


class RayByRay:
    """Separate traversal of every ray, in blocks of panel rows to limit memory.

    On separable displays, hits are exact. On hexagonal, rotated or tilted arrays, rays do not share
    rows or columns. Their coordinates are float64 from the pixel's position, not whole numbers:
    rounding may move a ray through a corner of cells, or at the exact height of a column, to either
    side.

    A ray starts at the nearest surface of the picture, because no cell that it leaves above can be
    hit. It first walks over pictures of tiles, as high as the nearest surface in each: the walk
    over cells starts just above the first tile that it hits. No such bound exists below the
    farthest surface, because a ray under all surfaces hits the next column without a back.
    """

    def __init__(self, rays: PanelRays, rule: str) -> None:
        self._rays, self._rule = rays, rule
        self._display, self._shape, self._pixel_mm = rays.display, rays.shape, rays.pixel_mm

    @cached_property
    def _lines(self) -> list[PictureRays]:
        size = self._display, self._shape, self._pixel_mm
        return [PictureRays(*size, offset) for offset in self._rays.offsets]

    def take(self, rgbd: RGBD) -> RaySearch:
        """Prepare a picture for all rays; see `SourceFinder`."""
        surfaces, selected = TracedSurfaces.of(columns_of(rgbd, self._rule)), self._rays.selected
        front = surfaces.fronts[0]
        z_min, z_max = self._display.traced_range_mm
        # Just above the nearest surface: a cell left exactly at its depth counts.
        z_max = min(z_max, float(np.nextafter(np.float64(front.max()), np.inf)))
        above = _covered_above(front > -np.inf)
        columns_in_reach = self._columns_in_reach(above)

        def find_rows(ray: int, rows: slice, out: Sources) -> None:
            out[...] = HOLE
            for block in row_blocks(self._display) if z_max > z_min else ():
                part = slice(max(block.start, rows.start), min(block.stop, rows.stop))
                columns = columns_in_reach(part) if part.start < part.stop else slice(0, 0)
                if columns.start < columns.stop and selected[part].any():
                    share_rows(
                        _first_hits, part.stop - part.start, columns.start, selected[part],
                        surfaces, above, self._lines[ray].block(part, columns), z_min, z_max,
                        out[part.start - rows.start : part.stop - rows.start],
                    )  # fmt: skip

        return find_rows

    def _columns_in_reach(self, above: np.ndarray) -> Callable[[slice], slice]:
        """Function that returns panel columns of some rows: the rays of no others meet a surface.

        * `above`: see `_covered_above`.
        """
        display, (height, width) = self._display, self._shape
        pitch, (panel_rows, panel_columns) = display.pixel_pitch_mm, display.eia_shape
        farthest = max(map(abs, display.traced_range_mm)) / least_gap_mm(display)
        across, up = (
            ((1 + farthest) * crossing + pitch + self._pixel_mm) / self._pixel_mm
            for crossing in display.layout.farthest_crossings_mm
        )
        per_cell = pitch / self._pixel_mm

        def columns_of_rows(rows: slice) -> slice:
            first, last = (
                height / 2 + (row - panel_rows / 2) * per_cell for row in (rows.start, rows.stop)
            )
            top, bottom = np.clip([first - up, last + up + 1], 0, height).astype(int)
            is_covered = np.diff(above[bottom]) > np.diff(above[top])
            covered = np.flatnonzero(is_covered)
            if not len(covered):
                return slice(0, 0)
            ends = np.array([covered[0] - across, covered[-1] + 1 + across]) - width / 2
            low, high = np.clip(ends / per_cell + panel_columns / 2 + (0, 1), 0, panel_columns)
            return slice(int(low), int(high))

        return columns_of_rows


def _covered_above(covered: np.ndarray) -> np.ndarray:
    """Number of covered cells above and to the left of each corner, (H + 1, W + 1) int32."""
    count = np.zeros((covered.shape[0] + 1, covered.shape[1] + 1), np.int32)
    np.cumsum(np.cumsum(covered, axis=0), axis=1, out=count[1:, 1:])
    return count


@compiled
def _first_hits(  # type: ignore[no-untyped-def]
    begin, end, first, selected, surfaces, above, rays, z_min, z_max, sources
):
    """`first_hit` of the selected pixels of some rows, whose rays begin with a column `first`."""
    u0, du, v0, dv, u1, v1 = rays
    bottom, right = surfaces.fronts.shape[1:]
    per_u1, per_v1 = 1.0 / u1, 1.0 / v1
    for i in range(begin, end):
        for j in range(u0.shape[1]):
            if not selected[i, first + j]:
                continue
            left, right_end = _cells_between(u0[i, j], du[i, j], per_u1, z_min, z_max, right)
            top, bottom_end = _cells_between(v0[i, j], dv[i, j], per_v1, z_min, z_max, bottom)
            upper = above[top, right_end] - above[top, left]
            if above[bottom_end, right_end] - above[bottom_end, left] > upper:
                sources[i, first + j] = first_hit(
                    surfaces, u0[i, j], du[i, j], u1, v0[i, j], dv[i, j], v1, z_min, z_max
                )


@compiled(inline="always")
def _cells_between(start, slope, per_scale, z_min, z_max, cells):  # type: ignore[no-untyped-def]
    """First cell and end of a range of a picture's cells that has all that a ray visits."""
    a, b = (start + slope * z_min) * per_scale, (start + slope * z_max) * per_scale
    # One more on either side, because positions are rounded.
    low, high = np.floor(min(a, b)) - 1.0, np.floor(max(a, b)) + 2.0
    return int(min(max(low, 0.0), cells)), int(max(min(high, float(cells)), 0.0))
