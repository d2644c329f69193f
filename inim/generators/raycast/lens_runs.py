"""Direction templates over a few neighbouring lenses: the pixels that somebody asks for.

From an eye, neighbouring lenses show nearly the same pixel: it drifts by one every handful of
lenses. So the pixels asked for are short runs of lenses in one direction, of which each is one
vector as in `inim.generators.raycast.polyphase`, only narrower: the sixteen lenses from a run's
first on, with a flag for each that is asked for. Scattered pixels are runs of one.

As a run is narrow, so is what its rays can reach: entries above the nearest surface of just those
slots are passed over. Beside the relic that is all of them, and on it half of the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from inim.generators.base import AskedPixels
from inim.generators.raycast.direction_lists import DirectionLists
from inim.generators.raycast.polyphase import Phases
from inim.generators.raycast.simd import (
    LANES,
    any_lane,
    at_least,
    both,
    but_not,
    choose,
    lanes_of,
    load_for,
    same_for,
    store,
)

__all__ = ["AskedRuns", "LensRuns", "column_bounds"]

# Lenses of a run. An eye at arm's length sees the same pixel of some seven lenses of 1 mm, blurred
# by the lens of twice as many; of 8, 16 and 32 these proved fastest for all but a pinhole array.
_FEW = 16


@dataclass(frozen=True)
class LensRuns:
    """Pixels asked for, as runs of lenses that show them in one direction.

    Attributes
    ----------
    first : (lens rows + 1,) int64
        Where the runs of each row of lenses begin.
    direction : (runs,) int32
        See `DirectionLists`.
    lens : (runs,) int32
        Column of a run's first lens.
    asked : (runs,) uint16
        Which lenses from there on are asked for, a bit each.
    pixel_first : (lens rows + 1,) int64
        Where the pixels of each row of lenses begin in the list.
    shown_by : (pixels,) uint32
        Of each pixel, the number of its run in its row of lenses times 16, and its place in that.
    """

    first: np.ndarray
    direction: np.ndarray
    lens: np.ndarray
    asked: np.ndarray
    pixel_first: np.ndarray
    shown_by: np.ndarray

    @classmethod
    def of(cls, pixels: AskedPixels, per_lens: int, lenses: tuple[int, int]) -> LensRuns:
        """Gather pixels into runs.

        Parameters
        ----------
        pixels : AskedPixels
        per_lens : int
            Panel pixels per lens along one axis.
        lenses : (rows, columns)
        """
        most = len(pixels.rows)
        direction, lens = np.empty(most, np.int32), np.empty(most, np.int32)
        asked, shown_by = np.zeros(most, np.uint16), np.empty(most, np.uint32)
        counts = np.zeros((2, lenses[0] + 1), np.int64)
        runs = _gather(
            pixels.rows, pixels.columns, per_lens, lenses[1], counts, direction, lens, asked,
            shown_by,
        )  # fmt: skip
        first, pixel_first = np.cumsum(counts, axis=1)
        return cls(
            first, direction[:runs].copy(), lens[:runs].copy(), asked[:runs].copy(), pixel_first,
            shown_by,
        )  # fmt: skip


@numba.njit(cache=True, nogil=True)
def _gather(rows, columns, per_lens, lenses, counts, direction, lens, asked, shown_by):  # type: ignore[no-untyped-def]
    """Fill the runs of pixels in the panel's order; count runs and pixels by row of lenses."""
    last = max(lenses, LANES) - _FEW  # beyond it, vectors would leave their slots
    open_run = np.empty(per_lens, np.int64)
    runs, row, begin, of = 0, -1, 0, -1
    for i in range(len(rows)):
        if rows[i] != row:
            row = rows[i]
            open_run[:] = -1
            if row // per_lens != of:
                of, begin = row // per_lens, runs
        n, u = columns[i] // per_lens, columns[i] % per_lens
        r = open_run[u]
        if r < 0 or n >= lens[r] + _FEW:
            r = runs
            runs += 1
            open_run[u] = r
            direction[r] = (row % per_lens) * per_lens + u
            lens[r] = min(n, last)
            counts[0, of + 1] += 1
        counts[1, of + 1] += 1
        lane = n - lens[r]
        asked[r] |= np.uint16(1 << lane)
        shown_by[i] = (r - begin) * _FEW + lane
    return runs


def column_bounds(lists: DirectionLists, phases: Phases) -> np.ndarray:
    """Where in a row of slots the nearest surface of a run lies, (pixels, 3) int64.

    For each pixel column: two offsets from the run's first lens, and the level at which the maxima
    there (see `_maxima`) cover all that the run's rays can reach.
    """
    found = []
    for u in range(lists.pixels):
        starts = range(u, lists.pixels**2, lists.pixels)
        columns = np.concatenate(
            [lists.column[lists.first[d] : lists.first[d + 1]] for d in starts]
        )
        first, last = phases.column_reach(columns)
        last += _FEW - 1
        level = (last - first + 1).bit_length() - 1
        found.append((first, last + 1 - 2**level, level))
    return np.array(found, np.int64)


@dataclass(frozen=True)
class AskedRuns:
    """Everything that a search of pixels asked for needs; see `run_templates` for the first four.

    Attributes
    ----------
    lists : DirectionLists
    offset : (n,) int64
    reach : (pixels, 2) int64
    phases : Phases
        Holding the picture.
    across : (pixels, 3) int64
        `column_bounds`.
    runs : LensRuns
    """

    lists: DirectionLists
    offset: np.ndarray
    reach: np.ndarray
    phases: Phases
    across: np.ndarray
    runs: LensRuns

    def show(self, empty: int, out: np.ndarray) -> None:
        """Show each pixel asked for, (n,) uint32, the payload of its first hit, or `empty`."""
        runs = self.runs
        _run(*self._tables(), np.uint32(empty), runs.pixel_first, runs.shown_by, out)

    def show_colours(
        self, palette: np.ndarray, first: np.ndarray, column: np.ndarray, panel: np.ndarray
    ) -> None:
        """Show the colours of sources, which the payload has to be, on a panel, black elsewhere.

        Parameters
        ----------
        palette : (cells, channels)
        first, column :
            See `inim.generators.raycast.pixel_mask.PanelPlaces`.
        panel : (rows, columns, channels)
        """
        _run_colours(*self._tables(), self.runs.shown_by, palette, first, column, panel)

    def _tables(self) -> tuple[object, ...]:
        lists, phases, runs = self.lists, self.phases, self.runs
        return (
            phases.depth.reshape(-1), phases.payload.reshape(-1), phases.depth[0].size,
            phases.peaks, lists.first, self.offset, self.reach, self.across, lists.exit_mm,
            runs.first, runs.direction, runs.lens, runs.asked,
        )  # fmt: skip


@numba.njit(parallel=True, cache=True, nogil=True)
def _run(  # type: ignore[no-untyped-def]
    depth, payload, row_stride, peaks, first, offset, reach, across, exits, run_first, direction,
    lens, asked, empty, pixel_first, shown_by, out,
):  # fmt: skip
    """All lens rows, shared among the threads."""
    for m in numba.prange(len(run_first) - 1):
        _run_row(
            np.int64(m), depth, payload, row_stride, peaks, first, offset, reach, across, exits,
            run_first, direction, lens, asked, empty, pixel_first, shown_by, out,
        )  # fmt: skip


@numba.njit(cache=True, nogil=True)
def _run_row(  # type: ignore[no-untyped-def]
    m, depth, payload, row_stride, peaks, first, offset, reach, across, exits, run_first,
    direction, lens, asked, empty, pixel_first, shown_by, out,
):  # fmt: skip
    seen = np.empty((run_first[m + 1] - run_first[m]) * _FEW, np.uint32)
    _search_row(
        m, depth, payload, row_stride, peaks, first, offset, reach, across, exits, run_first,
        direction, lens, asked, empty, seen,
    )  # fmt: skip
    for i in range(pixel_first[m], pixel_first[m + 1]):
        out[i] = seen[shown_by[i]]


@numba.njit(parallel=True, cache=True, nogil=True)
def _run_colours(  # type: ignore[no-untyped-def]
    depth, payload, row_stride, peaks, first, offset, reach, across, exits, run_first, direction,
    lens, asked, shown_by, palette, place_first, column, panel,
):  # fmt: skip
    """All lens rows, shared among the threads, and their colours on the panel."""
    for m in numba.prange(len(run_first) - 1):
        _run_row_colours(
            np.int64(m), depth, payload, row_stride, peaks, first, offset, reach, across, exits,
            run_first, direction, lens, asked, shown_by, palette, place_first, column, panel,
        )  # fmt: skip


@numba.njit(cache=True, nogil=True)
def _run_row_colours(  # type: ignore[no-untyped-def]
    m, depth, payload, row_stride, peaks, first, offset, reach, across, exits, run_first,
    direction, lens, asked, shown_by, palette, place_first, column, panel,
):  # fmt: skip
    """Panel rows are written whole, then what is seen, while they are in the processor's cache."""
    nothing = np.uint32(0xFFFFFFFF)
    seen = np.empty((run_first[m + 1] - run_first[m]) * _FEW, np.uint32)
    _search_row(
        m, depth, payload, row_stride, peaks, first, offset, reach, across, exits, run_first,
        direction, lens, asked, nothing, seen,
    )  # fmt: skip
    pixels, channels = len(across), palette.shape[1]
    for row in range(m * pixels, (m + 1) * pixels):
        panel[row] = 0
        for i in range(place_first[row], place_first[row + 1]):
            source = seen[shown_by[i]]
            if source != nothing:
                for c in range(channels):
                    panel[row, column[i], c] = palette[source, c]


@numba.njit(cache=True, nogil=True)
def _search_row(  # type: ignore[no-untyped-def]
    m, depth, payload, row_stride, peaks, first, offset, reach, across, exits, run_first,
    direction, lens, asked, empty, seen,
):  # fmt: skip
    """What all lenses of a row's runs show, asked for or not, each run from near to far.

    To sort out those asked for one by one, here, would take longer than to search.
    """
    pixels = len(across)
    maxima = np.empty((across[:, 2].max() + 1, peaks.shape[1]), np.float32)
    bounded = -1
    for r in range(run_first[m], run_first[m + 1]):
        v, u = direction[r] // pixels, direction[r] % pixels
        if v != bounded:
            bounded = v
            _maxima(peaks, m + reach[v, 0], m + reach[v, 1], maxima)
        left, right, level = lens[r] + across[u, 0], lens[r] + across[u, 1], across[u, 2]
        most = max(maxima[level, left], maxima[level, right])
        k, end = np.uintp(first[direction[r]]), np.uintp(first[direction[r] + 1])
        while k < end and exits[k] > most:
            k += np.uintp(1)
        base = m * row_stride + lens[r]
        searching = lanes_of(asked[r])
        shown = same_for(searching, empty)
        while k < end:
            cell = np.uintp(base + offset[k])
            near = load_for(searching, depth, cell)
            hit = both(searching, at_least(near, same_for(searching, exits[k])))
            shown = choose(hit, load_for(searching, payload, cell), shown)
            searching = but_not(searching, hit)
            if not any_lane(searching):
                break
            k += np.uintp(1)
        store(seen, np.uintp((r - run_first[m]) * _FEW), shown)


@numba.njit(cache=True, nogil=True)
def _maxima(peaks, top, bottom, maxima):  # type: ignore[no-untyped-def]
    """Greatest of 2^level slots from one on, in slot rows top to bottom, both counted, by level."""
    levels, count = maxima.shape
    for j in range(count):
        maxima[0, j] = peaks[top, j]
    for i in range(top + 1, bottom + 1):
        for j in range(count):
            z, most = peaks[i, j], maxima[0, j]
            maxima[0, j] = z if z > most else most
    for level in range(1, levels):
        half = 1 << (level - 1)
        for j in range(count - half):
            a, b = maxima[level - 1, j], maxima[level - 1, j + half]
            maxima[level, j] = a if a > b else b
        # No run asks for what would lie beyond the row.
        for j in range(count - half, count):
            maxima[level, j] = maxima[level - 1, j]
