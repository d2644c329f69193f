"""Traversal of a picture's cells ray by ray.

The traversal is that of Amanatides and Woo (Eurographics 1987). The depth at which a ray crosses a
border is a quotient of whole numbers (see `raycast.cells`), rounded once and computed independently
for each border: no error accumulates, and corners are exact. `RayByRay` uses the runs of a ray's
row and column, each computed once; `NonSeparable` serves rays that share neither.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from inim.backend.kernels import compiled, prange
from inim.display import Display
from inim.display.pixels import pixel_rays, row_blocks
from inim.generators.base import (
    CENTRE,
    HOLE,
    PictureShape,
    PixelOffset,
    Search,
    SourceGenerator,
    Sources,
)
from inim.generators.raycast.cells import CellRays, cell_rays, non_separable_cell_rays
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


@compiled
def walk(u0, du, u1, v0, dv, v1, z_min, z_max, cells, exits):  # type: ignore[no-untyped-def]
    """The cells a ray visits from z_max down to z_min, and the depths at which it leaves them.

    Fills ``cells[:n] = (row, column)`` and ``exits[:n]``; returns n.
    """
    step_u = -1 if du > 0 else 1
    step_v = -1 if dv > 0 else 1
    u, v = entry_cell(u0, du, u1, z_max), entry_cell(v0, dv, v1, z_max)
    z_u, z_v = leaves(u, u0, du, u1), leaves(v, v0, dv, v1)
    n = 0
    while True:
        z_exit = max(z_u, z_v, z_min)
        cells[n, 0], cells[n, 1], exits[n] = v, u, z_exit
        n += 1
        if z_exit <= z_min:
            return n
        if z_u >= z_exit:
            u += step_u
            z_u = leaves(u, u0, du, u1)
        if z_v >= z_exit:
            v += step_v
            z_v = leaves(v, v0, dv, v1)


def rounded_up(values: np.ndarray) -> np.ndarray:
    """The smallest float32 that is not below each float64."""
    near = values.astype(np.float32)
    above = np.nextafter(near, np.float32(np.inf))
    return np.where(near.astype(np.float64) < values, above, near)


@dataclass(frozen=True)
class AxisRuns:
    """Cells of each panel column's (or row's) ray along that axis, nearest first.

    A ray's cells in the picture are the overlaps of its column runs with its row runs.

    Attributes
    ----------
    first : (n + 1,) int64
        Where each panel column's runs begin.
    cell : (m,) int64
        Picture column (row).
    exit_mm : (m,) float64
        Depth at which the ray leaves it, z_min at the end.
    """

    first: np.ndarray
    cell: np.ndarray
    exit_mm: np.ndarray


def axis_runs(rays: CellRays, depth_range_mm: tuple[float, float]) -> AxisRuns:
    """The runs of all rays of one axis."""
    z_min, z_max = depth_range_mm
    most = rays.most_cells(depth_range_mm)
    cells = np.empty((len(rays.start), most), np.int64)
    exits = np.empty((len(rays.start), most))
    counts = np.empty(len(rays.start), np.int64)
    _walk_axis(rays.start, rays.slope, rays.scale, z_min, z_max, cells, exits, counts)
    used = np.arange(most) < counts[:, None]
    first = np.concatenate([[0], np.cumsum(counts)])
    return AxisRuns(first, cells[used], exits[used])


@compiled
def _walk_axis(start, slope, scale, z_min, z_max, cells, exits, counts):  # type: ignore[no-untyped-def]
    for i in range(len(start)):
        step = -1 if slope[i] > 0 else 1
        cell = entry_cell(start[i], slope[i], scale, z_max)
        n = 0
        while True:
            z = max(leaves(cell, start[i], slope[i], scale), z_min)
            cells[i, n], exits[i, n] = cell, z
            n += 1
            if z <= z_min:
                break
            cell += step
        counts[i] = n


class FirstHits(SourceGenerator):
    """First hits in the columns of pictures.

    Parameters
    ----------
    display, shape, pixel_mm, pixel_offset, mask :
        As for `SourceGenerator`.
    rule : str
        See `raycast.columns`.
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
        self._prepare()

    def _prepare(self) -> None:
        """Compute the data shared by all pictures."""

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        sources = np.empty(self.display.eia_shape, np.int32)
        self.search(rgbd)(slice(0, len(sources)), sources)
        return sources


class RayByRay(FirstHits):
    """Separate traversal of every ray, over the runs of its row and column, on separable displays.

    Hits are those of `first_hit`: the depths of its borders, in float64, are those of the runs,
    each computed once for its row or column and not for every ray. Runs with exits above the
    nearest surface of all cannot hit and are skipped. No such bound exists below the farthest
    surface, because a ray under all surfaces hits the next column without a back. A ray inside an
    empty rectangle of the picture has no hit.
    """

    def _prepare(self) -> None:
        self._columns, self._rows = (
            axis_runs(rays, self.display.depth_range_mm)
            for rays in cell_rays(self.shape, self.pixel_mm, self.display, self.pixel_offset)
        )

    def search(self, rgbd: RGBD) -> Search:
        """See `SourceGenerator.search`."""
        columns = columns_of(rgbd, self._rule)
        fronts, backs = columns.fronts(), columns.backs()
        nearest, z_min = float(fronts[0].max()), self._rows.exit_mm[-1]  # where all rays end
        runs = [
            _below(axis, nearest, cells)
            for axis, cells in zip((self._rows, self._columns), self.shape, strict=True)
        ]
        surfaces = (fronts, backs, columns.continue_behind, z_min)
        above, selected = _covered_above(fronts[0] > -np.inf), self.selected

        def find_rows(rows: slice, out: Sources) -> None:
            _first_hits(rows.start, selected[rows], *runs, above, *surfaces, out)
            self.mark(rows, out)

        return find_rows


def _below(runs: AxisRuns, nearest_mm: float, cells: int) -> tuple[np.ndarray, ...]:
    """Runs left no nearer than a surface, or the last one, of every panel column (or row).

    Returns
    -------
    begin : (n,) int64
        The first of them.
    cell, exit_mm : (m,)
        See `AxisRuns`.
    low, high : (n,) int64
        Their cells, of those that the picture has; `high` excluded.
    """
    above = np.concatenate([[0], np.cumsum(runs.exit_mm > nearest_mm)])
    begin = runs.first[:-1] + above[runs.first[1:]] - above[runs.first[:-1]]
    last = runs.first[1:] - 1
    begin = np.minimum(begin, last)
    ends = runs.cell[begin], runs.cell[last]
    low, high = np.clip(np.minimum(*ends), 0, cells), np.clip(np.maximum(*ends) + 1, 0, cells)
    return begin, runs.cell, runs.exit_mm, low, high


def _covered_above(covered: np.ndarray) -> np.ndarray:
    """Number of covered cells above and to the left of each corner, (H + 1, W + 1) int32."""
    count = np.zeros((covered.shape[0] + 1, covered.shape[1] + 1), np.int32)
    np.cumsum(np.cumsum(covered, axis=0), axis=1, out=count[1:, 1:])
    return count


@compiled(parallel=True)
def _first_hits(  # type: ignore[no-untyped-def]
    first, selected, rows, columns, above, fronts, backs, continue_behind, z_min, sources
):
    """First hits of the selected pixels of panel rows from the first on."""
    tops, bottoms, lefts, rights = rows[3], rows[4], columns[3], columns[4]
    for line in prange(sources.shape[0]):
        i = first + np.int64(line)
        # Covered cells to the left, among the rows of cells that this panel row's rays visit.
        to_the_left = above[bottoms[i]] - above[tops[i]]
        for j in range(sources.shape[1]):
            sources[line, j] = HOLE
            if selected[line, j] and to_the_left[rights[j]] > to_the_left[lefts[j]]:
                sources[line, j] = _first_hit(
                    rows, i, columns, j, fronts, backs, continue_behind, z_min
                )


@compiled
def _first_hit(rows, i, columns, j, fronts, backs, continue_behind, z_min):  # type: ignore[no-untyped-def]
    """The source of the first hit of panel pixel (i, j), or `HOLE`; as `first_hit`."""
    row_begin, row_cell, row_exit = rows[:3]
    column_begin, column_cell, column_exit = columns[:3]
    _, high, wide = fronts.shape
    r, c = row_begin[i], column_begin[j]
    entry_depth, passed_over, behind = np.inf, HOLE, False
    while True:
        row_depth, column_depth = row_exit[r], column_exit[c]
        exit_depth = max(row_depth, column_depth)
        row, column = row_cell[r], column_cell[c]
        if 0 <= row < high and 0 <= column < wide:
            hit = _is_hit(fronts, backs, row, column, entry_depth, exit_depth)
            if hit >= 0:
                return (hit * high + row) * wide + column
            if hit == _OVER:
                passed_over = row * wide + column
            elif hit == _OVER_NOTHING:
                passed_over = HOLE
            else:
                behind = True
        if exit_depth <= z_min:
            return passed_over if behind and continue_behind else HOLE
        entry_depth = exit_depth
        r += row_depth >= exit_depth
        c += column_depth >= exit_depth


class NonSeparable(FirstHits):
    """First hits of rays without shared rows or columns: hexagonal, rotated or tilted arrays.

    Each ray is traced separately, in blocks of panel rows to limit memory. Coordinates are float64
    from the pixel's position, not whole numbers: rounding may move a ray through a corner of cells,
    or at the exact height of a column, to either side.
    """

    def search(self, rgbd: RGBD) -> Search:
        """See `SourceGenerator.search`."""
        return SourceGenerator.search(self, rgbd)

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        columns = columns_of(rgbd, self._rule)
        fronts, backs = columns.fronts(), columns.backs()
        z_min, z_max = self.display.depth_range_mm
        # Above the nearest surface nothing is hit; just above it, a cell left exactly there counts.
        z_max = min(z_max, float(np.nextafter(np.float64(fronts[0].max()), np.inf)))
        sources: Sources = np.full(self.display.eia_shape, HOLE, np.int32)
        if z_max <= z_min:
            return sources
        surfaces = (fronts, backs, columns.continue_behind)
        for rows, cells in ray_blocks(self):
            _free_first_hits(self.selected[rows], *surfaces, cells, z_min, z_max, sources[rows])
        return sources


def ray_blocks(
    generator: SourceGenerator,
) -> Iterator[tuple[slice, tuple[np.ndarray, ...]]]:
    """Rays of blocks of panel rows with selected pixels.

    Yields
    ------
    rows : slice
    cells : four (block rows, columns) float64
        See `non_separable_cell_rays`.
    """
    pixel_offset = float(generator.pixel_offset[0]), float(generator.pixel_offset[1])
    for rows in row_blocks(generator.display):
        if generator.selected[rows].any():
            rays = pixel_rays(generator.display, rows, pixel_offset)
            yield rows, non_separable_cell_rays(generator.shape, generator.pixel_mm, rays)


@compiled(parallel=True)
def _free_first_hits(selected, fronts, backs, continue_behind, rays, z_min, z_max, sources):  # type: ignore[no-untyped-def]
    """`first_hit` of the selected pixels, into `sources`; rays as of `non_separable_cell_rays`."""
    u0, du, v0, dv = rays
    for i in prange(sources.shape[0]):
        for j in range(sources.shape[1]):
            if selected[i, j]:
                sources[i, j] = first_hit(
                    fronts, backs, continue_behind,
                    u0[i, j], du[i, j], 1.0, v0[i, j], dv[i, j], 1.0, z_min, z_max,
                )  # fmt: skip
