"""Templates where no two lenses share a direction: 15.7 pixels per lens, and the like.

With a whole number of picture cells per pitch, lenses still meet the same cells, moved by whole
lenses; only the depths at which the u-th pixel of each lens leaves them differ a little from lens
to lens. So a strip of neighbouring lenses is worked on at once, as in `inim.generators.polyphase`,
over every cell that any lens of the strip visits, from near to far, with exit depths that are
vectors along the strip. A cell counts for a lens if its ray is in the row and in the column at
once: ``max(exits) < min(entries)``.

Rays are separable, so all that is stored is per panel row and per panel column.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from inim.display import Display
from inim.generators.axis_runs import AxisRuns
from inim.generators.lanes import (
    LANES,
    any_lane,
    at_least,
    both,
    but_not,
    choose,
    greater,
    greatest,
    least,
    load,
    same,
    store,
)
from inim.generators.polyphase import Phases, nearest_surface, write_strip

__all__ = ["RowRuns", "StripColumns", "row_runs", "run_strips", "strip_columns"]

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
    reach : (panel rows, 2) int64
        First and last row of slots, from the lens's own, that each panel row's rays visit.
    """

    first: np.ndarray
    lens: np.ndarray
    offset: np.ndarray
    exit: np.ndarray
    entry: np.ndarray
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
        infinities, so that the row before a cell's own says where it is entered; negative ones
        for lenses that do not take part.
    nearest_exit, farthest_entry : (cells,) float32
        The least exit among this cell and the nearer ones; the greatest entry among this and the
        farther ones: between them lie the cells that can be in a row.
    lens_first, lens_pixels : (lens columns,) int64
        First panel column of each lens, and how many it has.
    """

    strip_first: np.ndarray
    pixel: np.ndarray
    pass_first: np.ndarray
    offset: np.ndarray
    exit: np.ndarray
    nearest_exit: np.ndarray
    farthest_entry: np.ndarray
    lens_first: np.ndarray
    lens_pixels: np.ndarray


def row_runs(display: Display, runs: AxisRuns, per_pitch: int, phases: Phases) -> RowRuns:
    """Address the row runs of a display in its phases."""
    lens = display.rows.lens
    owner = np.repeat(lens, np.diff(runs.first))
    own = runs.cell - per_pitch * owner
    offset = phases.row_offset(own)
    reach = phases.row_reach(own, runs.first[:-1])
    return RowRuns(runs.first, lens, offset, runs.exit32(), runs.entry32(), reach)


def strip_columns(display: Display, runs: AxisRuns, per_pitch: int, phases: Phases) -> StripColumns:
    """Gather the column runs of a display into passes over strips of lenses."""
    lenses = display.lens_columns
    lens = display.columns.lens
    exits = runs.exit32()
    count = np.bincount(lens[lens >= 0], minlength=lenses)
    begin = np.array([np.argmax(lens == n) if count[n] else 0 for n in range(lenses)])
    strip_first, pixel, pass_first = [0], [], [0]
    cells, exit_rows = [], []
    for strip in range(-(-lenses // LANES)):
        start = max(min(strip * LANES, lenses - LANES), 0)
        members = range(start, min(start + LANES, lenses))
        for u in range(max(count[n] for n in members)):
            for side in (-1, 1):
                lanes = _leaning(runs, begin, count, members, u, side)
                if not lanes:
                    continue
                own, exit_mm = _one_pass(runs, lanes, exits, begin, u, side, start, per_pitch)
                cells.append(own)
                exit_rows.append(exit_mm)
                pixel.append(u)
                pass_first.append(pass_first[-1] + len(own))
        strip_first.append(len(pixel))
    nearest, farthest = zip(*map(_search_bounds, exit_rows), strict=True)
    return StripColumns(
        np.array(strip_first),
        np.array(pixel),
        np.array(pass_first),
        phases.column_offset(np.concatenate(cells)),
        np.concatenate(exit_rows),
        np.concatenate(nearest),
        np.concatenate(farthest),
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
    runs: AxisRuns,
    lanes: list[int],
    exits: np.ndarray,
    begin: np.ndarray,
    u: int,
    side: int,
    start: int,
    per_pitch: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Cells of the strip's first lens, nearest first, and each lane's exits, a row ahead."""
    spans = [slice(runs.first[begin[n] + u], runs.first[begin[n] + u + 1]) for n in lanes]
    relative = [runs.cell[s] - per_pitch * n for s, n in zip(spans, lanes, strict=True)]
    low, high = min(int(c.min()) for c in relative), max(int(c.max()) for c in relative)
    cells = np.arange(low, high + 1)[::side]
    exit_mm = np.full((1 + len(cells), LANES), np.inf, np.float32)
    exit_mm[0] = -np.inf
    for n, span, own in zip(lanes, spans, relative, strict=True):
        rank = (own - low) if side > 0 else (high - own)
        exit_mm[0, n - start] = np.inf
        exit_mm[1 + rank, n - start] = exits[span]
    return cells, exit_mm


def _search_bounds(exit_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`nearest_exit` and `farthest_entry` of one pass's cells."""
    own, before = exit_mm[1:], exit_mm[:-1]
    entry = np.where(np.isfinite(own), before, -np.inf).max(axis=1)
    return (
        np.minimum.accumulate(own.min(axis=1)),
        np.maximum.accumulate(entry[::-1])[::-1].astype(np.float32),
    )


def run_strips(
    rows: RowRuns, columns: StripColumns, phases: Phases, empty: int, out: np.ndarray
) -> None:
    """Show each lensed panel pixel the payload of its first hit, the others `empty`."""
    _run(
        phases.depth.reshape(-1), phases.payload.reshape(-1), phases.depth[0].size, phases.nearest,
        rows.first, rows.lens, rows.offset, rows.exit, rows.entry, rows.reach,
        columns.strip_first, columns.pixel, columns.pass_first, columns.offset,
        columns.exit.reshape(-1), columns.nearest_exit, columns.farthest_entry,
        columns.lens_first, columns.lens_pixels, np.uint32(empty), out,
    )  # fmt: skip


@numba.njit(parallel=True, cache=True, nogil=True)
def _run(  # type: ignore[no-untyped-def]
    depth, payload, row_stride, nearest, row_first, row_lens, row_offset, row_exit, row_entry,
    row_reach, strip_first, pixel, pass_first, offset, exits, nearest_exit, farthest_entry,
    lens_first, lens_pixels, empty, out,
):  # fmt: skip
    """All panel rows, shared among the threads."""
    for r in numba.prange(out.shape[0]):
        out[r, :] = empty
        if row_lens[r] >= 0:
            strip = np.empty(int(lens_pixels.max()) * LANES, np.uint32)
            _run_row(
                np.int64(r), depth, payload, row_stride, nearest, row_first, row_lens, row_offset,
                row_exit, row_entry, row_reach, strip_first, pixel, pass_first, offset, exits,
                nearest_exit, farthest_entry, lens_first, lens_pixels, empty, strip, out,
            )  # fmt: skip


@numba.njit(cache=True, nogil=True)
def _run_row(  # type: ignore[no-untyped-def]
    r, depth, payload, row_stride, nearest, row_first, row_lens, row_offset, row_exit, row_entry,
    row_reach, strip_first, pixel, pass_first, offset, exits, nearest_exit, farthest_entry,
    lens_first, lens_pixels, empty, strip, out,
):  # fmt: skip
    """One panel row, a strip of lenses and a pass at a time."""
    m = row_lens[r]
    lenses, shared = len(lens_first), lens_pixels.min()
    for s in range(len(strip_first) - 1):
        start = max(min(s * LANES, lenses - LANES), 0)
        strip[:] = empty
        most = nearest_surface(nearest, m + row_reach[r, 0], m + row_reach[r, 1], s)
        near, end = row_first[r], row_first[r + 1]
        while near < end and row_exit[near] > most:
            near += 1
        for p in range(strip_first[s], strip_first[s + 1]):
            at = np.uintp(pixel[p] * LANES)
            shown = _search(
                depth, payload, m * row_stride + start, row_offset, row_exit, row_entry, near, end,
                offset, exits, nearest_exit, farthest_entry, p, pass_first[p], pass_first[p + 1],
                most, load(strip, at),
            )  # fmt: skip
            store(strip, at, shown)
        write_strip(strip, lens_first, lens_pixels, start, shared, out[r])


@numba.njit(cache=True, nogil=True)
def _search(  # type: ignore[no-untyped-def]
    depth, payload, base, row_offset, row_exit, row_entry, near, end,
    offset, exits, nearest_exit, farthest_entry, before, first, last, most, shown,
):  # fmt: skip
    """What a strip shows after a pass: rows near to far, in each the columns it can be in.

    `before` passes precede this one, each with a row of exits more than it has cells.
    """
    searching = greater(load(exits, np.uintp(before + first) * _LANES), same(np.float32(0)))
    while first < last and nearest_exit[first] > most:
        first += 1
    for i in range(near, end):
        z_exit, z_entry = row_exit[i], row_entry[i]
        while first < last and nearest_exit[first] >= z_entry:
            first += 1
        row_left, row_entered = same(z_exit), same(z_entry)
        lane = np.uintp(before + first) * _LANES
        entered = load(exits, lane)
        for q in range(first, last):
            if farthest_entry[q] <= z_exit:
                break
            lane += _LANES
            left = load(exits, lane)
            cell = np.uintp(base + row_offset[i] + offset[q])
            both_left = greatest(left, row_left)
            visited = greater(least(entered, row_entered), both_left)
            hit = both(both(searching, visited), at_least(load(depth, cell), both_left))
            shown = choose(hit, load(payload, cell), shown)
            searching = but_not(searching, hit)
            entered = left
        if not any_lane(searching):
            break
    return shown
