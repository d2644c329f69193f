"""Traversal of a picture's cells ray by ray.

The traversal is that of Amanatides and Woo (Eurographics 1987). The depth at which a ray crosses a
border is a quotient of whole numbers (see `raycast.cells`), rounded once and computed independently
for each border: no error accumulates, and corners are exact.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from inim.backend.kernels import compiled, share_rows
from inim.display import Display
from inim.display.pixels import CENTRE, PixelOffset, row_blocks
from inim.generators.base import (
    HOLE,
    PictureShape,
    Search,
    SourceGenerator,
    Sources,
)
from inim.generators.raycast.cells import PictureRays
from inim.generators.raycast.columns import columns_of
from inim.image.rgbd import RGBD


@compiled
def leaves(cell, start, slope, scale):  # type: ignore[no-untyped-def]
    """Depth at which a ray leaves a cell in one axis; never, if it does not move in it."""
    if slope == 0.0:
        return -np.inf
    return ((cell if slope > 0 else cell + 1) * scale - start) / slope


@compiled
def entry_cell(start, slope, scale, z_max):  # type: ignore[no-untyped-def]
    """The cell a ray is in just below z_max; on a border, the one it is about to enter."""
    cell = int(np.floor((start + slope * z_max) / scale))
    if slope == 0.0:
        return cell
    step = -1 if slope > 0 else 1
    # The product is rounded, the borders' depths decide: at most one cell either way.
    while leaves(cell, start, slope, scale) >= z_max:
        cell += step
    while leaves(cell - step, start, slope, scale) < z_max:
        cell -= step
    return cell


@compiled
def first_hit(fronts, backs, continue_behind, u0, du, u1, v0, dv, v1, z_min, z_max):  # type: ignore[no-untyped-def]
    """Walk one ray from z_max down to z_min: the source of its first hit, or `HOLE`.

    `u` are columns and `v` rows, each as start, slope and scale of `CellRays`; the rest is as of
    `Columns`.
    """
    _, rows, columns = fronts.shape
    # z falls along the walk, so a ray with du < 0 moves to larger columns.
    step_u = -1 if du > 0 else 1
    step_v = -1 if dv > 0 else 1
    u, v = entry_cell(u0, du, u1, z_max), entry_cell(v0, dv, v1, z_max)
    z_u, z_v = leaves(u, u0, du, u1), leaves(v, v0, dv, v1)
    z_entry, passed_over, behind = np.inf, HOLE, False
    while True:
        z_exit = max(z_u, z_v, z_min)
        if 0 <= u < columns and 0 <= v < rows:
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


class FirstHits(SourceGenerator):
    """First hits in the columns of pictures.

    * `display`, `shape`, `pixel_mm`, `pixel_offset`, `mask`: as for `SourceGenerator`.
    * `rule`: see `raycast.columns`.
    """

    def __init__(
        self,
        display: Display,
        shape: PictureShape,
        pixel_mm: float,
        rule: str,
        pixel_offset: PixelOffset = CENTRE,
        mask: np.ndarray | None = None,
    ) -> None:
        super().__init__(display, shape, pixel_mm, mask, pixel_offset)
        self._rule = rule

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        sources = np.empty(self.display.eia_shape, np.int32)
        self.search(rgbd)(slice(0, len(sources)), sources)
        return sources


class RayByRay(FirstHits):
    """Separate traversal of every ray, in blocks of panel rows to limit memory.

    On separable displays, hits are exact. On hexagonal, rotated or tilted arrays, rays do not share
    rows or columns. Their coordinates are float64 from the pixel's position, not whole numbers:
    rounding may move a ray through a corner of cells, or at the exact height of a column, to either
    side.

    A ray starts at the nearest surface of the picture, because no cell that it leaves above can be
    hit. It passes over square tiles whose surfaces are all behind it, and visits cells from the
    last one before the first other tile on. No such bound exists below the farthest surface,
    because a ray under all surfaces hits the next column without a back. A ray inside an empty
    rectangle of the picture has no hit.
    """

    def search(self, rgbd: RGBD) -> Search:
        """See `SourceGenerator.search`."""
        columns = columns_of(rgbd, self._rule)
        surfaces = (columns.fronts(), columns.backs(), columns.continue_behind)
        z_min, z_max = self.display.depth_range_mm
        # Just above the nearest surface: a cell left exactly at its depth counts.
        z_max = min(z_max, float(np.nextafter(np.float64(surfaces[0][0].max()), np.inf)))
        above, selected = _covered_above(surfaces[0][0] > -np.inf), self.selected
        tops = _tile_tops(surfaces[0][0])

        def find_rows(rows: slice, out: Sources) -> None:
            out[...] = HOLE
            for block in row_blocks(self.display) if z_max > z_min else ():
                part = slice(max(block.start, rows.start), min(block.stop, rows.stop))
                if part.start < part.stop and selected[part].any():
                    share_rows(
                        _first_hits, part.stop - part.start, selected[part], *surfaces, above, tops,
                        self._rays.block(part), z_min, z_max,
                        out[part.start - rows.start : part.stop - rows.start],
                    )  # fmt: skip
            self.mark(rows, out)

        return find_rows

    @cached_property
    def _rays(self) -> PictureRays:
        return PictureRays(self.display, self.shape, self.pixel_mm, self.pixel_offset)


# Cells along a side of a tile.
_TILE = 8


def _tile_tops(front: np.ndarray) -> np.ndarray:
    """Nearest depth in each tile of a picture, from its upper left corner on."""
    rows, columns = (-(-n // _TILE) for n in front.shape)
    margins = [(0, n * _TILE - m) for n, m in zip((rows, columns), front.shape, strict=True)]
    padded = np.pad(front, margins, constant_values=-np.inf)
    tops: np.ndarray = padded.reshape(rows, _TILE, columns, _TILE).max(axis=(1, 3))
    return tops


@compiled
def _start_depth(tops, u0, du, u1, v0, dv, v1, z_min, z_max):  # type: ignore[no-untyped-def]
    """Depth above which a ray passes over the picture, in the cell it passes over last or before;
    -inf if it passes over all of it.
    """
    rows, columns = tops.shape
    step_u, step_v = -1 if du > 0 else 1, -1 if dv > 0 else 1
    # Last cell of a tile on the way, which the ray leaves where it leaves the tile.
    last_u, last_v = 0 if du > 0 else _TILE - 1, 0 if dv > 0 else _TILE - 1
    u, v = entry_cell(u0, du, u1, z_max) // _TILE, entry_cell(v0, dv, v1, z_max) // _TILE
    z_u, z_v = leaves(u * _TILE + last_u, u0, du, u1), leaves(v * _TILE + last_v, v0, dv, v1)
    z_entry = z_max
    while True:
        z_exit = max(z_u, z_v, z_min)
        if 0 <= u < columns and 0 <= v < rows and tops[v, u] >= z_exit:
            break
        if z_exit <= z_min:
            return -np.inf
        z_entry = z_exit
        if z_u >= z_exit:
            u += step_u
            z_u = leaves(u * _TILE + last_u, u0, du, u1)
        if z_v >= z_exit:
            v += step_v
            z_v = leaves(v * _TILE + last_v, v0, dv, v1)
    cells_per_mm = max(abs(du) / u1, abs(dv) / v1)
    # A border is crossed on the way: the cell before the tile is visited, too.
    return min(z_max, z_entry + 1.5 / cells_per_mm) if cells_per_mm > 0 else z_max


def _covered_above(covered: np.ndarray) -> np.ndarray:
    """Number of covered cells above and to the left of each corner, (H + 1, W + 1) int32."""
    count = np.zeros((covered.shape[0] + 1, covered.shape[1] + 1), np.int32)
    np.cumsum(np.cumsum(covered, axis=0), axis=1, out=count[1:, 1:])
    return count


@compiled
def _first_hits(  # type: ignore[no-untyped-def]
    begin, end, selected, fronts, backs, continue_behind, above, tops, rays, z_min, z_max, sources
):
    """`first_hit` of the selected pixels of some rows."""
    u0, du, v0, dv, u1, v1 = rays
    bottom, right = fronts.shape[1:]
    for i in range(begin, end):
        for j in range(sources.shape[1]):
            if not selected[i, j]:
                continue
            across, down = (u0[i, j], du[i, j], u1), (v0[i, j], dv[i, j], v1)
            left, right_end = _cells_between(*across, z_min, z_max, right)
            top, bottom_end = _cells_between(*down, z_min, z_max, bottom)
            upper = above[top, right_end] - above[top, left]
            if above[bottom_end, right_end] - above[bottom_end, left] > upper:
                z_start = _start_depth(tops, *across, *down, z_min, z_max)
                if z_start > z_min:
                    sources[i, j] = first_hit(
                        fronts, backs, continue_behind, *across, *down, z_min, z_start
                    )


@compiled
def _cells_between(start, slope, scale, z_min, z_max, cells):  # type: ignore[no-untyped-def]
    """First cell and end of a range of a picture's cells that has all that a ray visits."""
    a, b = (start + slope * z_min) / scale, (start + slope * z_max) / scale
    # One more on either side, because positions are rounded.
    low, high = np.floor(min(a, b)) - 1.0, np.floor(max(a, b)) + 2.0
    return int(min(max(low, 0.0), cells)), int(max(min(high, float(cells)), 0.0))
