"""Lists of the cells that rays of lenses visit, of one display and picture size.

If the picture has a whole number of pixels per lens pitch, the rays of one pixel of every lens meet
the same cells, shifted by whole lenses. The list of cells is built once.

With a whole number of panel pixels per lens as well, these rays are parallel: one list per
*direction* has the depths at which all lenses leave its cells (`Directions`). Otherwise (15.7
pixels per lens, and the like) exit depths differ a little from lens to lens, and are vectors along
a strip of lenses (`Passes`). Rays are separable, so depths are stored per panel row and per panel
column. Which lenses visit a cell, ``max(exits) < min(entries)``, does not depend on the picture: it
is stored, as float64 has it. All tables hold exits as float32, rounded up, and entries, rounded
down: they compare with a float32 depth as the exact ones do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from inim.backend.kernels import compiled, share_rows
from inim.display import Display
from inim.display.pixels import CENTRE, PixelOffset
from inim.generators.base import PictureShape
from inim.generators.raycast.cells import AxisRuns, CellRays, axis_runs, cell_rays, rounded_up
from inim.generators.raycast.phases import PhaseLayout, cells_per_pitch
from inim.generators.raycast.simd import LANES

#: Rays of a pixel of neighbouring lenses lean to the left or to the right.
SIDES = 2


class CellLists(NamedTuple):
    """Lists of the cells of rays, of one display and picture size.

    A *pass* is a ray of the pixels u of those lenses of a strip that visit cells in the same order.
    It has the number ``p = strip * strip_passes + u * sides + side``. On a row of lists, its list
    begins at ``first[(ray * list_rows + list_row) * passes + p]``.

    * `lens`, `list_row`, (panel rows,) int64: lens row, -1 where none; and row of lists.
    * `reach`, (list rows, 2) int64: see `PhaseLayout.row_reach`; of all rays.
    * `first`, (n,) int64: where the list of each pass begins.
    * `exit_mm`, (cells,) float32: depth at which a lens leaves a cell, rounded up; the least of all
      lenses.
    * `entry_mm`, (cells,) float32: depth at which it enters the cell, rounded down; a bound of all
      lenses.
    * `members`, (rays x passes,) uint32: lenses of a strip that take part in a pass, a bit each.
    * `passes`, `strip_passes`: passes of a ray; and of a strip, 0 if all strips share them.
    * `lens_first`, `lens_pixels`, (lens columns,) int64: first panel column of each lens, and how
      many it has.
    * `most_pixels`, `least_pixels`: largest and smallest of these numbers.
    * `has_gaps`: some panel columns have no lens.
    """

    lens: np.ndarray
    list_row: np.ndarray
    reach: np.ndarray
    first: np.ndarray
    exit_mm: np.ndarray
    entry_mm: np.ndarray
    members: np.ndarray
    passes: int
    strip_passes: int
    lens_first: np.ndarray
    lens_pixels: np.ndarray
    most_pixels: int
    least_pixels: int
    has_gaps: bool


class Directions(NamedTuple):
    """Cells of directions that all lenses share; their depths are those of `CellLists`.

    * `offset`, (cells,) int64: flat distance from slot (0, 0).
    """

    offset: np.ndarray


class Passes(NamedTuple):
    """Cells of rays whose exit depths differ between lenses, nearest first.

    Rays of a pass lean to one side.

    * `cell`, (n, 3) uint32: index in the row arrays and in the column arrays, and lenses that visit
      it, a bit each.
    * `row_offset`, (rows,) int64: see `PhaseLayout.row_offset`.
    * `row_exit_mm`, `row_entry_mm`: (rows,) float32.
    * `offset`, (columns,) int64: see `PhaseLayout.column_offset`.
    * `exit_mm`, `entry_mm`, (columns, LANES) float32: per lens; anything where a lens does not
      visit a cell.
    """

    cell: np.ndarray
    row_offset: np.ndarray
    row_exit_mm: np.ndarray
    row_entry_mm: np.ndarray
    offset: np.ndarray
    exit_mm: np.ndarray
    entry_mm: np.ndarray


Tables = tuple[PhaseLayout, CellLists, Directions | Passes]


@dataclass(frozen=True)
class DirectionLists:
    """Templates of one display and picture size; direction (v, u) has the index ``v * pixels + u``.

    * `first`, (pixels^2 + 1,) int64: start of each direction's entries.
    * `row`, `column`, (n,) int64: cells of the lens with index (0, 0); nearest first. Lens (m, n)
      adds ``per_pitch * (m, n)``.
    * `exit_mm`, `entry_mm`, (n,) float64: depths at which the ray leaves and enters them; inf for
      the first cells.
    """

    first: np.ndarray
    row: np.ndarray
    column: np.ndarray
    exit_mm: np.ndarray
    entry_mm: np.ndarray


def shares_directions(display: Display) -> bool:
    """True if co-located pixels of all elemental images have parallel rays, as templates need."""
    if not display.has_integer_ratio:
        return False
    pixels = round(display.pixels_per_lens)
    return all(
        axis.offset == axis.offset[:pixels] * (len(axis.offset) // pixels)
        for axis in (display.columns, display.rows)
    )


def build_lists(
    display: Display, shape: PictureShape, pixel_mm: float, pixel_offset: PixelOffset = CENTRE
) -> DirectionLists:
    """Templates by exact traversal, in float64, from the rays of the first lens."""
    assert shares_directions(display)
    pixels, depths = round(display.pixels_per_lens), display.depth_range_mm
    columns, rows = (
        axis_runs(CellRays(rays.start[:pixels], rays.slope[:pixels], rays.scale), depths)
        for rays in cell_rays(shape, pixel_mm, display, pixel_offset)
    )
    parts: list[tuple[np.ndarray, ...]] = []
    for row_cell, row_exit in zip(rows.cell, rows.exit_mm, strict=True):
        # All borders, nearest first, and once where a row's and a column's meet in a corner.
        exits = np.concatenate(
            [columns.exit_mm, np.broadcast_to(row_exit, (pixels, len(row_exit)))], axis=1
        )
        exits = -np.sort(-exits, axis=1)
        entries = np.roll(exits, 1, axis=1)
        entries[:, 0] = np.inf
        ends = exits < entries
        # The cell that a ray leaves is as far on as borders are above.
        column = np.count_nonzero(columns.exit_mm[:, None] > exits[..., None], axis=2)
        row = np.count_nonzero(row_exit > exits[..., None], axis=2)
        cells = row_cell[row], np.take_along_axis(columns.cell, column, axis=1), exits, entries
        parts.append((np.count_nonzero(ends, axis=1), *(values[ends] for values in cells)))
    count, *values = (np.concatenate(of_row) for of_row in zip(*parts, strict=True))
    return DirectionLists(np.concatenate([[0], np.cumsum(count)]), *values)


@lru_cache(maxsize=8)
def cell_tables(
    display: Display, shape: PictureShape, pixel_mm: float, offsets: tuple[PixelOffset, ...]
) -> Tables:
    """Tables of rays of a display over pictures of one size."""
    build = _direction_tables if shares_directions(display) else _pass_tables
    return build(display, shape, pixel_mm, offsets)


def _direction_tables(
    display: Display, shape: PictureShape, pixel_mm: float, offsets: tuple[PixelOffset, ...]
) -> Tables:
    per_pitch, pixels = cells_per_pitch(display, pixel_mm), round(display.pixels_per_lens)
    assert per_pitch is not None
    lenses = display.columns.lenses
    lists = [build_lists(display, shape, pixel_mm, offset) for offset in offsets]
    row, column, exit_mm, entry_mm = (
        np.concatenate([getattr(of_ray, name) for of_ray in lists])
        for name in ("row", "column", "exit_mm", "entry_mm")
    )
    layout = PhaseLayout.of(per_pitch, row, column, display)
    first = _joined_first([of_ray.first for of_ray in lists])
    reach = layout.row_reach(row, first[:-1:pixels]).reshape(len(offsets), pixels, 2)
    panel_rows = np.arange(display.eia_shape[0])
    return (
        layout,
        CellLists(
            display.rows.lens, panel_rows % pixels, _widest(reach), first,
            rounded_up(exit_mm), -rounded_up(-entry_mm),
            np.full(len(offsets) * pixels, 2**32 - 1, np.uint32), pixels, 0,
            np.arange(lenses) * pixels, np.full(lenses, pixels),
            pixels, pixels, False,
        ),
        Directions(layout.row_offset(row) + layout.column_offset(column)),
    )  # fmt: skip


def _joined_first(firsts: Sequence[np.ndarray]) -> np.ndarray:
    """Beginnings of lists that follow one another, from those of each ray."""
    counts = np.concatenate([np.diff(first) for first in firsts])
    return np.concatenate([[0], np.cumsum(counts)])


def _widest(reach: np.ndarray) -> np.ndarray:
    """Reach of all rays, (list rows, 2), from that of each, (rays, list rows, 2)."""
    return np.stack([reach[..., 0].min(axis=0), reach[..., 1].max(axis=0)], axis=1)


class _RayRuns(NamedTuple):
    """Runs of one ray of every pixel; cells as if under the lens 0."""

    row: np.ndarray
    column: np.ndarray
    rows: AxisRuns
    columns: AxisRuns


def _pass_tables(
    display: Display, shape: PictureShape, pixel_mm: float, offsets: tuple[PixelOffset, ...]
) -> Tables:
    per_pitch = cells_per_pitch(display, pixel_mm)
    assert per_pitch is not None
    row_lens, owner = display.rows.lens, display.columns.lens
    rays = []
    for offset in offsets:
        columns, rows = (
            axis_runs(axis, display.depth_range_mm)
            for axis in cell_rays(shape, pixel_mm, display, offset)
        )
        row, column = (
            runs.cell - per_pitch * lens[:, None]
            for runs, lens in ((rows, row_lens), (columns, owner))
        )
        rays.append(_RayRuns(row, column, rows, columns))
    layout = PhaseLayout.of(
        per_pitch,
        np.concatenate([ray.row[ray.rows.used & (row_lens >= 0)[:, None]] for ray in rays]),
        np.concatenate([ray.column[ray.columns.used & (owner >= 0)[:, None]] for ray in rays]),
        display,
    )
    lens_pixels = np.bincount(owner[owner >= 0], minlength=display.columns.lenses)
    lens_first = np.array([np.argmax(owner == n) for n in range(display.columns.lenses)])
    pixels = int(lens_pixels.max())
    parts = [_ray_passes(ray, owner, lens_first, pixels, layout) for ray in rays]
    row_first = [np.concatenate([[0], np.cumsum(ray.rows.count)]) for ray in rays]
    reach = [
        layout.row_reach(ray.row[ray.rows.used], first[:-1])
        for ray, first in zip(rays, row_first, strict=True)
    ]
    listed = [
        _find_pass_cells(row_lens, ray.rows, exits, entries)
        for ray, (*_, exits, entries) in zip(rays, parts, strict=True)
    ]
    rows_before, columns_before = 0, 0
    for ray, (_, cell), (column_offset, *_) in zip(rays, listed, parts, strict=True):
        cell[:, :2] += np.array([rows_before, columns_before], np.uint32)
        rows_before += ray.rows.count.sum()
        columns_before += column_offset.size
    used = [ray.rows.used for ray in rays]
    row, row_exit, row_entry = (
        np.concatenate([values[visited] for values, visited in zip(of_rays, used, strict=True)])
        for of_rays in (
            [ray.row for ray in rays],
            [ray.rows.exit_mm for ray in rays],
            [ray.rows.entry_mm for ray in rays],
        )
    )
    column_offset, members, exits, entries = (
        np.concatenate([values.reshape(-1, *values.shape[2:]) for values in of_rays])
        for of_rays in zip(*parts, strict=True)
    )
    exit_mm, row_exit, row_entry = rounded_up(exits), rounded_up(row_exit), -rounded_up(-row_entry)
    cell = np.concatenate([cell for _, cell in listed])
    nearest_exit = np.maximum(row_exit[cell[:, 0]], exit_mm.min(axis=1)[cell[:, 1]])
    return (
        layout,
        CellLists(
            row_lens, np.arange(len(row_lens)), _widest(np.stack(reach)),
            _joined_first([first for first, _ in listed]), nearest_exit,
            row_entry[cell[:, 0]], members,
            len(members) // len(offsets), SIDES * pixels, lens_first, lens_pixels, pixels,
            int(lens_pixels.min()), bool((owner < 0).any()),
        ),
        Passes(
            cell, layout.row_offset(row), row_exit, row_entry, column_offset, exit_mm,
            -rounded_up(-entries),
        ),
    )  # fmt: skip


def _ray_passes(
    ray: _RayRuns, owner: np.ndarray, lens_first: np.ndarray, pixels: int, layout: PhaseLayout
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Column cells of the passes of one ray.

    * `owner`, (panel columns,) int64: lens of each; -1 where none.
    * `lens_first`, (lenses,) int64: first panel column of each lens.

    Returned values:
    * `offset`, (passes, cells) int64: see `PhaseLayout.column_offset`.
    * `members`, (passes,) uint32: see `CellLists`.
    * `exits`, `entries`, (passes, cells, LANES) float64: inf and -inf where a lens does not visit a
      cell.
    """
    lenses, runs = len(lens_first), ray.columns
    last = np.take_along_axis(runs.cell, runs.count[:, None] - 1, axis=1)[:, 0]
    within = 2 * (np.arange(len(owner)) - lens_first[owner]) + (last >= runs.cell[:, 0])
    strips = -(-lenses // LANES)
    # Panel columns of each strip, with the number and the lane of their pass.
    column, number, lane = [], [], []
    for strip in range(strips):
        start = max(min(strip * LANES, lenses - LANES), 0)
        own = np.flatnonzero((owner >= start) & (owner < start + LANES))
        column.append(own)
        number.append(2 * pixels * strip + within[own])
        lane.append(owner[own] - start)
    of_column = np.concatenate(column)
    cells, used = ray.column[of_column], runs.used[of_column]
    number_of_run = np.repeat(np.concatenate(number), used.sum(axis=1))
    lane_of_run = np.repeat(np.concatenate(lane), used.sum(axis=1))
    # The nearest cell of any lens: the leftmost of rays that go right.
    step = np.tile([-1, 1], strips * pixels)
    along = step[number_of_run] * cells[used]
    nearest = np.full(len(step), np.iinfo(np.int64).max)
    np.minimum.at(nearest, number_of_run, along)
    nearest[nearest == np.iinfo(np.int64).max] = 0  # a pass without lenses
    rank = along - nearest[number_of_run]
    most = int(rank.max()) + 1
    exits = np.full((len(step), most, LANES), np.inf)
    entries = np.full((len(step), most, LANES), -np.inf)
    place = number_of_run, rank, lane_of_run
    exits[place], entries[place] = runs.exit_mm[of_column][used], runs.entry_mm[of_column][used]
    members = np.isfinite(exits).any(axis=1) @ (1 << np.arange(LANES))
    offset = layout.column_offset(step[:, None] * (nearest[:, None] + np.arange(most)))
    return offset, members.astype(np.uint32), exits, entries


def _find_pass_cells(
    lens: np.ndarray, rows: AxisRuns, exits: np.ndarray, entries: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find the cells that some lens of a pass visits, on every panel row: first and cells."""
    # Bounds of all cells from here on.
    latest = np.maximum.accumulate(entries.max(axis=2)[:, ::-1], axis=1)[:, ::-1]
    row_first = np.concatenate([[0], np.cumsum(rows.count)])
    depths = (
        row_first, lens, rows.exit_mm[rows.used], rows.entry_mm[rows.used], exits, entries,
        exits.min(axis=2), np.ascontiguousarray(latest),
    )  # fmt: skip
    count = np.zeros(len(lens) * len(exits), np.int64)
    share_rows(_find_cells, len(lens), *depths, count, np.empty((0, 3), np.uint32), False)
    first = np.concatenate([[0], np.cumsum(count)])
    cell = np.empty((first[-1], 3), np.uint32)
    share_rows(_find_cells, len(lens), *depths, first, cell, True)
    return first, cell


@compiled
def _find_cells(  # type: ignore[no-untyped-def]
    start, stop, row_first, lens, row_exit, row_entry, exits, entries, least_exit, latest, first,
    cell, write,
):  # fmt: skip
    """Count the cells of each pass on some panel rows, or write them."""
    passes, most, _ = exits.shape
    for r in range(start, stop):
        if lens[r] < 0:
            continue
        for p in range(passes):
            at, begin = 0, 0
            for i in range(row_first[r], row_first[r + 1]):
                # Cells left above this row's entry are left above those of all further rows.
                while begin < most and least_exit[p, begin] >= row_entry[i]:
                    begin += 1
                for q in range(begin, most):
                    if latest[p, q] <= row_exit[i]:
                        break
                    bits = np.uint32(0)
                    for n in range(LANES):
                        z_exit = max(exits[p, q, n], row_exit[i])
                        visits = z_exit < min(entries[p, q, n], row_entry[i])
                        bits |= np.uint32(visits) << np.uint32(n)
                    if bits:
                        if write:
                            place = first[r * passes + p] + at
                            cell[place, 0], cell[place, 1] = i, p * most + q
                            cell[place, 2] = bits
                        at += 1
            if not write:
                first[r * passes + p] = at
