"""Local depth templates, and pictures in their memory layout: all lenses at once, without a gather.

Co-located pixels of all elemental images have parallel rays. If the picture has a whole number
of pixels per lens pitch, such rays meet the same cells, shifted by whole lenses. The
list of cells on a ray, with the depths of their exits, is then built once per
direction (v, u) and serves every lens.

The picture is copied into *phases*: cells at the same place of every lens pitch are adjacent, so
the values that one template entry reads for a row of lenses are contiguous: a vector of depths, and
one of colours.

A strip of lenses (`raycast.simd`) follows a direction's list from near to far until each
lens has a hit.

Entries with exits above the nearest surface within reach of the strip cannot hit, because a hit
needs a depth of at least the exit. They are skipped first. There is no such bound below. With solid
columns, a ray under the farthest surface still hits the next covered cell, and only the cells
themselves show whether there is one: testing their coverage costs as much as loading their depth.
Lenses without covered cells in reach could be removed from a strip, but hardly a search would end
sooner, because of the rays of other lenses next to the object.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from inim.backend.kernels import compiled, prange
from inim.display import Display
from inim.display.pixels import exact_length
from inim.generators.base import CENTRE, HOLE, PictureShape, PixelOffset, Search, Sources
from inim.generators.raycast.cells import CellRays, cell_rays
from inim.generators.raycast.columns import Columns, columns_of
from inim.generators.raycast.ray_by_ray import FirstHits, rounded_up, walk
from inim.generators.raycast.simd import BLOCK, LANES, transpose
from inim.image.rgbd import RGBD, Layer

_NO_PAYLOAD, _NO_BACKS = np.empty((0, 0), np.uint32), np.empty((0, 0), np.float32)

# Cells from which on waking the other threads pays off: filling takes about 2 ns a cell, waking
# them about 0.1 ms.
_WORTH_SHARING = 50_000
# Slots for depths and payloads, 8 bytes each, below which nobody asks how many are needed.
_MOST_SLOTS = 2**25


@dataclass(frozen=True)
class Layout:
    """Addresses of picture cells in phases, of one display and picture size.

    Attributes
    ----------
    shape : (slots down, per_pitch, per_pitch, slots across)
    origin : (row, column) of int
        Picture cell of slot (0, 0), phase (0, 0); negative where slots reach beyond the picture.
    window : (slots down, slots across) of int
        Slots that the rays of one lens can reach.
    strips : int
        Strips of lenses in a row.
    """

    shape: tuple[int, int, int, int]
    origin: tuple[int, int]
    window: tuple[int, int]
    strips: int

    @classmethod
    def of(cls, per_pitch: int, rows: np.ndarray, columns: np.ndarray, display: Display) -> Layout:
        """Lay out the phases.

        Parameters
        ----------
        per_pitch : int
            Picture cells per lens pitch.
        rows, columns : int arrays
            All cells that rays of the lens (0, 0) visit.
        display : Display
        """
        first = [int(cells.min()) // per_pitch for cells in (rows, columns)]
        last = [int(cells.max()) // per_pitch for cells in (rows, columns)]
        window = (last[0] - first[0] + 1, last[1] - first[1] + 1)
        down = display.lens_rows + window[0] - 1
        across = max(display.lens_columns, LANES) + window[1] - 1
        return cls(
            (down, per_pitch, per_pitch, across),
            (first[0] * per_pitch, first[1] * per_pitch),
            window,
            -(-display.lens_columns // LANES),
        )

    @property
    def row_stride(self) -> int:
        """Flat distance from one row of slots to the next."""
        _, k, _, across = self.shape
        return k * k * across

    def row_offset(self, rows: np.ndarray) -> np.ndarray:
        """Flat distance of picture rows of lens row 0 from slot row 0; add a column's."""
        _, k, _, across = self.shape
        # Slots and the phases inside them follow one another, row by row.
        offset: np.ndarray = (np.asarray(rows, np.int64) - self.origin[0]) * (k * across)
        return offset

    def column_offset(self, columns: np.ndarray) -> np.ndarray:
        """Flat distance of picture columns of lens column 0 from slot column 0."""
        _, k, _, across = self.shape
        slot, phase = np.divmod(np.asarray(columns, np.int64) - self.origin[1], k)
        offset: np.ndarray = phase * across + slot
        return offset

    def slots(self, shape: PictureShape) -> np.ndarray:
        """Flat slot of each cell of a picture, (cells,) int32; -1 outside the reach of rays."""
        down, k, _, across = self.shape
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
        slots = (rows - self.origin[0]) // self.shape[1]
        ends = [extreme.reduceat(slots, first) for extreme in (np.minimum, np.maximum)]
        return np.stack(ends, axis=1)


class Phases:
    """A picture by phases, in buffers that are filled again for every picture.

    Parameters
    ----------
    layout : Layout
    end : bool
        Whether columns end.

    Attributes
    ----------
    layout : Layout
    depth : (n,) float32
        Depths by phase, -inf at uncovered cells, NaN around the picture.
    back : (n,) float32
        Backs of columns, inf at uncovered cells; empty if no column has a back.
    payload : (n,) uint32
        Result of a hit: an RGBA colour, or an index.
    nearest : (slots down, strips) float32
        Greatest depth, in a row of slots, within reach of a strip of lenses.
    farthest : (slots down, strips) float32
        Least depth of a back within the same reach; inf without covered cells.
    """

    def __init__(self, layout: Layout, *, end: bool) -> None:
        self.layout = layout
        size, bounds = math.prod(layout.shape), (layout.shape[0], layout.strips)
        self.depth = np.full(size, np.nan, np.float32)
        self.back = np.full(size if end else 0, np.inf, np.float32)
        self.payload = np.zeros(size, np.uint32)
        self.nearest, self.farthest = np.empty(bounds, np.float32), np.empty(bounds, np.float32)

    def fill(self, layer: Layer, payload: np.ndarray | None) -> None:
        """Take in a picture's front surface, and (H, W) uint32; without these, the last ones."""
        fill = _fill if self.depth.size < _WORTH_SHARING else _fill_shared
        anew, shape = payload is not None, self.layout.shape
        back = self.back.reshape(shape if self.back.size else (0, 0, 0, 0))
        fill(
            layer.front_mm, layer.covered, layer.back_mm if self.back.size else _NO_BACKS,
            payload if payload is not None else _NO_PAYLOAD, anew, *self.layout.origin,
            self.depth.reshape(shape), back, self.payload.reshape(shape), self.layout.window[1],
            self.nearest, self.farthest,
        )  # fmt: skip


class PhaseGenerator(FirstHits):
    """First hits in a picture laid out by phases: whole cells per lens pitch."""

    _phases: Phases
    _layout: Layout

    def _prepare(self) -> None:
        # Flat cell numbers as a payload, so that a run yields sources.
        self._index = np.arange(self.shape[0] * self.shape[1], dtype=np.uint32).reshape(self.shape)
        self._holds_index = False

    @abstractmethod
    def _take(self, columns: Columns, payloads: Sequence[np.ndarray]) -> None:
        """Take in a picture, with a payload (H, W) uint32 of each layer."""

    @abstractmethod
    def _run(self, columns: Columns, empty: int, first: int, out: np.ndarray) -> None:
        """Show pixels of panel rows from the first on the payload of their first hit, uint32."""

    def search(self, rgbd: RGBD) -> Search:
        """See `SourceGenerator.search`."""
        columns = columns_of(rgbd, self._rule)
        deeper = range(1, len(columns.layers))
        payloads = [self._index, *(self._index + np.uint32(n * self._index.size) for n in deeper)]
        self._take(columns, payloads)

        def find_rows(rows: slice, out: Sources) -> None:
            self._run(columns, HOLE % 2**32, rows.start, out.view(np.uint32))

        return find_rows

    def shows_sources(self, rgbd: RGBD) -> bool:  # noqa: ARG002
        """See `SourceGenerator.shows_sources`."""
        return True

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`; RGBA goes to the panel without a source map between."""
        if rgbd.color.dtype != np.uint8:
            return super().generate(rgbd, out)
        self.check(rgbd)
        out = self.place(rgbd, out)
        columns = columns_of(rgbd, self._rule)
        words = [
            np.ascontiguousarray(layer.color).view(np.uint32)[..., 0] for layer in columns.layers
        ]
        self._take(columns, words)
        self._run(columns, 0, 0, out.view(np.uint32)[..., 0])
        return out

    def _fill(self, columns: Columns, payload: np.ndarray) -> None:
        """Take in a picture; the index, which is that of every picture, only once."""
        of_index = payload is self._index
        is_current, self._holds_index = of_index and self._holds_index, False
        self._phases.fill(columns.layers[0], None if is_current else payload)
        self._holds_index = of_index


@compiled(parallel=True)
def _fill_shared(  # type: ignore[no-untyped-def]
    depth, covered, back, payload, anew, row0, column0, phase_depth, phase_back, phase_payload,
    reach, nearest, farthest,
):  # fmt: skip
    """`_fill`, shared among the threads."""
    for i in prange(phase_depth.shape[0]):
        row = np.int64(i)
        _fill_row(
            row, depth, covered, back, payload, anew, row0, column0, phase_depth, phase_back,
            phase_payload,
        )  # fmt: skip
        _bound_row(row, phase_depth, phase_back, reach, nearest, farthest)


@compiled
def _fill(  # type: ignore[no-untyped-def]
    depth, covered, back, payload, anew, row0, column0, phase_depth, phase_back, phase_payload,
    reach, nearest, farthest,
):  # fmt: skip
    """Copy a picture into phases, and find the nearest surface of each strip.

    Cells beyond the picture were set once and stay.
    """
    for i in range(phase_depth.shape[0]):
        _fill_row(
            i, depth, covered, back, payload, anew, row0, column0, phase_depth, phase_back,
            phase_payload,
        )  # fmt: skip
        _bound_row(i, phase_depth, phase_back, reach, nearest, farthest)


@compiled
def _fill_row(  # type: ignore[no-untyped-def]
    i, depth, covered, back, payload, anew, row0, column0, phase_depth, phase_back, phase_payload
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
            if phase_back.size:
                for j in range(first, last):
                    phase_back[i, p, q, j] = back[row, column0 + j * k + q]
            if anew:
                for j in range(first, last):
                    phase_payload[i, p, q, j] = payload[row, column0 + j * k + q]


@compiled
def _bound_row(i, depth, back, reach, nearest, farthest):  # type: ignore[no-untyped-def]
    _, k, _, across = depth.shape
    peaks = np.full(across, -np.inf, np.float32)  # of each slot
    feet = np.full(across, np.inf, np.float32)
    for p in range(k):
        for q in range(k):
            for j in range(across):
                z, most = depth[i, p, q, j], peaks[j]
                peaks[j] = z if z > most else most
            if back.size:
                for j in range(across):
                    z, least = back[i, p, q, j], feet[j]
                    feet[j] = z if z < least else least
    for s in range(nearest.shape[1]):
        start = min(s * LANES, across - LANES - reach + 1)
        most, least = np.float32(-np.inf), np.float32(np.inf)
        for j in range(start, start + LANES + reach - 1):
            most, least = max(most, peaks[j]), min(least, feet[j])
        nearest[i, s], farthest[i, s] = most, least


@compiled
def nearest_surface(nearest, top, bottom, strip):  # type: ignore[no-untyped-def]
    """Greatest depth that a strip can reach in slot rows top to bottom, both counted.

    A loop: reductions over slices take the compiler a second.
    """
    most = nearest[top, strip]
    for i in range(top + 1, bottom + 1):
        most = max(most, nearest[i, strip])
    return most


@compiled
def farthest_end(farthest, top, bottom, strip):  # type: ignore[no-untyped-def]
    """Least depth at which a column ends that a strip can reach; as `nearest_surface`."""
    least = farthest[top, strip]
    for i in range(top + 1, bottom + 1):
        least = min(least, farthest[i, strip])
    return least


@compiled
def write_strip(strip, columns, start, pixels, row):  # type: ignore[no-untyped-def]
    """Write a strip to its panel row.

    Parameters
    ----------
    strip : (pixels x LANES,) uint32
    columns : (lenses,) int64
        First panel column of each lens.
    start : int
        The strip's first lens.
    pixels : int
        Those of each lens.
    row : (panel columns,) uint32
    """
    lanes = min(LANES, len(columns))
    blocked = lanes - lanes % BLOCK
    whole = pixels - pixels % BLOCK
    # A last block that covers some pixels again is cheaper than three or more one by one.
    again = pixels >= BLOCK and pixels - whole > 2
    for n in range(0, blocked, BLOCK):
        lens = np.uintp(start + n)
        for u in range(0, whole, BLOCK):
            transpose(strip, np.uintp(u * LANES + n), row, np.uintp(u), columns, lens)
        if again:
            u = pixels - BLOCK
            transpose(strip, np.uintp(u * LANES + n), row, np.uintp(u), columns, lens)
    for n in range(lanes):
        word_count = 0 if n >= blocked else pixels if again else whole
        for u in range(word_count, pixels):
            row[columns[start + n] + u] = strip[u * LANES + n]


def fits_tables(display: Display, shape: PictureShape, pixel_mm: float, layers: int = 1) -> bool:
    """True if pictures in phases, with their margins, fit into the memory limit.

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


@dataclass(frozen=True)
class DirectionLists:
    """Templates of one display and picture size; direction (v, u) has the index ``v * pixels + u``.

    Attributes
    ----------
    pixels : int
        Pixels per elemental image along one axis.
    per_pitch : int
        Picture cells per lens pitch.
    first : (pixels^2 + 1,) int32
        Start of each direction's entries.
    row, column : (n,) int32
        Cells of the lens with index (0, 0); lens (m, n) adds ``per_pitch * (m, n)``. Nearest first.
    exit_mm : (n,) float32
        Depths at which the ray leaves them, rounded up: a float32 depth reaches the exact exit
        if and only if it reaches this.
    entry_mm : (n,) float32
        Depths at which it enters them, rounded down: a float32 depth is at or below the exact entry
        if and only if it is at or below this value. inf for the first cells.
    """

    pixels: int
    per_pitch: int
    first: np.ndarray
    row: np.ndarray
    column: np.ndarray
    exit_mm: np.ndarray
    entry_mm: np.ndarray


def cells_per_pitch(display: Display, pixel_mm: float) -> int | None:
    """Picture pixels per lens pitch if whole and equal on both axes, otherwise None."""
    ratio = exact_length(display.pitch_mm) / exact_length(pixel_mm)
    square = exact_length(display.row_pitch_mm) == exact_length(display.pitch_mm)
    return int(ratio) if ratio.denominator == 1 and square and display.is_separable else None


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
    per_pitch = cells_per_pitch(display, pixel_mm)
    assert per_pitch is not None and shares_directions(display)
    pixels = round(display.pixels_per_lens)
    column_rays, row_rays = cell_rays(shape, pixel_mm, display, pixel_offset)
    longest = sum(rays.most_cells(display.depth_range_mm) for rays in (column_rays, row_rays))
    cells, exits = np.empty((longest, 2), np.int64), np.empty(longest)
    visited, exits_by_direction, first = [], [], [0]
    for v in range(pixels):
        for u in range(pixels):
            count = walk(
                *_ray(column_rays, u), *_ray(row_rays, v), *display.depth_range_mm, cells, exits
            )
            visited.append(cells[:count].copy())
            exits_by_direction.append(exits[:count].copy())
            first.append(first[-1] + count)
    place = np.concatenate(visited).astype(np.int32)
    exit_mm = np.concatenate(exits_by_direction)
    entry = np.roll(exit_mm, 1)
    entry[first[:-1]] = np.inf
    return DirectionLists(
        pixels,
        per_pitch,
        np.array(first, np.int32),
        np.ascontiguousarray(place[:, 0]),
        np.ascontiguousarray(place[:, 1]),
        rounded_up(exit_mm),
        -rounded_up(-entry),
    )


def _ray(rays: CellRays, index: int) -> tuple[float, float, float]:
    return float(rays.start[index]), float(rays.slope[index]), rays.scale
