"""Pictures in the memory layout of local depth templates.

If the picture has a whole number of pixels per lens pitch, the rays of neighbouring lenses meet the
same cells, shifted by whole lenses. The picture is copied into *phases*: cells at the same place of
every lens pitch are adjacent, so the values that a ray of each of a row of lenses reads are
contiguous: a vector of depths.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from inim.display import Display
from inim.generators.base import PictureShape
from inim.generators.raycast.cells import cell_rays
from inim.generators.raycast.columns import Columns, visible_depth
from inim.generators.raycast.simd import LANES, choose, less, load, same, store
from inim.system.backend.kernels import compiled, share_rows

# Slots for depths and backs, 8 bytes each, below which nobody asks how many are needed.
_MOST_SLOTS = 2**25


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
        values, phases = np.ascontiguousarray(values), phases.reshape(self.shape)
        share_rows(_spread, self.shape[0], values, *self.origin, phases)


@compiled
def _spread(begin, end, values, row0, column0, phases):  # type: ignore[no-untyped-def]
    rows, columns = values.shape
    _, k, _, across = phases.shape
    for i in range(begin, end):
        for p in range(k):
            row = row0 + i * k + p
            if 0 <= row < rows:
                line = values[row]
                for q in range(k):
                    before, behind = -column0 - q, columns - column0 - q
                    first, end = max(0, -(-before // k)), min(across, -(-behind // k))
                    phase, column = phases[i, p, q], np.uintp(column0 + first * k + q)
                    for j in range(first, end):
                        phase[np.uintp(j)] = line[column]
                        column += np.uintp(k)


class Phases:
    """A picture by phases, in buffers that are filled again for every picture.

    Its attributes:
    * `depth`, (layers, slots) float32: depths by phase, -inf at uncovered cells, NaN around the
      picture.
    * `back`, (layers, slots) float32: backs of columns; (layers, 0) if no column has a back.
    * `nearest`, (slots down, strips) float32: greatest depth, in a row of slots, within reach of a
      strip of lenses.
    * `farthest`, (slots down, strips) float32: least back in the first layer within the same reach;
      inf without covered cells.
    """

    def __init__(self, layout: PhaseLayout) -> None:
        self.layout, bounds = layout, (layout.shape[0], layout.strips)
        self.depth = self.back = np.empty((0, 0), np.float32)
        self.nearest, self.farthest = np.empty(bounds, np.float32), np.empty(bounds, np.float32)

    def fill(self, columns: Columns) -> None:
        """Take in the columns of a picture."""
        layout, layers, size = self.layout, len(columns.layers), math.prod(self.layout.shape)
        if layers != len(self.depth):
            self.depth = np.full((layers, size), np.nan, np.float32)
            self.back = np.full((layers, size if columns.end else 0), np.inf, np.float32)
        for layer, depth, back in zip(columns.layers, self.depth, self.back, strict=True):
            layout.spread(visible_depth(layer), depth)
            if columns.end:
                layout.spread(layer.back_mm, back)
        share_rows(
            _find_bounds, layout.shape[0], self.depth[0], self.back[0], *layout.shape[1:],
            layout.window[1], self.nearest, self.farthest,
        )  # fmt: skip


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
        2 + axis.most_cells(display.traced_range_mm) // per_pitch
        for axis in cell_rays(shape, pixel_mm, display)
    )
    lens_rows, lens_columns = display.layout.grid
    cells = (lens_rows + rows) * (max(lens_columns, LANES) + columns) * per_pitch**2 * layers
    panel = display.eia_shape[0] * display.eia_shape[1]
    return cells <= max(_MOST_SLOTS, 4 * (panel + shape[0] * shape[1]))


def cells_per_pitch(display: Display, pixel_mm: float) -> int:
    """Picture pixels per lens pitch if whole and equal on both axes, otherwise 0."""
    lengths = display.pitch_mm, display.row_pitch_mm, pixel_mm
    pitch, row_pitch, pixel = map(display.exact_mm, lengths)
    ratio, square = pitch / pixel, pitch == row_pitch
    return int(ratio) if ratio.denominator == 1 and square and display.is_separable else 0
