"""Pictures in the memory layout of local depth templates.

If the picture has a whole number of pixels per lens pitch, the rays of neighbouring lenses meet the
same cells, shifted by whole lenses. The picture is copied into *phases*: cells at the same place of
every lens pitch are adjacent, so the values that a ray of each of a row of lenses reads are
contiguous: a vector of depths, and one of colours.

The deeper layers of a layered depth image are sparse: only their cells are stored.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from inim.backend.kernels import compiled, share_rows
from inim.display import Display
from inim.display.pixels import exact_length
from inim.generators.base import PictureShape
from inim.generators.raycast.cells import cell_rays
from inim.generators.raycast.columns import Columns
from inim.generators.raycast.simd import LANES, choose, less, load, same, store

# Slots for depths and payloads, 8 bytes each, below which nobody asks how many are needed.
_MOST_SLOTS = 2**25
_NO_DEPTH = np.float32(-np.inf)


@dataclass(frozen=True)
class PhaseLayout:
    """Addresses of picture cells in phases, of one display and picture size.

    * `shape`: (slots down, per_pitch, per_pitch, slots across).
    * `origin`, (row, column) of int: picture cell of slot (0, 0), phase (0, 0); negative where
      slots reach beyond the picture.
    * `window`, (slots down, slots across) of int: slots that the rays of one lens can reach.
    """

    shape: tuple[int, int, int, int]
    origin: tuple[int, int]
    window: tuple[int, int]
    strips: int

    @classmethod
    def of(
        cls, per_pitch: int, rows: np.ndarray, columns: np.ndarray, display: Display
    ) -> PhaseLayout:
        """Lay out the phases.

        * `rows`, `columns`: all cells that rays of the lens (0, 0) visit.
        """
        first = [int(cells.min()) // per_pitch for cells in (rows, columns)]
        last = [int(cells.max()) // per_pitch for cells in (rows, columns)]
        window = (last[0] - first[0] + 1, last[1] - first[1] + 1)
        lens_rows, lens_columns = display.layout.grid
        down = lens_rows + window[0] - 1
        across = max(lens_columns, LANES) + window[1] - 1
        return cls(
            (down, per_pitch, per_pitch, across),
            (first[0] * per_pitch, first[1] * per_pitch),
            window,
            -(-lens_columns // LANES),
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

        * `first`, (m,) int array: where each run begins.

        Returns (m, 2) int array.
        """
        slots = (rows - self.origin[0]) // self.shape[1]
        ends = [extreme.reduceat(slots, first) for extreme in (np.minimum, np.maximum)]
        return np.stack(ends, axis=1)

    def spread(self, values: np.ndarray, phases: np.ndarray) -> None:
        """Copy values of a picture (H, W) into phases (slots,); slots beyond it stay."""
        # As whole numbers: the kernel is compiled once for each size.
        words = f"u{values.itemsize}"
        values, phases = np.ascontiguousarray(values).view(words), phases.view(words)
        share_rows(_spread, self.shape[0], values, *self.origin, phases.reshape(self.shape))


@compiled
def _spread(begin, end, values, row0, column0, phases):  # type: ignore[no-untyped-def]
    rows, columns = values.shape
    _, k, _, across = phases.shape
    for i in range(begin, end):
        for p in range(k):
            row = row0 + i * k + p
            if 0 <= row < rows:
                for q in range(k):
                    before, behind = -column0 - q, columns - column0 - q
                    for j in range(max(0, -(-before // k)), min(across, -(-behind // k))):
                        phases[i, p, q, j] = values[row, column0 + j * k + q]


class Phases:
    """A picture by phases, in buffers that are filled again for every picture.

    Its attributes:
    * `depth`, (slots,) float32: depths by phase, -inf at uncovered cells, NaN around the picture.
    * `back`, (slots,) float32: backs of columns, inf at uncovered cells; empty if no column has a
      back.
    * `nearest`, (slots down, strips) float32: greatest depth, in a row of slots, within reach of a
      strip of lenses.
    * `farthest`, (slots down, strips) float32: least depth of a back within the same reach; inf
      without covered cells.
    * `deeper_depth`, `deeper_back`, (layers, slots) float32: all layers except the first; depths of
      -inf, and any back, where no layer exists.
    * `deeper_nearest`, (rows of slots of a phase, strips) float32: greatest depth of the deeper
      layers within reach.
    """

    def __init__(self, layout: PhaseLayout, shape: PictureShape, *, end: bool) -> None:
        self.layout = layout
        size, bounds = math.prod(layout.shape), (layout.shape[0], layout.strips)
        self.depth = np.full(size, np.nan, np.float32)
        self.back = np.full(size if end else 0, np.inf, np.float32)
        self.nearest, self.farthest = np.empty(bounds, np.float32), np.empty(bounds, np.float32)
        self._shape, self._slots = shape, np.empty(0, np.int32)
        self._occupied: list[tuple[np.ndarray, np.ndarray]] = []
        self._set_layers(0)

    def _set_layers(self, layers: int) -> None:
        size, across = len(self.depth), self.layout.shape[3]
        self.deeper_depth = np.full((layers, size), -np.inf, np.float32)
        self.deeper_back = np.zeros((layers, size), np.float32)
        self.deeper_nearest = np.full((size // across, self.layout.strips), -np.inf, np.float32)
        no_cells = np.empty(0, np.int32)
        self._occupied = [(no_cells, no_cells)] * layers
        if layers and not self._slots.size:
            self._slots = self.layout.slots(self._shape)

    def fill(self, columns: Columns) -> None:
        """Take in the columns of a picture."""
        layout, first, deeper = self.layout, columns.layers[0], columns.layers[1:]
        layout.spread(np.where(first.covered, first.front_mm, _NO_DEPTH), self.depth)
        if self.back.size:
            layout.spread(first.back_mm, self.back)
        share_rows(
            _find_bounds, layout.shape[0], self.depth, self.back, *layout.shape[1:],
            layout.window[1], self.nearest, self.farthest,
        )  # fmt: skip
        if len(deeper) != len(self.deeper_depth):
            self._set_layers(len(deeper))
        for number, layer in enumerate(deeper):
            self.deeper_depth[number][self._occupied[number][1]] = -np.inf
            cells = np.flatnonzero(layer.covered)
            cells = cells[self._slots[cells] >= 0]
            slots = self._slots[cells]
            self.deeper_depth[number][slots] = layer.front_mm.reshape(-1)[cells]
            self.deeper_back[number][slots] = layer.back_mm.reshape(-1)[cells]
            self._occupied[number] = cells, slots
        if deeper:
            self._bound_deeper()

    def _bound_deeper(self) -> None:
        """Find the greatest depths of the second layer, which begins before those behind it."""
        self.deeper_nearest[:] = -np.inf
        _, slots = self._occupied[0]
        rows, across = np.divmod(slots, self.layout.shape[3])
        depth, reach = self.deeper_depth[0][slots], LANES + self.layout.window[1] - 1
        for strip in range(self.layout.strips):
            start = min(strip * LANES, self.layout.shape[3] - reach)
            within = (start <= across) & (across < start + reach)
            np.maximum.at(self.deeper_nearest[:, strip], rows[within], depth[within])

    def deeper_payloads(self, payloads: Sequence[np.ndarray], dtype: np.dtype) -> np.ndarray:
        """Phases of payloads (H, W) of the deeper layers, (layers, slots)."""
        deeper = np.zeros(self.deeper_depth.shape, dtype)
        for of_layer, payload, (cells, slots) in zip(deeper, payloads, self._occupied, strict=True):
            of_layer[slots] = payload.reshape(-1)[cells]
        return deeper


@compiled
def _find_bounds(begin, end, depth, back, down, wide, across, reach, nearest, farthest):  # type: ignore[no-untyped-def]
    """Find the nearest surface, and the farthest end, within reach of each strip."""
    phases, lenses = down * wide, LANES + reach - 1
    peaks, feet = np.empty(LANES, np.float32), np.empty(LANES, np.float32)
    for i in range(begin, end):
        for s in range(nearest.shape[1]):
            start = min(s * LANES, across - lenses)
            most, least = same(np.float32(-np.inf)), same(np.float32(np.inf))
            for phase in range(i * phases, (i + 1) * phases):
                for block in range(0, lenses, LANES):
                    slot = np.uintp(phase * across + start + min(block, lenses - LANES))
                    z = load(depth, slot)
                    most = choose(less(most, z), z, most)
                    if back.size:
                        z = load(back, slot)
                        least = choose(less(z, least), z, least)
            store(peaks, np.uintp(0), most)
            store(feet, np.uintp(0), least)
            for n in range(1, LANES):
                peaks[0], feet[0] = max(peaks[0], peaks[n]), min(feet[0], feet[n])
            nearest[i, s], farthest[i, s] = peaks[0], feet[0]


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
    lens_rows, lens_columns = display.layout.grid
    cells = (lens_rows + rows) * (max(lens_columns, LANES) + columns) * per_pitch**2 * layers
    panel = display.eia_shape[0] * display.eia_shape[1]
    return cells <= max(_MOST_SLOTS, 4 * (panel + shape[0] * shape[1]))


def cells_per_pitch(display: Display, pixel_mm: float) -> int | None:
    """Picture pixels per lens pitch if whole and equal on both axes, otherwise None."""
    ratio = exact_length(display.pitch_mm) / exact_length(pixel_mm)
    square = exact_length(display.row_pitch_mm) == exact_length(display.pitch_mm)
    return int(ratio) if ratio.denominator == 1 and square and display.is_separable else None
