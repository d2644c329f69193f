"""Running direction templates over all lenses at once, without a gather.

The picture is copied into *phases*: cells at the same place of every lens pitch lie side by side,
so what one template entry reads for a row of lenses is contiguous, and the inner loop is loads,
compares and selects over neighbouring lenses, which compilers turn into vector instructions.

For a strip of lenses and a direction, entries are applied from far to near, each overwriting what
its cells hide: no early exit, no branch. What shortens the work is the picture's depth bounds near
the strip: entries left above the nearest surface cannot hit, and behind the first entry left below
the farthest one everything is hidden.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from inim.generators.base import PictureShape
from inim.generators.direction_lists import DirectionLists

__all__ = ["STRIP", "Phases", "depth_bounds", "index_payload", "run_templates"]

# Lenses per strip, a constant for the compiler: four 512-bit vectors, or eight of 256. Longer
# strips have looser depth bounds, shorter ones more overhead.
STRIP = 64
_LANES = np.uintp(STRIP)


@dataclass(frozen=True)
class Phases:
    """Buffers and addresses of one display and picture size; filled anew for every picture.

    Attributes
    ----------
    depth : (slots down, per_pitch, per_pitch, slots across) float32
        Depths by phase, -inf where nothing is covered, and around the picture.
    payload : same shape, uint32
        What a hit shows: an RGBA colour, or an index.
    origin : (row, column) of int
        Picture cell of slot (0, 0), phase (0, 0); negative where slots reach beyond the picture.
    window : (slots down, slots across) of int
        Slots that the rays of one lens can reach.
    strip : int
        Lenses per strip.
    low, high : (slots down, strips) float32
        Depth bounds, in a row of slots, of what a strip of lenses can reach.
    """

    depth: np.ndarray
    payload: np.ndarray
    origin: tuple[int, int]
    window: tuple[int, int]
    strip: int
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def make(
        cls,
        per_pitch: int,
        rows: np.ndarray,
        columns: np.ndarray,
        lenses: tuple[int, int],
        strip: int,
    ) -> Phases:
        """Lay out the phases.

        Parameters
        ----------
        per_pitch : int
            Picture cells per lens pitch.
        rows, columns : int arrays
            All cells that rays of the lens (0, 0) visit.
        lenses : (rows, columns)
        strip : int
            Neighbouring lenses that are worked on at once.
        """
        first = [int(cells.min()) // per_pitch for cells in (rows, columns)]
        last = [int(cells.max()) // per_pitch for cells in (rows, columns)]
        window = (last[0] - first[0] + 1, last[1] - first[1] + 1)
        down = lenses[0] + window[0] - 1
        across = max(lenses[1], strip) + window[1] - 1
        shape = (down, per_pitch, per_pitch, across)
        strips = -(-lenses[1] // strip)
        return cls(
            np.full(shape, -np.inf, np.float32),
            np.zeros(shape, np.uint32),
            (first[0] * per_pitch, first[1] * per_pitch),
            window,
            strip,
            np.empty((down, strips), np.float32),
            np.empty((down, strips), np.float32),
        )

    def row_offset(self, rows: np.ndarray) -> np.ndarray:
        """Flat distance of picture rows of lens row 0 from slot row 0; add a column's."""
        _, k, _, across = self.depth.shape
        # Slots and the phases inside them follow one another, row by row.
        offset: np.ndarray = (np.asarray(rows, np.int64) - self.origin[0]) * (k * across)
        return offset

    def column_offset(self, columns: np.ndarray) -> np.ndarray:
        """Flat distance of picture columns of lens column 0 from slot column 0."""
        _, k, _, across = self.depth.shape
        slot, phase = np.divmod(np.asarray(columns, np.int64) - self.origin[1], k)
        offset: np.ndarray = phase * across + slot
        return offset

    def row_reach(self, rows: np.ndarray, first: np.ndarray) -> np.ndarray:
        """First and last row of slots, from a lens's own, of runs of picture rows of lens row 0.

        Parameters
        ----------
        rows : (n,) int array
        first : (m,) int array
            Where each run begins.

        Returns
        -------
        (m, 2) int array
        """
        slots = (rows - self.origin[0]) // self.depth.shape[1]
        ends = [extreme.reduceat(slots, first) for extreme in (np.minimum, np.maximum)]
        return np.stack(ends, axis=1)

    def fill(self, depth_mm: np.ndarray, covered: np.ndarray, payload: np.ndarray) -> None:
        """Take in a picture: (H, W) float32, bool, uint32."""
        _fill(depth_mm, covered, payload, *self.origin, self.depth, self.payload)
        _bound(self.depth, self.window[1], self.strip, self.low, self.high)


def run_templates(
    lists: DirectionLists,
    offset: np.ndarray,
    reach: np.ndarray,
    phases: Phases,
    empty: int,
    out: np.ndarray,
) -> None:
    """Show each panel pixel the payload of its first hit.

    Parameters
    ----------
    lists : DirectionLists
    offset : (n,) int64
        Flat distance from a lens's slot to each entry's cell.
    reach : (pixels, 2) int64
        First and last row of slots, from the lens's own, that each pixel row's rays visit.
    phases : Phases
        Holding the picture.
    empty : int
        What a hole shows.
    out : (rows, columns) uint32
    """
    _run(
        phases.depth.reshape(-1),
        phases.payload.reshape(-1),
        phases.depth[0].size,
        lists.first,
        offset,
        reach,
        lists.exit_mm,
        lists.pixels,
        out.shape[1] // lists.pixels,
        phases.low,
        phases.high,
        np.uint32(empty),
        out.reshape(-1),
    )


def index_payload(shape: PictureShape) -> np.ndarray:
    """Flat cell numbers as a payload, so that a run yields sources."""
    return np.arange(shape[0] * shape[1], dtype=np.uint32).reshape(shape)


@numba.njit(cache=True, nogil=True)
def _fill(depth, covered, payload, row0, column0, phase_depth, phase_payload):  # type: ignore[no-untyped-def]
    """Copy a picture into phases; cells beyond it were set once and stay."""
    rows, columns = depth.shape
    down, k, _, across = phase_depth.shape
    for i in range(down):
        for p in range(k):
            row = row0 + i * k + p
            if row < 0 or row >= rows:
                continue
            for q in range(k):
                first = max(0, -(-(-column0 - q) // k) if column0 + q < 0 else 0)
                for j in range(first, across):
                    column = column0 + j * k + q
                    if column >= columns:
                        break
                    hit = covered[row, column]
                    phase_depth[i, p, q, j] = depth[row, column] if hit else np.float32(-np.inf)
                    phase_payload[i, p, q, j] = payload[row, column]


@numba.njit(cache=True, nogil=True)
def _bound(depth, reach, strip, low, high):  # type: ignore[no-untyped-def]
    """Least and greatest depth that each strip can reach in each row of slots."""
    down, k, _, across = depth.shape
    for i in range(down):
        for s in range(low.shape[1]):
            start = min(s * strip, across - strip - reach + 1)
            least, most = np.float32(np.inf), np.float32(-np.inf)
            for p in range(k):
                for q in range(k):
                    for j in range(start, start + strip + reach - 1):
                        z = depth[i, p, q, j]
                        least = z if z < least else least
                        most = z if z > most else most
            low[i, s], high[i, s] = least, most


@numba.njit(parallel=True, cache=True, nogil=True)
def _run(  # type: ignore[no-untyped-def]
    depth, payload, row_stride, first, offset, reach, exits, pixels, lenses, low, high, empty, out
):
    """All lens rows, shared among the threads."""
    for m in numba.prange(out.size // (pixels * pixels * lenses)):
        strip = np.empty(pixels * STRIP, np.uint32)
        # The loop's own index is unsigned: passed on as it is, the row is compiled twice.
        _run_row(
            np.int64(m), depth, payload, row_stride, first, offset, reach, exits, pixels, lenses,
            low, high, empty, strip, out,
        )  # fmt: skip


# A function of its own: inside the parallel loop's body the compiler gives up on vectors.
@numba.njit(cache=True, nogil=True)
def _run_row(  # type: ignore[no-untyped-def]
    m,
    depth,
    payload,
    row_stride,
    first,
    offset,
    reach,
    exits,
    pixels,
    lenses,
    low,
    high,
    empty,
    strip,
    out,
):
    """One row of lenses, a panel row and a strip at a time."""
    for v in range(pixels):
        for s in range(low.shape[1]):
            start = max(min(s * STRIP, lenses - STRIP), 0)
            base = m * row_stride + start
            least, most = depth_bounds(low, high, m + reach[v, 0], m + reach[v, 1], s)
            for u in range(pixels):
                direction = v * pixels + u
                near, far = _useful(exits, first[direction], first[direction + 1] - 1, least, most)
                _apply(depth, payload, base, offset, exits, near, far, empty, strip, u)
            place = ((m * pixels + v) * lenses + start) * pixels
            _interleave(strip, pixels, min(STRIP, lenses), out, place)


@numba.njit(cache=True, nogil=True)
def depth_bounds(low, high, top, bottom, strip):  # type: ignore[no-untyped-def]
    """Least and greatest depth of a strip's bounds over slot rows top to bottom, both counted.

    Loops: reductions over slices take the compiler a second.
    """
    least, most = low[top, strip], high[top, strip]
    for i in range(top + 1, bottom + 1):
        least = min(least, low[i, strip])
        most = max(most, high[i, strip])
    return least, most


@numba.njit(cache=True, nogil=True, inline="always")
def _useful(exits, near, far, low, high):  # type: ignore[no-untyped-def]
    """The entries that can decide: between the first that can hit and the first that must."""
    while near < far and exits[near] > high:
        near += 1
    must = near
    while must < far and exits[must] > low:
        must += 1
    return near, must


@numba.njit(cache=True, nogil=True, inline="always")
def _apply(depth, payload, base, offset, exits, near, far, empty, strip, u):  # type: ignore[no-untyped-def]
    """Apply entries far..near of one direction to a strip of lenses, four at a time.

    In a group that is not full the nearest entry is applied again, which changes nothing. Every
    load is unconditional, and lies within the phases: a conditional one would not become a vector.
    """
    at = np.uintp(u * STRIP)
    k1, k2, k3 = max(far - 1, near), max(far - 2, near), max(far - 3, near)
    _show(
        depth, payload, empty, strip, at,
        np.uintp(base + offset[far]), np.uintp(base + offset[k1]),
        np.uintp(base + offset[k2]), np.uintp(base + offset[k3]),
        exits[far], exits[k1], exits[k2], exits[k3],
    )  # fmt: skip
    k = far - 4
    while k >= near:
        k1, k2, k3 = max(k - 1, near), max(k - 2, near), max(k - 3, near)
        _overwrite(
            depth, payload, strip, at,
            np.uintp(base + offset[k]), np.uintp(base + offset[k1]),
            np.uintp(base + offset[k2]), np.uintp(base + offset[k3]),
            exits[k], exits[k1], exits[k2], exits[k3],
        )  # fmt: skip
        k -= 4


@numba.njit(cache=True, nogil=True, inline="always")
def _show(depth, payload, empty, strip, at, a0, a1, a2, a3, z0, z1, z2, z3):  # type: ignore[no-untyped-def]
    """Four entries, the farthest first, over an empty strip."""
    for n in range(_LANES):
        reached, candidate = depth[a0 + n], payload[a0 + n]
        shown = candidate if reached >= z0 else empty
        reached, candidate = depth[a1 + n], payload[a1 + n]
        shown = candidate if reached >= z1 else shown
        reached, candidate = depth[a2 + n], payload[a2 + n]
        shown = candidate if reached >= z2 else shown
        reached, candidate = depth[a3 + n], payload[a3 + n]
        strip[at + n] = candidate if reached >= z3 else shown


@numba.njit(cache=True, nogil=True, inline="always")
def _overwrite(depth, payload, strip, at, a0, a1, a2, a3, z0, z1, z2, z3):  # type: ignore[no-untyped-def]
    """Four entries, the farthest first, over what a strip shows."""
    for n in range(_LANES):
        shown = strip[at + n]
        reached, candidate = depth[a0 + n], payload[a0 + n]
        shown = candidate if reached >= z0 else shown
        reached, candidate = depth[a1 + n], payload[a1 + n]
        shown = candidate if reached >= z1 else shown
        reached, candidate = depth[a2 + n], payload[a2 + n]
        shown = candidate if reached >= z2 else shown
        reached, candidate = depth[a3 + n], payload[a3 + n]
        strip[at + n] = candidate if reached >= z3 else shown


@numba.njit(cache=True, nogil=True, inline="always")
def _interleave(strip, pixels, lanes, out, place):  # type: ignore[no-untyped-def]
    """Write a strip, one run of lenses per pixel column, as the panel's row."""
    at, width = np.uintp(place), np.uintp(pixels)
    for n in range(np.uintp(lanes)):
        for u in range(width):
            out[at + u] = strip[u * _LANES + n]
        at += width
