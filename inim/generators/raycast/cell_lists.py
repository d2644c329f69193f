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

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from inim.display import Display
from inim.display.pixels import PixelOffset
from inim.generators.base import PictureShape
from inim.generators.raycast.cells import AxisRuns, CellRays, axis_runs, cell_rays, rounded_up
from inim.generators.raycast.phases import PhaseLayout, cells_per_pitch
from inim.generators.raycast.simd import LANES
from inim.system.backend.kernels import compiled, share_rows

#: Rays of a pixel of neighbouring lenses lean to the left or to the right.
SIDES = 2


class CellLists(NamedTuple):
    """Lists of the cells of one ray of every pixel, of one display and picture size.

    A *pass* is a ray of the pixels u of those lenses of a strip that visit cells in the same order.
    It has the number ``p = strip * strip_passes + u * sides + side``. On a row of lists, its list
    begins at ``first[list_row * len(members) + p]``.

    * `lens`, `list_row`, (panel rows,) int64: lens row, -1 where none; and row of lists.
    * `reach`, (list rows, 2) int64: see `PhaseLayout.row_reach`.
    * `first`, (n,) int64: where the list of each pass begins.
    * `exit_mm`, (cells,) float32: depth at which a lens leaves a cell, rounded up; the least of all
      lenses.
    * `entry_mm`, (cells,) float32: depth at which it enters the cell, rounded down; a bound of all
      lenses.
    * `members`, (passes,) uint32: lenses of a strip that take part in a pass, a bit each.
    * `strip_passes`: passes of a strip; 0 if all strips share them.
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
    strip_passes: int
    lens_first: np.ndarray
    lens_pixels: np.ndarray
    most_pixels: int
    least_pixels: int
    has_gaps: bool


class Directions(NamedTuple):
    """Cells of directions that all lenses share; their depths are those of `CellLists`.

    * `offset`, (cells,) int64: flat distance from slot (0, 0).
    * `source`, (cells,) int64: number of the cell in the picture, as if under the lens (0, 0).
    """

    offset: np.ndarray
    source: np.ndarray


class Passes(NamedTuple):
    """Cells of rays whose exit depths differ between lenses, nearest first.

    Rays of a pass lean to one side.

    * `cell`, (n, 3) uint32: index in the row arrays and in the column arrays, and lenses that visit
      it, a bit each.
    * `row_offset`, `row_source`, (rows,) int64: of `PhaseLayout.row_offset`, and of the numbers of
      cells in the picture; add those of a column.
    * `row_exit_mm`, `row_entry_mm`: (rows,) float32.
    * `offset`, `source`, (columns,) int64.
    * `exit_mm`, `entry_mm`, (columns, LANES) float32: per lens; anything where a lens does not
      visit a cell.
    """

    cell: np.ndarray
    row_offset: np.ndarray
    row_source: np.ndarray
    row_exit_mm: np.ndarray
    row_entry_mm: np.ndarray
    offset: np.ndarray
    source: np.ndarray
    exit_mm: np.ndarray
    entry_mm: np.ndarray


#: Memory layout of pictures; lists and cells of each ray.
Tables = tuple[PhaseLayout, list[tuple[CellLists, Directions | Passes]]]


def shares_directions(display: Display) -> bool:
    """True if co-located pixels of all elemental images have parallel rays, as templates need."""
    if not display.has_integer_ratio:
        return False
    pixels = int(display.pixels_per_lens)
    return all(
        axis.offset == axis.offset[:pixels] * (len(axis.offset) // pixels)
        for axis in (display.columns, display.rows)
    )


class _RayRuns(NamedTuple):
    """Runs of one ray of the listed panel rows and columns; cells as if under the lens (0, 0).

    * `row_lens`, `column_lens`: lens of each, -1 where none.
    """

    row: np.ndarray
    column: np.ndarray
    rows: AxisRuns
    columns: AxisRuns
    row_lens: np.ndarray
    column_lens: np.ndarray


@lru_cache(maxsize=8)
def cell_tables(
    display: Display, shape: PictureShape, pixel_mm: float, offsets: tuple[PixelOffset, ...]
) -> Tables:
    """Tables of rays of a display over pictures of one size."""
    rays = [_find_runs(display, shape, pixel_mm, offset) for offset in offsets]
    layout = PhaseLayout.of(
        cells_per_pitch(display, pixel_mm),
        np.concatenate([r.row[r.rows.used & (r.row_lens >= 0)[:, None]] for r in rays]),
        np.concatenate([r.column[r.columns.used & (r.column_lens >= 0)[:, None]] for r in rays]),
        display,
    )
    return layout, [_list_cells(ray, display, shape[1], layout) for ray in rays]


def _find_runs(
    display: Display, shape: PictureShape, pixel_mm: float, offset: PixelOffset
) -> _RayRuns:
    """Runs of the ray through one point of every pixel, or of the first lens if it serves all."""
    listed = slice(round(display.pixels_per_lens) if shares_directions(display) else None)
    columns, rows = (
        axis_runs(
            CellRays(rays.start[listed], rays.slope[listed], rays.scale), display.traced_range_mm
        )
        for rays in cell_rays(shape, pixel_mm, display, offset)
    )
    row_lens, column_lens = (axis.lens[listed] for axis in (display.rows, display.columns))
    row, column = (
        runs.cell - cells_per_pitch(display, pixel_mm) * lens[:, None]
        for runs, lens in ((rows, row_lens), (columns, column_lens))
    )
    return _RayRuns(row, column, rows, columns, row_lens, column_lens)


def _list_cells(
    ray: _RayRuns, display: Display, width: int, layout: PhaseLayout
) -> tuple[CellLists, Directions | Passes]:
    """Lists and cells of one ray over a picture of some width."""
    are_shared = shares_directions(display)
    lens_first, lens_end = display.columns.elemental_images()
    lens_pixels, sides = lens_end - lens_first, 1 if are_shared else SIDES
    pixels = int(lens_pixels.max())
    column, members, exits, entries = _column_passes(
        ray, lens_first[: 1 if are_shared else None], pixels, sides
    )
    first, cell = _find_cells(ray.row_lens, ray.rows, exits, entries)
    row, row_exit, row_entry = (
        values[ray.rows.used] for values in (ray.row, ray.rows.exit_mm, ray.rows.entry_mm)
    )
    row_exit, row_entry = rounded_up(row_exit), -rounded_up(-row_entry)
    exits, entries = rounded_up(exits), -rounded_up(-entries)
    exits, entries, column = exits.reshape(-1, LANES), entries.reshape(-1, LANES), column.ravel()
    row_offset, row_source = layout.row_offset(row), width * row
    offset, i, q = layout.column_offset(column), cell[:, 0], cell[:, 1]
    entry_mm, cells = row_entry[i], None
    if are_shared:
        entry_mm = np.minimum(entry_mm, entries.max(axis=1)[q])
        cells = Directions(row_offset[i] + offset[q], row_source[i] + column[q])
    lists = CellLists(
        display.rows.lens, np.arange(len(display.rows.lens)) % len(ray.row_lens),
        layout.row_reach(row, np.concatenate([[0], np.cumsum(ray.rows.count[:-1])])), first,
        np.maximum(row_exit[i], exits.min(axis=1)[q]), entry_mm, members,
        0 if are_shared else sides * pixels, lens_first, lens_pixels, pixels,
        int(lens_pixels.min()), bool((display.columns.lens < 0).any()),
    )  # fmt: skip
    return lists, cells or Passes(
        cell, row_offset, row_source, row_exit, row_entry, offset, column, exits, entries
    )


def _column_passes(
    ray: _RayRuns, lens_first: np.ndarray, pixels: int, sides: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Column cells of the passes of one ray.

    * `lens_first`, (listed lenses,) int64: first panel column of each lens.
    * `sides`: of a pixel; 1 if all of its rays lean to the same side.

    Returned values:
    * `column`, (passes, cells) int64: nearest first, as if under lens column 0.
    * `members`, (passes,) uint32: see `CellLists`.
    * `exits`, `entries`, (passes, cells, LANES) float64: inf and -inf where a lens does not visit a
      cell.
    """
    lenses, runs, owner = len(lens_first), ray.columns, ray.column_lens
    last = np.take_along_axis(runs.cell, runs.count[:, None] - 1, axis=1)[:, 0]
    is_right = last >= runs.cell[:, 0]
    within = sides * (np.arange(len(owner)) - lens_first[owner]) + (sides - 1) * is_right
    strips = -(-lenses // LANES)
    # Panel columns of each strip, with the number and the lane of their pass.
    column, number, lane = [], [], []
    for strip in range(strips):
        start = max(min(strip * LANES, lenses - LANES), 0)
        own = np.flatnonzero((owner >= start) & (owner < start + LANES))
        column.append(own)
        number.append(sides * pixels * strip + within[own])
        lane.append(owner[own] - start)
    of_column, of_pass = np.concatenate(column), np.concatenate(number)
    cells, used = ray.column[of_column], runs.used[of_column]
    number_of_run = np.repeat(of_pass, used.sum(axis=1))
    lane_of_run = np.repeat(np.concatenate(lane), used.sum(axis=1))
    # The nearest cell of any lens: the leftmost of rays that go right.
    step = np.ones(sides * pixels * strips, np.int64)
    step[of_pass] = np.where(is_right[of_column], 1, -1)
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
    columns = step[:, None] * (nearest[:, None] + np.arange(most))
    return columns, members.astype(np.uint32), exits, entries


def _find_cells(
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
    share_rows(_write_cells, len(lens), *depths, count, np.empty((0, 3), np.uint32), False)
    first = np.concatenate([[0], np.cumsum(count)])
    cell = np.empty((first[-1], 3), np.uint32)
    share_rows(_write_cells, len(lens), *depths, first, cell, True)
    return first, cell


@compiled
def _write_cells(  # type: ignore[no-untyped-def]
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
