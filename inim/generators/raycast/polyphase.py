"""Running direction templates over all lenses at once, without a gather.

The picture is copied into *phases*: cells at the same place of every lens pitch lie side by side,
so what one template entry reads for a row of lenses is contiguous: a vector of depths, one of
colours.

A strip of lenses (`raycast.simd`) follows a direction's list from near to far until each
has hit.

Entries left above the nearest surface that the strip can reach cannot hit, as a hit takes a depth
of at least the exit: they are passed over first. There is no such bound below. A cell is solid from
its depth back, so under the farthest surface a ray still hits the next covered cell, and that there
is none left on its way only the cells themselves can tell: to ask them whether they are covered
costs the load that asks them for their depth. Lenses with nothing covered in reach could be left
out of a strip, yet hardly a search would end sooner, for the rays of others beside the object.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numba
import numpy as np

from inim.display import Display
from inim.generators.base import HOLE, PictureShape, SourceGenerator, Sources
from inim.generators.raycast.cells import CENTRE, Aside, cell_rays
from inim.generators.raycast.direction_lists import DirectionLists, build_lists, cells_per_pitch
from inim.generators.raycast.simd import (
    BLOCK,
    LANES,
    all_lanes,
    any_lane,
    at_least,
    both,
    but_not,
    choose,
    load,
    same,
    store,
    transpose,
)
from inim.rgbd import RGBD

__all__ = [
    "PhaseGenerator",
    "Phases",
    "SharedDirections",
    "fits_tables",
    "index_payload",
    "nearest_surface",
    "write_strip",
]

# Of the compiler's own type: a Python integer would make addresses signed, and checked.
_LANES = np.uintp(LANES)

_NO_PAYLOAD = np.empty((0, 0), np.uint32)

# Cells from which on waking the other threads pays off: filling takes about 2 ns a cell, waking
# them about 0.1 ms.
_WORTH_SHARING = 50_000
# Slots for depths and payloads, 8 bytes each, below which nobody asks how many are needed.
_MOST_SLOTS = 2**25


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
    nearest : (slots down, strips) float32
        Greatest depth, in a row of slots, of what a strip of lenses can reach.
    """

    depth: np.ndarray
    payload: np.ndarray
    origin: tuple[int, int]
    window: tuple[int, int]
    nearest: np.ndarray

    @classmethod
    def make(
        cls,
        per_pitch: int,
        rows: np.ndarray,
        columns: np.ndarray,
        lenses: tuple[int, int],
    ) -> Phases:
        """Lay out the phases.

        Parameters
        ----------
        per_pitch : int
            Picture cells per lens pitch.
        rows, columns : int arrays
            All cells that rays of the lens (0, 0) visit.
        lenses : (rows, columns)
        """
        first = [int(cells.min()) // per_pitch for cells in (rows, columns)]
        last = [int(cells.max()) // per_pitch for cells in (rows, columns)]
        window = (last[0] - first[0] + 1, last[1] - first[1] + 1)
        down = lenses[0] + window[0] - 1
        across = max(lenses[1], LANES) + window[1] - 1
        shape = (down, per_pitch, per_pitch, across)
        strips = -(-lenses[1] // LANES)
        return cls(
            np.full(shape, -np.inf, np.float32),
            np.zeros(shape, np.uint32),
            (first[0] * per_pitch, first[1] * per_pitch),
            window,
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

    def offset(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Flat distance of picture cells of lens (0, 0) from slot (0, 0)."""
        offset: np.ndarray = self.row_offset(rows) + self.column_offset(columns)
        return offset

    def slots(self, shape: PictureShape) -> np.ndarray:
        """Flat slot of each cell of a picture, (cells,) int32; -1: beyond what rays reach."""
        down, k, _, across = self.depth.shape
        rows, columns = (np.arange(count) for count in shape)
        reached = [
            (cells >= first) & (cells < first + count * k)
            for cells, first, count in zip(
                (rows, columns), self.origin, (down, across), strict=True
            )
        ]
        slots = self.row_offset(rows)[:, None] + self.column_offset(columns)
        return np.where(np.logical_and.outer(*reached), slots, -1).astype(np.int32).reshape(-1)

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

    def fill(self, depth_mm: np.ndarray, covered: np.ndarray, payload: np.ndarray | None) -> None:
        """Take in a picture: (H, W) float32, bool, uint32; without a payload, the last one's."""
        fill = _fill if self.depth.size < _WORTH_SHARING else _fill_shared
        anew = payload is not None
        fill(
            depth_mm, covered, payload if payload is not None else _NO_PAYLOAD, anew, *self.origin,
            self.depth, self.payload, self.window[1], self.nearest,
        )  # fmt: skip


class PhaseGenerator(SourceGenerator):
    """First hits in a picture laid out by phases: whole cells per lens pitch."""

    def __init__(self, display: Display, shape: PictureShape, pixel_mm: float) -> None:
        super().__init__(display, shape, pixel_mm)
        self._index = index_payload(shape)
        self._holds_index = False
        self._phases: Phases  # made by each in its way

    def _fill(self, rgbd: RGBD, payload: np.ndarray) -> None:
        """Take in a picture; the index, which is that of every picture, only once."""
        of_index = payload is self._index
        known, self._holds_index = of_index and self._holds_index, False
        self._phases.fill(rgbd.depth_mm, rgbd.covered, None if known else payload)
        self._holds_index = of_index

    @abstractmethod
    def _run(self, rgbd: RGBD, payload: np.ndarray, empty: int, out: np.ndarray) -> None:
        """Show each panel pixel the payload of its first hit, all uint32."""

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        found = np.empty(self.made_shape, np.int32)
        self._run(rgbd, self._index, HOLE % 2**32, found.view(np.uint32))
        return found

    def shows_sources(self, rgbd: RGBD) -> bool:  # noqa: ARG002
        """See `SourceGenerator.shows_sources`."""
        return True

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`; RGBA goes to the panel without a source map between."""
        if rgbd.color.dtype != np.uint8:
            return super().generate(rgbd, out)
        self.check(rgbd)
        out = self.place(rgbd, out)
        self._run(rgbd, rgbd.color.view(np.uint32)[..., 0], 0, out.view(np.uint32)[..., 0])
        return out


class SharedDirections(PhaseGenerator):
    """One list of cells per direction for all lenses.

    Parameters
    ----------
    display, shape, pixel_mm :
        See `inim.generators.prepare`.
    aside : Aside
        Where in its pixel each ray starts.
    """

    def __init__(
        self, display: Display, shape: PictureShape, pixel_mm: float, aside: Aside = CENTRE
    ) -> None:
        super().__init__(display, shape, pixel_mm)
        lists = self._lists = build_lists(display, shape, pixel_mm, aside)
        lenses = (display.lens_rows, display.lens_columns)
        self._phases = Phases.make(lists.per_pitch, lists.row, lists.column, lenses)
        self._offset = self._phases.offset(lists.row, lists.column)
        self._reach = self._phases.row_reach(lists.row, lists.first[: -1 : lists.pixels])

    def _run(self, rgbd: RGBD, payload: np.ndarray, empty: int, out: np.ndarray) -> None:
        self._fill(rgbd, payload)
        run_templates(self._lists, self._offset, self._reach, self._phases, empty, out)


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
    lenses = out.shape[1] // lists.pixels
    _run(
        phases.depth.reshape(-1), phases.payload.reshape(-1), phases.depth[0].size, phases.nearest,
        lists.first, offset, reach, lists.exit_mm,
        np.arange(lenses) * lists.pixels, np.full(lenses, lists.pixels),
        np.uint32(empty), out,
    )  # fmt: skip


def index_payload(shape: PictureShape) -> np.ndarray:
    """Flat cell numbers as a payload, so that a run yields sources."""
    return np.arange(shape[0] * shape[1], dtype=np.uint32).reshape(shape)


@numba.njit(parallel=True, cache=True, nogil=True)
def _fill_shared(  # type: ignore[no-untyped-def]
    depth, covered, payload, anew, row0, column0, phase_depth, phase_payload, reach, nearest
):
    """`_fill`, shared among the threads."""
    for i in numba.prange(phase_depth.shape[0]):
        row = np.int64(i)
        _fill_row(row, depth, covered, payload, anew, row0, column0, phase_depth, phase_payload)
        _bound_row(row, phase_depth, reach, nearest)


@numba.njit(cache=True, nogil=True)
def _fill(  # type: ignore[no-untyped-def]
    depth, covered, payload, anew, row0, column0, phase_depth, phase_payload, reach, nearest
):
    """Copy a picture into phases, and find the nearest surface of each strip.

    Cells beyond the picture were set once and stay.
    """
    for i in range(phase_depth.shape[0]):
        _fill_row(i, depth, covered, payload, anew, row0, column0, phase_depth, phase_payload)
        _bound_row(i, phase_depth, reach, nearest)


@numba.njit(cache=True, nogil=True)
def _fill_row(  # type: ignore[no-untyped-def]
    i, depth, covered, payload, anew, row0, column0, phase_depth, phase_payload
):
    rows, columns = depth.shape
    _, k, _, across = phase_depth.shape
    for p in range(k):
        row = row0 + i * k + p
        if row < 0 or row >= rows:
            continue
        for q in range(k):
            first = max(0, -(-(-column0 - q) // k) if column0 + q < 0 else 0)
            last = min(across, (columns - column0 - q + k - 1) // k)
            for j in range(first, last):
                column = column0 + j * k + q
                hit = covered[row, column]
                phase_depth[i, p, q, j] = depth[row, column] if hit else np.float32(-np.inf)
            if anew:
                for j in range(first, last):
                    phase_payload[i, p, q, j] = payload[row, column0 + j * k + q]


@numba.njit(cache=True, nogil=True)
def _bound_row(i, depth, reach, nearest):  # type: ignore[no-untyped-def]
    _, k, _, across = depth.shape
    peaks = np.empty(across, np.float32)  # of each slot
    for j in range(across):
        peaks[j] = -np.inf
    for p in range(k):
        for q in range(k):
            for j in range(across):
                z, most = depth[i, p, q, j], peaks[j]
                peaks[j] = z if z > most else most
    for s in range(nearest.shape[1]):
        start = min(s * LANES, across - LANES - reach + 1)
        most = np.float32(-np.inf)
        for j in range(start, start + LANES + reach - 1):
            most = max(most, peaks[j])
        nearest[i, s] = most


@numba.njit(parallel=True, cache=True, nogil=True)
def _run(  # type: ignore[no-untyped-def]
    depth, payload, row_stride, nearest, first, offset, reach, exits, columns, widths, empty, out
):
    """All lens rows, shared among the threads."""
    pixels = widths[0]
    for m in numba.prange(out.shape[0] // pixels):
        strip = np.empty(pixels * LANES, np.uint32)
        # The loop's own index is unsigned: passed on as it is, the row is compiled twice.
        _run_row(
            np.int64(m), depth, payload, row_stride, nearest, first, offset, reach, exits,
            columns, widths, empty, strip, out,
        )  # fmt: skip


@numba.njit(cache=True, nogil=True)
def _run_row(  # type: ignore[no-untyped-def]
    m, depth, payload, row_stride, nearest, first, offset, reach, exits, columns, widths, empty,
    strip, out,
):  # fmt: skip
    """One row of lenses, a panel row and a strip at a time."""
    pixels, lenses = widths[0], len(widths)
    for v in range(pixels):
        for s in range(nearest.shape[1]):
            start = max(min(s * LANES, lenses - LANES), 0)
            base = m * row_stride + start
            most = nearest_surface(nearest, m + reach[v, 0], m + reach[v, 1], s)
            for u in range(pixels):
                direction = v * pixels + u
                k, end = np.uintp(first[direction]), np.uintp(first[direction + 1])
                while k < end and exits[k] > most:
                    k += np.uintp(1)
                searching, shown = all_lanes(), same(empty)
                while k < end:
                    cell = np.uintp(base + offset[k])
                    hit = both(searching, at_least(load(depth, cell), same(exits[k])))
                    shown = choose(hit, load(payload, cell), shown)
                    searching = but_not(searching, hit)
                    if not any_lane(searching):
                        break
                    k += np.uintp(1)
                store(strip, np.uintp(u) * _LANES, shown)
            write_strip(strip, columns, widths, start, pixels, out[m * pixels + v])


@numba.njit(cache=True, nogil=True)
def nearest_surface(nearest, top, bottom, strip):  # type: ignore[no-untyped-def]
    """Greatest depth that a strip can reach in slot rows top to bottom, both counted.

    A loop: reductions over slices take the compiler a second.
    """
    most = nearest[top, strip]
    for i in range(top + 1, bottom + 1):
        most = max(most, nearest[i, strip])
    return most


@numba.njit(cache=True, nogil=True)
def write_strip(strip, columns, widths, start, shared, row):  # type: ignore[no-untyped-def]
    """Write a strip to its panel row.

    Parameters
    ----------
    strip : (most pixels per lens x LANES,) uint32
    columns, widths : (lenses,) int64
        First panel column of each lens, and how many it has.
    start : int
        The strip's first lens.
    shared : int
        Pixels that every lens has at least.
    row : (panel columns,) uint32
    """
    lanes = min(LANES, len(widths))
    blocked = lanes - lanes % BLOCK
    whole = shared - shared % BLOCK
    # A last block that covers some pixels again is cheaper than three or more one by one.
    again = shared >= BLOCK and shared - whole > 2
    for n in range(0, blocked, BLOCK):
        lens = np.uintp(start + n)
        for u in range(0, whole, BLOCK):
            transpose(strip, np.uintp(u * LANES + n), row, np.uintp(u), columns, lens)
        if again:
            u = shared - BLOCK
            transpose(strip, np.uintp(u * LANES + n), row, np.uintp(u), columns, lens)
    for n in range(lanes):
        written = 0 if n >= blocked else shared if again else whole
        for u in range(written, widths[start + n]):
            row[columns[start + n] + u] = strip[u * LANES + n]


def fits_tables(display: Display, shape: PictureShape, pixel_mm: float, layers: int = 1) -> bool:
    """Whether pictures laid out by phases, with all that rays reach around, take little memory.

    Where they do not, rays are walked one by one: the same bits.
    """
    per_pitch = cells_per_pitch(display, pixel_mm)
    if not per_pitch:
        return False
    columns, rows = (
        2 + axis.most_cells(display.depth_range_mm) // per_pitch
        for axis in cell_rays(shape, pixel_mm, display)
    )
    across = max(display.lens_columns, LANES) + columns
    cells = (display.lens_rows + rows) * across * per_pitch * per_pitch * layers
    panel = display.eia_shape[0] * display.eia_shape[1]
    return cells <= max(_MOST_SLOTS, 4 * (panel + shape[0] * shape[1]))
