"""First hits where no two lenses share a direction: 15.7 pixels per lens, and the like.

With a whole number of picture cells per pitch, lenses still meet the same cells, moved by whole
lenses; only the depths at which the u-th pixel of each lens leaves them differ a little from lens
to lens. So a strip of neighbouring lenses is worked on at once, as in `raycast.polyphase`, with
exit depths that are vectors along the strip.

Rays are separable, so depths are stored per panel row and per panel column, as float32 that compare
with a depth as the exact ones do. Which lenses visit a cell, ``max(exits) < min(entries)``, does
not depend on the picture: it is stored, as float64 has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from inim.backend.kernels import compiled, prange
from inim.display import Display
from inim.generators.base import PictureShape, PixelOffset
from inim.generators.raycast.cells import cell_rays
from inim.generators.raycast.columns import SOLID, Columns
from inim.generators.raycast.polyphase import (
    Layout,
    PhaseGenerator,
    Phases,
    cells_per_pitch,
    farthest_end,
    nearest_surface,
    write_strip,
)
from inim.generators.raycast.ray_by_ray import AxisRuns, axis_runs, rounded_up
from inim.generators.raycast.simd import (
    LANES,
    and_flags,
    any_lane,
    at_least,
    but_not,
    choose,
    either,
    lanes_of,
    less,
    load,
    no_lanes,
    same,
    store,
)

_LANES = np.uintp(LANES)


class _Rows(NamedTuple):
    """Cells of every panel row's rays along their column, nearest first.

    Attributes
    ----------
    first : (panel rows + 1,) int64
        Where the cells of each panel row begin.
    lens : (panel rows,) int64
        Lens row; -1 where none.
    offset : (n,) int64
        See `Layout.row_offset`.
    exit_mm, entry_mm : (n,) float32
        Rounded up and down; a ray enters its first cell at infinity.
    reach : (panel rows, 2) int64
        See `Layout.row_reach`.
    """

    first: np.ndarray
    lens: np.ndarray
    offset: np.ndarray
    exit_mm: np.ndarray
    entry_mm: np.ndarray
    reach: np.ndarray


class _Passes(NamedTuple):
    """Cells of the rays of strips of lenses along their row, nearest first.

    A *pass* is the u-th pixel of those lenses of a strip whose rays lean to one side, so that all
    visit the pass's cells in the same order. It has the number ``2 (strip pixels + u) + side``.

    Attributes
    ----------
    offset : (passes, cells) int64
        See `Layout.column_offset`.
    exit_mm, entry_mm : (passes, cells, LANES) float32
        Per lens, rounded up and down; anything where a lens does not visit a cell.
    nearest_exit : (passes, cells) float32
        The least exit from each cell.
    lanes : (passes,) uint32
        Lenses that take part, a bit each.
    lens_first, lens_pixels : (lens columns,) int64
        First panel column of each lens, and how many it has.
    """

    offset: np.ndarray
    exit_mm: np.ndarray
    entry_mm: np.ndarray
    nearest_exit: np.ndarray
    lanes: np.ndarray
    lens_first: np.ndarray
    lens_pixels: np.ndarray


class _Cells(NamedTuple):
    """The cells that each pass visits on each panel row, nearest first.

    Attributes
    ----------
    first : (panel rows x passes + 1,) int64
        Where the cells of a panel row and a pass begin.
    cell : (n, 3) uint32
        Index in `_Rows`, cell of the pass, and lenses that visit it, a bit each.
    """

    first: np.ndarray
    cell: np.ndarray


class NonIntegerPitch(PhaseGenerator):
    """Directions differ from lens to lens: exit depths are vectors along a strip of lenses.

    Of pictures of one layer.
    """

    def _prepare(self) -> None:
        super()._prepare()
        self._tables = _tables(self.display, self.shape, self.pixel_mm, self.pixel_offset)
        self._phases = Phases(self._tables[0], end=self._rule != SOLID)

    def _take(self, columns: Columns, payloads: Sequence[np.ndarray]) -> None:
        """See `PhaseGenerator._take`."""
        self._fill(columns, payloads[0])

    def _run(self, columns: Columns, empty: int, first: int, out: np.ndarray) -> None:
        """See `PhaseGenerator._run`."""
        phases = self._phases
        _run(
            first,
            (
                phases.depth, phases.back, phases.payload, phases.layout.row_stride,
                phases.nearest, phases.farthest,
            ),
            *self._tables[1:], columns.end, columns.continue_behind,
            np.uint32(empty), out,
        )  # fmt: skip


@lru_cache(maxsize=8)
def _tables(
    display: Display, shape: PictureShape, pixel_mm: float, pixel_offset: PixelOffset
) -> tuple[Layout, _Rows, _Passes, _Cells]:
    """Tables of a display and picture size."""
    per_pitch = cells_per_pitch(display, pixel_mm)
    assert per_pitch is not None
    rays = cell_rays(shape, pixel_mm, display, pixel_offset)
    columns, rows = (axis_runs(axis, display.depth_range_mm) for axis in rays)
    # As if under the lens 0.
    row_lens = np.repeat(display.rows.lens, np.diff(rows.first))
    column_lens = np.repeat(display.columns.lens, np.diff(columns.first))
    row, column = rows.cell - per_pitch * row_lens, columns.cell - per_pitch * column_lens
    layout = Layout.of(per_pitch, row[row_lens >= 0], column[column_lens >= 0], display)
    row_entry = _entries(rows)
    panel_rows = _Rows(
        rows.first, display.rows.lens, layout.row_offset(row), rounded_up(rows.exit_mm),
        -rounded_up(-row_entry), layout.row_reach(row, rows.first[:-1]),
    )  # fmt: skip
    passes, *column_depths = _passes(display, columns, column, column_lens, layout)
    cells = _cells(panel_rows, rows.exit_mm, row_entry, *column_depths)
    return layout, panel_rows, passes, cells


def _entries(runs: AxisRuns) -> np.ndarray:
    """Depths at which rays enter the cells of runs, (n,) float64."""
    entry = np.roll(runs.exit_mm, 1)
    entry[runs.first[:-1]] = np.inf
    return entry


def _passes(
    display: Display, runs: AxisRuns, cell: np.ndarray, lens: np.ndarray, layout: Layout
) -> tuple[_Passes, np.ndarray, np.ndarray]:
    """Passes over a display's column runs, and their exits and entries in float64.

    Exits are inf, and entries -inf, where a lens does not visit a cell.

    Parameters
    ----------
    display : Display
    runs : AxisRuns
    cell, lens : (n,) int64
        Cell of each run as if under the lens 0, and its lens column; -1 where none.
    layout : Layout
    """
    lenses, owner = display.lens_columns, display.columns.lens
    lens_pixels = np.bincount(owner[owner >= 0], minlength=lenses)
    lens_first = np.array([np.argmax(owner == n) for n in range(lenses)])
    pixels = int(lens_pixels.max())
    count = np.diff(runs.first)
    rightwards = runs.cell[runs.first[1:] - 1] >= runs.cell[runs.first[:-1]]
    right = np.repeat(rightwards, count)
    within = 2 * (np.repeat(np.arange(len(owner)), count) - lens_first[lens]) + right
    strips = -(-lenses // LANES)
    start = np.array([max(min(s * LANES, lenses - LANES), 0) for s in range(strips)])
    members = [np.flatnonzero((lens >= n) & (lens < n + LANES)) for n in start]
    run = np.concatenate(members)
    strip = np.repeat(np.arange(strips), [len(members_of_strip) for members_of_strip in members])
    number, lane = 2 * pixels * strip + within[run], lens[run] - start[strip]
    # The nearest cell of any lens: the leftmost of rays that go right.
    step = np.tile([-1, 1], strips * pixels)
    nearest = np.full(len(step), np.iinfo(np.int64).max)
    np.minimum.at(nearest, number, step[number] * cell[run])
    nearest[nearest == np.iinfo(np.int64).max] = 0  # a pass without lenses
    rank = step[number] * cell[run] - nearest[number]
    most = int(rank.max()) + 1
    exits = np.full((len(step), most, LANES), np.inf)
    entries = np.full((len(step), most, LANES), -np.inf)
    exits[number, rank, lane], entries[number, rank, lane] = runs.exit_mm[run], _entries(runs)[run]
    exit_mm = rounded_up(exits)
    lanes = np.isfinite(exits).any(axis=1) @ (1 << np.arange(LANES))
    passes = _Passes(
        layout.column_offset(step[:, None] * (nearest[:, None] + np.arange(most))), exit_mm,
        -rounded_up(-entries), exit_mm.min(axis=2), lanes.astype(np.uint32), lens_first,
        lens_pixels,
    )  # fmt: skip
    return passes, exits, entries


def _cells(
    rows: _Rows,
    row_exit: np.ndarray,
    row_entry: np.ndarray,
    exits: np.ndarray,
    entries: np.ndarray,
) -> _Cells:
    """Every cell that some lens of a pass visits, on every panel row; depths in float64."""
    # Bounds of all cells from here on.
    latest = np.maximum.accumulate(entries.max(axis=2)[:, ::-1], axis=1)[:, ::-1]
    depths = (
        rows.first, rows.lens, row_exit, row_entry, exits, entries, exits.min(axis=2),
        np.ascontiguousarray(latest),
    )  # fmt: skip
    count = np.zeros(len(rows.lens) * len(exits), np.int64)
    _find_cells(*depths, count, np.empty((0, 3), np.uint32), False)
    first = np.concatenate([[0], np.cumsum(count)])
    cell = np.empty((first[-1], 3), np.uint32)
    _find_cells(*depths, first, cell, True)
    return _Cells(first, cell)


@compiled(parallel=True)
def _find_cells(  # type: ignore[no-untyped-def]
    row_first, lens, row_exit, row_entry, exits, entries, least_exit, latest, first, cell, write
):
    """Count the cells of each panel row and pass, or write them."""
    passes, most, _ = exits.shape
    for r in prange(len(lens)):
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
                            cell[place, 0], cell[place, 1], cell[place, 2] = i, q, bits
                        at += 1
            if not write:
                first[r * passes + p] = at


@compiled(parallel=True)
def _run(first, picture, rows, passes, cells, columns_end, continue_behind, empty, out):  # type: ignore[no-untyped-def]
    """Panel rows from the first on, shared among the threads."""
    lens_first, lens_pixels = passes.lens_first, passes.lens_pixels
    lenses, least_pixels = len(lens_first), lens_pixels.min()
    for line in prange(out.shape[0]):
        r, row = first + np.int64(line), out[line]
        row[:] = empty
        if rows.lens[r] >= 0:
            strip = np.empty(lens_pixels.max() * LANES, np.uint32)
            for s in range(picture[4].shape[1]):
                top, bottom = rows.lens[r] + rows.reach[r, 0], rows.lens[r] + rows.reach[r, 1]
                most = nearest_surface(picture[4], top, bottom, s)
                if most == -np.inf:
                    continue
                start = max(min(s * LANES, lenses - LANES), 0)
                strip[:] = empty
                _run_strip(
                    r, s, start, most, picture, rows, passes, cells, columns_end, continue_behind,
                    strip,
                )  # fmt: skip
                write_strip(strip, lens_first, start, least_pixels, row)
                for n in range(start, min(start + LANES, lenses)):
                    for u in range(least_pixels, lens_pixels[n]):
                        row[lens_first[n] + u] = strip[u * LANES + n - start]


@compiled
def _run_strip(  # type: ignore[no-untyped-def]
    r, s, start, most, picture, rows, passes, cells, columns_end, continue_behind, strip
):
    """Trace one panel row of a strip, pass by pass, near to far until all lenses have a hit.

    Rays that passed behind a column without a later hit follow the rule of
    `raycast.shared_directions`.
    """
    depth, back, payload, row_stride, _, farthest = picture
    row_exit, row_entry, row_offset = rows.exit_mm, rows.entry_mm, rows.offset
    lens, pass_cells = rows.lens[r], np.uintp(passes.offset.shape[1])
    base = lens * row_stride + start
    least_end = np.float32(-np.inf)
    if columns_end:
        least_end = farthest_end(farthest, lens + rows.reach[r, 0], lens + rows.reach[r, 1], s)
    width = 2 * len(strip) // LANES
    offset, exits, entries = passes.offset.reshape(-1), passes.exit_mm, passes.entry_mm
    nearest_exit = passes.nearest_exit.reshape(-1)
    cell_list = cells.cell
    for p in range(s * width, (s + 1) * width):
        number = r * len(passes.lanes) + p
        k, end = np.uintp(cells.first[number]), np.uintp(cells.first[number + 1])
        first = np.uintp(p) * pass_cells
        while k < end and (
            row_exit[cell_list[k, 0]] > most or nearest_exit[first + cell_list[k, 1]] > most
        ):
            k += np.uintp(1)
        at = np.uintp((p - s * width) // 2 * LANES)
        searching, payloads = lanes_of(passes.lanes[p]), load(strip, at)
        begin, behind = k, no_lanes()
        while k < end:
            i, q = np.uintp(cell_list[k, 0]), first + np.uintp(cell_list[k, 1])
            if row_entry[i] < least_end:
                break
            cell = np.uintp(base + row_offset[i] + offset[q])
            front = load(depth, cell)
            hit = and_flags(
                and_flags(searching, lanes_of(cell_list[k, 2])),
                and_flags(
                    at_least(front, load(exits, q * _LANES)), at_least(front, same(row_exit[i]))
                ),
            )
            if columns_end and any_lane(hit):
                end_mm = load(back, cell)
                below = hit
                hit = and_flags(hit, at_least(load(entries, q * _LANES), end_mm))
                hit = and_flags(hit, at_least(same(row_entry[i]), end_mm))
                behind = either(behind, but_not(below, hit))
            payloads = choose(hit, load(payload, cell), payloads)
            searching = but_not(searching, hit)
            if not any_lane(searching):
                break
            k += np.uintp(1)
        if continue_behind:
            lost, k = and_flags(behind, searching), end
            while k > begin and any_lane(lost):
                k -= np.uintp(1)
                i, q = np.uintp(cell_list[k, 0]), first + np.uintp(cell_list[k, 1])
                cell = np.uintp(base + row_offset[i] + offset[q])
                here = load(depth, cell)
                over = either(less(here, load(exits, q * _LANES)), less(here, same(row_exit[i])))
                over = and_flags(over, and_flags(lost, lanes_of(cell_list[k, 2])))
                covered = and_flags(over, less(same(np.float32(-np.inf)), here))
                payloads = choose(covered, load(payload, cell), payloads)
                lost = but_not(lost, over)
        store(strip, at, payloads)
