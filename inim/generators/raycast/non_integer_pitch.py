"""Templates where no two lenses share a direction: 15.7 pixels per lens, and the like.

With a whole number of picture cells per pitch, lenses still meet the same cells, moved by whole
lenses; only the depths at which the u-th pixel of each lens leaves them differ a little from lens
to lens. So a strip of neighbouring lenses is worked on at once, as in `raycast.polyphase`,
over every cell that any lens of the strip visits, from near to far, with exit depths that are
vectors along the strip.

Rays are separable, so exit depths are stored per panel row and per panel column. A lens visits a
cell if its ray is in the row and in the column at once, ``max(exits) < min(entries)``; that does
not depend on the picture, and is stored as pairs of a row and a column, and which lenses visit it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from inim.backend.kernels import compiled, prange
from inim.display import Display
from inim.display.pixels import PixelAxis
from inim.generators.base import PictureShape, PixelList
from inim.generators.raycast.cells import CENTRE, Aside, cell_rays
from inim.generators.raycast.columns import SOLID, Columns
from inim.generators.raycast.direction_lists import cells_per_pitch
from inim.generators.raycast.polyphase import (
    PhaseGenerator,
    Phases,
    farthest_end,
    nearest_surface,
    write_strip,
)
from inim.generators.raycast.ray_by_ray import AxisRuns, RayByRay, axis_runs, doubtful_pixels
from inim.generators.raycast.simd import (
    LANES,
    any_lane,
    at_least,
    both,
    but_not,
    choose,
    either,
    greatest,
    lanes_of,
    least,
    less,
    load,
    no_lanes,
    same,
    store,
)

_LANES = np.uintp(LANES)


@dataclass(frozen=True)
class RowRuns:
    """Row runs of every panel row, as addresses.

    Attributes
    ----------
    first : (panel rows + 1,) int64
    lens : (panel rows,) int64
        -1 where none.
    offset : (n,) int64
    exit, entry : (n,) float32
    came : (n,) float32
        Entries rounded down; see `AxisRuns.came32`.
    reach : (panel rows, 2) int64
        First and last row of slots, from the lens's own, that each panel row's rays visit.
    """

    first: np.ndarray
    lens: np.ndarray
    offset: np.ndarray
    exit: np.ndarray
    entry: np.ndarray
    came: np.ndarray
    reach: np.ndarray


@dataclass(frozen=True)
class StripColumns:
    """Column runs of strips of lenses.

    A *pass* is the u-th pixel of those lenses of a strip whose rays lean to the same side, so that
    all of them visit the pass's cells in the same order.

    Attributes
    ----------
    strip_first : (strips + 1,) int64
        Passes of each strip.
    pixel : (passes,) int64
        u.
    pass_first : (passes + 1,) int64
        Cells of each pass, nearest first.
    offset : (cells,) int64
    exit : (cells + passes, LANES) float32
        Per lens; infinite where a lens does not visit a cell. Each pass begins with a row of
        infinities, so that the row before a cell's own says where it is entered.
    came : (cells, LANES) float32
        Per lens, where it enters a cell, rounded down; infinite where it came from in front of all.
    lanes : (passes,) uint32
        Lenses that take part, a bit each.
    nearest_exit : (cells,) float32
        The least exit from each cell.
    lens_first, lens_pixels : (lens columns,) int64
        First panel column of each lens, and how many it has.
    """

    strip_first: np.ndarray
    pixel: np.ndarray
    pass_first: np.ndarray
    offset: np.ndarray
    exit: np.ndarray
    came: np.ndarray
    lanes: np.ndarray
    nearest_exit: np.ndarray
    lens_first: np.ndarray
    lens_pixels: np.ndarray


@dataclass(frozen=True)
class CellPairs:
    """The cells that each pass visits on each panel row, nearest first.

    Attributes
    ----------
    first : (panel rows x passes + 1,) int64
        Where the pairs of a panel row and a pass begin.
    row, column : (pairs,) unsigned integers, as narrow as they can be
        The cell's row among the panel row's runs, and its column among the pass's cells.
    lanes : (pairs,) uint32
        Lenses that visit it, a bit each.
    """

    first: np.ndarray
    row: np.ndarray
    column: np.ndarray
    lanes: np.ndarray


class NonIntegerPitch(PhaseGenerator):
    """Directions differ from lens to lens: exit depths are vectors along a strip of lenses.

    Parameters
    ----------
    display, shape, pixel_mm :
        See `inim.generators.prepare`.
    rule : str
        Of one layer; see `raycast.columns`.
    aside : Aside
        Where in its pixel each ray starts.
    """

    def __init__(
        self,
        display: Display,
        shape: PictureShape,
        pixel_mm: float,
        rule: str,
        aside: Aside = CENTRE,
    ) -> None:
        super().__init__(display, shape, pixel_mm, rule)
        per_pitch = cells_per_pitch(display, pixel_mm)
        assert per_pitch is not None
        rays = cell_rays(shape, pixel_mm, display, aside)
        columns, rows = (axis_runs(axis, display.depth_range_mm) for axis in rays)
        self._phases = Phases.make(
            per_pitch,
            _relative(rows, display.rows, per_pitch),
            _relative(columns, display.columns, per_pitch),
            (display.lens_rows, display.lens_columns),
            end=rule != SOLID,
        )
        self._rows = row_runs(display, rows, per_pitch, self._phases)
        self._columns = strip_columns(display, columns, per_pitch, self._phases)
        self._pairs = cell_pairs(self._rows, self._columns)
        doubtful = doubtful_pixels(rows, columns) & display.lensed
        self._doubtful = RayByRay(display, shape, pixel_mm, rule, aside, PixelList.of(doubtful))

    def _run(
        self, columns: Columns, payloads: Sequence[np.ndarray], empty: int, out: np.ndarray
    ) -> None:
        self._fill(columns, payloads[0])
        run_strips(self._rows, self._columns, self._pairs, self._phases, columns, empty, out)
        at = self._doubtful.pixels
        if at is not None and len(at.rows):
            known = np.append(payloads[0].reshape(-1), np.uint32(empty))
            out[at.rows, at.columns] = known[self._doubtful.first_hits(columns)[0]]


def _relative(runs: AxisRuns, pixels: PixelAxis, per_pitch: int) -> np.ndarray:
    """Cells of all lensed runs, as if under the lens 0."""
    owner = np.repeat(pixels.lens, np.diff(runs.first))
    cells: np.ndarray = (runs.cell - per_pitch * owner)[owner >= 0]
    return cells


def row_runs(display: Display, runs: AxisRuns, per_pitch: int, phases: Phases) -> RowRuns:
    """Address the row runs of a display in its phases."""
    lens = display.rows.lens
    owner = np.repeat(lens, np.diff(runs.first))
    own = runs.cell - per_pitch * owner
    offset = phases.row_offset(own)
    reach = phases.row_reach(own, runs.first[:-1])
    return RowRuns(runs.first, lens, offset, runs.exit32(), runs.entry32(), runs.came32(), reach)


def strip_columns(display: Display, runs: AxisRuns, per_pitch: int, phases: Phases) -> StripColumns:
    """Gather the column runs of a display into passes over strips of lenses."""
    lenses = display.lens_columns
    lens = display.columns.lens
    exits, came = runs.exit32(), runs.came32()
    count = np.bincount(lens[lens >= 0], minlength=lenses)
    begin = np.array([np.argmax(lens == n) if count[n] else 0 for n in range(lenses)])
    strip_first, pixel, pass_first = [0], [], [0]
    cells, exit_rows, came_rows, bits = [], [], [], []
    for strip in range(-(-lenses // LANES)):
        start = max(min(strip * LANES, lenses - LANES), 0)
        members = range(start, min(start + LANES, lenses))
        for u in range(max(count[n] for n in members)):
            for side in (-1, 1):
                lanes = _leaning(runs, begin, count, members, u, side)
                if not lanes:
                    continue
                own, spans = _one_pass(runs, lanes, begin, u, side, per_pitch)
                cells.append(own)
                came_rows.append(_by_lane(came, spans, lanes, start, len(own)))
                exit_mm = _by_lane(exits, spans, lanes, start, len(own))
                exit_rows.append(np.concatenate([np.full((1, LANES), np.inf, np.float32), exit_mm]))
                bits.append(sum(1 << (n - start) for n in lanes))
                pixel.append(u)
                pass_first.append(pass_first[-1] + len(own))
        strip_first.append(len(pixel))
    return StripColumns(
        np.array(strip_first),
        np.array(pixel),
        np.array(pass_first),
        phases.column_offset(np.concatenate(cells)),
        np.concatenate(exit_rows),
        np.concatenate(came_rows),
        np.array(bits, np.uint32),
        np.concatenate([exit_mm[1:].min(axis=1) for exit_mm in exit_rows]),
        begin,
        count,
    )


def _leaning(
    runs: AxisRuns, begin: np.ndarray, count: np.ndarray, members: range, u: int, side: int
) -> list[int]:
    """Lenses whose u-th ray visits cells in ascending (side 1) or descending order."""
    lanes = []
    for n in members:
        if u >= count[n]:
            continue
        a, b = runs.first[begin[n] + u], runs.first[begin[n] + u + 1]
        descends = runs.cell[b - 1] < runs.cell[a]
        if descends == (side < 0):
            lanes.append(n)
    return lanes


def _one_pass(
    runs: AxisRuns, lanes: list[int], begin: np.ndarray, u: int, side: int, per_pitch: int
) -> tuple[np.ndarray, list[tuple[slice, np.ndarray]]]:
    """Cells of the strip's first lens, nearest first; of each lane, its runs, and their ranks."""
    spans = [slice(runs.first[begin[n] + u], runs.first[begin[n] + u + 1]) for n in lanes]
    relative = [runs.cell[s] - per_pitch * n for s, n in zip(spans, lanes, strict=True)]
    low, high = min(int(c.min()) for c in relative), max(int(c.max()) for c in relative)
    ranks = [(own - low) if side > 0 else (high - own) for own in relative]
    return np.arange(low, high + 1)[::side], list(zip(spans, ranks, strict=True))


def _by_lane(
    values: np.ndarray,
    spans: list[tuple[slice, np.ndarray]],
    lanes: list[int],
    start: int,
    cells: int,
) -> np.ndarray:
    """Values of runs, (cells, LANES) float32; infinite where a lens does not visit a cell."""
    table = np.full((cells, LANES), np.inf, np.float32)
    for n, (span, rank) in zip(lanes, spans, strict=True):
        table[rank, n - start] = values[span]
    return table


def cell_pairs(rows: RowRuns, columns: StripColumns) -> CellPairs:
    """Find every cell that some lens of a pass visits, on every panel row."""
    pieces = (
        rows.first, rows.exit, rows.entry, rows.lens, columns.pass_first, columns.exit,
    )  # fmt: skip
    longest = max(np.diff(rows.first).max(), np.diff(columns.pass_first).max())
    narrow = np.min_scalar_type(int(longest))
    count = np.zeros((len(rows.lens), len(columns.pixel)), np.int64)
    none, no_lanes = np.empty(0, narrow), np.empty(0, np.uint32)
    _find_pairs(*pieces, count, count.reshape(-1), none, none, no_lanes, False)
    first = np.concatenate([[0], np.cumsum(count)])
    row, column = np.empty(first[-1], narrow), np.empty(first[-1], narrow)
    lanes = np.empty(first[-1], np.uint32)
    _find_pairs(*pieces, count, first, row, column, lanes, True)
    return CellPairs(first, row, column, lanes)


@compiled(parallel=True)
def _find_pairs(  # type: ignore[no-untyped-def]
    row_first, row_exit, row_entry, row_lens, pass_first, exits, count, first, row, column, lanes,
    write,
):  # fmt: skip
    """Count the pairs of each panel row and pass, or write them."""
    passes = len(pass_first) - 1
    for r in prange(len(row_lens)):
        if row_lens[r] >= 0:
            for p in range(passes):
                at = first[r * passes + p]
                found = 0
                for i in range(row_first[r], row_first[r + 1]):
                    for q in range(pass_first[p], pass_first[p + 1]):
                        bits = _visiting(exits[p + q], exits[p + q + 1], row_exit[i], row_entry[i])
                        if bits:
                            if write:
                                row[at + found] = i - row_first[r]
                                column[at + found] = q - pass_first[p]
                                lanes[at + found] = bits
                            found += 1
                count[r, p] = found


@compiled
def _visiting(entered, left, z_exit, z_entry):  # type: ignore[no-untyped-def]
    """Lenses that are in a column between two depths, a bit each."""
    bits = np.uint32(0)
    for n in range(LANES):
        visits = max(left[n], z_exit) < min(entered[n], z_entry)
        bits |= np.uint32(visits) << np.uint32(n)
    return bits


def run_strips(
    rows: RowRuns,
    columns: StripColumns,
    pairs: CellPairs,
    phases: Phases,
    met: Columns,
    empty: int,
    out: np.ndarray,
) -> None:
    """Show each lensed panel pixel the payload of its first hit, the others `empty`."""
    _run(
        phases.depth.reshape(-1), phases.back.reshape(-1), phases.payload.reshape(-1),
        met.end, met.continue_behind, phases.depth[0].size, phases.nearest, phases.farthest,
        rows.first, rows.lens, rows.offset, rows.exit, rows.came, rows.reach,
        columns.strip_first, columns.pixel, columns.pass_first, columns.offset,
        columns.exit.reshape(-1), columns.came.reshape(-1), columns.lanes, columns.nearest_exit,
        pairs.first, pairs.row, pairs.column, pairs.lanes,
        columns.lens_first, columns.lens_pixels, np.uint32(empty), out,
    )  # fmt: skip


@compiled(parallel=True)
def _run(  # type: ignore[no-untyped-def]
    depth, back, payload, columns_end, continue_behind, row_stride, nearest, farthest, row_first,
    row_lens, row_offset, row_exit, row_came, row_reach, strip_first, pixel, pass_first, offset,
    exits, came, lanes, nearest_exit, pair_first, pair_row, pair_column, pair_lanes, lens_first,
    lens_pixels, empty, out,
):  # fmt: skip
    """All panel rows, shared among the threads."""
    for r in prange(out.shape[0]):
        out[r, :] = empty
        if row_lens[r] >= 0:
            strip = np.empty(int(lens_pixels.max()) * LANES, np.uint32)
            _run_row(
                np.int64(r), depth, back, payload, columns_end, continue_behind, row_stride,
                nearest, farthest, row_first, row_lens, row_offset, row_exit, row_came, row_reach,
                strip_first, pixel, pass_first, offset, exits, came, lanes, nearest_exit,
                pair_first, pair_row, pair_column, pair_lanes, lens_first, lens_pixels, empty,
                strip, out,
            )  # fmt: skip


@compiled
def _run_row(  # type: ignore[no-untyped-def]
    r, depth, back, payload, columns_end, continue_behind, row_stride, nearest, farthest, row_first,
    row_lens, row_offset, row_exit, row_came, row_reach, strip_first, pixel, pass_first, offset,
    exits, came, lanes, nearest_exit, pair_first, pair_row, pair_column, pair_lanes, lens_first,
    lens_pixels, empty, strip, out,
):  # fmt: skip
    """One panel row, a strip of lenses and a pass at a time, near to far until all have hit.

    Rays that passed behind a column, and met nothing, go as in `raycast.shared_directions`.
    """
    m = row_lens[r]
    lenses, shared, passes = len(lens_first), lens_pixels.min(), len(pixel)
    for s in range(len(strip_first) - 1):
        start = max(min(s * LANES, lenses - LANES), 0)
        base = m * row_stride + start
        top, bottom = m + row_reach[r, 0], m + row_reach[r, 1]
        most, least_end = nearest_surface(nearest, top, bottom, s), np.float32(-np.inf)
        if columns_end:
            least_end = farthest_end(farthest, top, bottom, s)
        strip[:] = empty
        for p in range(strip_first[s], strip_first[s + 1]):
            first_row, first_cell = np.uintp(row_first[r]), np.uintp(pass_first[p])
            # `p` passes precede this one, each with a row of exits more than it has cells.
            first_left = first_cell + np.uintp(p + 1)
            k = np.uintp(pair_first[r * passes + p])
            end = np.uintp(pair_first[r * passes + p + 1])
            while k < end and (
                row_exit[first_row + np.uintp(pair_row[k])] > most
                or nearest_exit[first_cell + np.uintp(pair_column[k])] > most
            ):
                k += np.uintp(1)
            at = np.uintp(pixel[p] * LANES)
            searching, shown = lanes_of(lanes[p]), load(strip, at)
            begin, behind = k, no_lanes()
            while k < end:
                i, q = first_row + np.uintp(pair_row[k]), np.uintp(pair_column[k])
                if row_came[i] < least_end:
                    break
                left = greatest(load(exits, (first_left + q) * _LANES), same(row_exit[i]))
                cell = np.uintp(base + row_offset[i] + offset[first_cell + q])
                visiting = both(searching, lanes_of(pair_lanes[k]))
                hit = both(visiting, at_least(load(depth, cell), left))
                if columns_end and any_lane(hit):
                    entry = least(load(came, (first_cell + q) * _LANES), same(row_came[i]))
                    below, hit = hit, both(hit, at_least(entry, load(back, cell)))
                    behind = either(behind, but_not(below, hit))
                shown = choose(hit, load(payload, cell), shown)
                searching = but_not(searching, hit)
                if not any_lane(searching):
                    break
                k += np.uintp(1)
            if continue_behind:
                lost, k = both(behind, searching), end
                while k > begin and any_lane(lost):
                    k -= np.uintp(1)
                    i, q = first_row + np.uintp(pair_row[k]), np.uintp(pair_column[k])
                    left = greatest(load(exits, (first_left + q) * _LANES), same(row_exit[i]))
                    cell = np.uintp(base + row_offset[i] + offset[first_cell + q])
                    here = load(depth, cell)
                    over = both(both(lost, lanes_of(pair_lanes[k])), less(here, left))
                    covered = both(over, less(same(np.float32(-np.inf)), here))
                    shown = choose(covered, load(payload, cell), shown)
                    lost = but_not(lost, over)
            store(strip, at, shown)
        write_strip(strip, lens_first, lens_pixels, start, shared, out[r])
