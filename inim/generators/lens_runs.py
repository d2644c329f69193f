"""Direction templates over a few neighbouring lenses: the pixels that somebody asks for.

From an eye, neighbouring lenses show nearly the same pixel: it drifts by one every handful of
lenses. So the pixels asked for are short runs of lenses in one direction, of which each is one
vector as in `inim.generators.polyphase`, only narrower: the eight lenses from a run's first on,
with a flag for each that is asked for. Scattered pixels are runs of one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from inim.generators.base import AskedPixels
from inim.generators.direction_lists import DirectionLists
from inim.generators.lanes import (
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
from inim.generators.polyphase import Phases, nearest_surface

__all__ = ["LensRuns", "run_asked"]

# Lenses of a run: as many as a byte has bits, and floats in a 256-bit vector. An eye at arm's
# length sees the same pixel of some seven lenses of 1 mm.
_FEW = 8


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
    asked : (runs,) uint8
        Which lenses from there on are asked for, a bit each.
    place : (runs, 8) int32
        Where in the list of pixels each of those asked for stands.
    """

    first: np.ndarray
    direction: np.ndarray
    lens: np.ndarray
    asked: np.ndarray
    place: np.ndarray

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
        asked, place = np.zeros(most, np.uint8), np.empty((most, _FEW), np.int32)
        first = np.zeros(lenses[0] + 1, np.int64)
        runs = _gather(
            pixels.rows, pixels.columns, per_lens, lenses[1], first, direction, lens, asked, place
        )
        return cls(
            np.cumsum(first), direction[:runs].copy(), lens[:runs].copy(), asked[:runs].copy(),
            place[:runs].copy(),
        )  # fmt: skip


@numba.njit(cache=True, nogil=True)
def _gather(rows, columns, per_lens, lenses, first, direction, lens, asked, place):  # type: ignore[no-untyped-def]
    """Fill the runs of pixels in the panel's order, count those of each row of lenses."""
    last = max(lenses, LANES) - _FEW  # beyond it, vectors would leave their slots
    open_run = np.empty(per_lens, np.int64)
    runs, row = 0, -1
    for i in range(len(rows)):
        if rows[i] != row:
            row = rows[i]
            open_run[:] = -1
        n, u = columns[i] // per_lens, columns[i] % per_lens
        r = open_run[u]
        if r < 0 or n >= lens[r] + _FEW:
            r = runs
            runs += 1
            open_run[u] = r
            direction[r] = (row % per_lens) * per_lens + u
            lens[r] = min(n, last)
            first[row // per_lens + 1] += 1
        lane = n - lens[r]
        asked[r] |= np.uint8(1 << lane)
        place[r, lane] = i
    return runs


def run_asked(
    lists: DirectionLists,
    offset: np.ndarray,
    reach: np.ndarray,
    phases: Phases,
    runs: LensRuns,
    empty: int,
    out: np.ndarray,
) -> None:
    """Show each pixel asked for the payload of its first hit.

    Parameters
    ----------
    lists, offset, reach, phases, empty :
        As for `inim.generators.polyphase.run_templates`.
    runs : LensRuns
    out : (n,) uint32
    """
    _run(
        phases.depth.reshape(-1), phases.payload.reshape(-1), phases.depth[0].size, phases.nearest,
        lists.first, offset, reach, lists.exit_mm, lists.pixels,
        runs.first, runs.direction, runs.lens, runs.asked, runs.place, np.uint32(empty), out,
    )  # fmt: skip


@numba.njit(parallel=True, cache=True, nogil=True)
def _run(  # type: ignore[no-untyped-def]
    depth, payload, row_stride, nearest, first, offset, reach, exits, pixels, run_first, direction,
    lens, asked, place, empty, out,
):  # fmt: skip
    """All lens rows, shared among the threads."""
    for m in numba.prange(len(run_first) - 1):
        _run_row(
            np.int64(m), depth, payload, row_stride, nearest, first, offset, reach, exits, pixels,
            run_first, direction, lens, asked, place, empty, out,
        )  # fmt: skip


@numba.njit(cache=True, nogil=True)
def _run_row(  # type: ignore[no-untyped-def]
    m, depth, payload, row_stride, nearest, first, offset, reach, exits, pixels, run_first,
    direction, lens, asked, place, empty, out,
):  # fmt: skip
    """The runs of one row of lenses, each near to far until all of it has hit."""
    strips = nearest.shape[1]
    most, few = np.empty(strips, np.float32), np.empty(_FEW, np.uint32)
    bounded = -1
    for r in range(run_first[m], run_first[m + 1]):
        v = direction[r] // pixels
        if v != bounded:
            bounded = v
            for s in range(strips):
                most[s] = nearest_surface(nearest, m + reach[v, 0], m + reach[v, 1], s)
        left = min(lens[r] // LANES, strips - 1)
        right = min((lens[r] + _FEW - 1) // LANES, strips - 1)
        reached = max(most[left], most[right])
        k, end = np.uintp(first[direction[r]]), np.uintp(first[direction[r] + 1])
        while k < end and exits[k] > reached:
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
        store(few, np.uintp(0), shown)
        bits = asked[r]
        for n in range(_FEW):
            if bits >> n & 1:
                out[place[r, n]] = few[n]
