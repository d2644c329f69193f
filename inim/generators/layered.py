"""`layered`: the exact first hit in a picture that knows what lies behind its front surface.

Definition. As `inim.generators.template`, but a pixel's column is solid only from each layer's
front down to its back (`inim.layered_rgbd`). A ray is in a cell between the depths at which it
enters and leaves it; the first cell, and in it the nearest layer, whose solid reaches into that
span is what the pixel shows: ``front >= exit`` and ``back <= entry``. The last cell ends at z_min.

A picture without layers is solid all the way back, and shows what `template` shows.
"""

from __future__ import annotations

from fractions import Fraction

import numba
import numpy as np

from inim.display import Display
from inim.errors import UsageError
from inim.generators.base import PictureShape, SourceGenerator, check_out
from inim.generators.cells import Aside, cell_rays, free_cell_rays
from inim.generators.direction_lists import build_lists, cells_per_pitch, shares_directions
from inim.generators.lanes import (
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
)
from inim.generators.polyphase import Phases, write_strip
from inim.generators.sources import HOLE, Sources
from inim.generators.subpixels import by_subpixel
from inim.generators.supersampling import Supersampled, sampled_places
from inim.generators.traversal import entered, leaves
from inim.layered_rgbd import Layer, LayeredRGBD
from inim.panel import SubPixel
from inim.pixel_rays import pixel_rays, row_blocks
from inim.rgbd import RGBD

__all__ = ["prepare"]

_LANES = np.uintp(LANES)


def prepare(
    display: Display, shape: PictureShape, pixel_mm: float, *, samples: int | str = 4
) -> SourceGenerator:
    """A generator of exact first hits in layers.

    Parameters
    ----------
    display, shape, pixel_mm :
        See `inim.generators.prepare`.
    samples : {1, 2, 4}
        As for `template`.

    Raises
    ------
    UsageError
        Another number of samples.
    """
    if str(samples) not in ("1", "2", "4"):
        raise UsageError(f"layered: samples = {samples!r}; use 1, 2 or 4")

    def first_hits_through(aside: Aside) -> SourceGenerator:
        if not display.is_separable:
            return _FreeRays(display, shape, pixel_mm, aside)
        if cells_per_pitch(display, pixel_mm) and shares_directions(display):
            return _Shared(display, shape, pixel_mm, aside)
        return _RayByRay(display, shape, pixel_mm, aside)

    def seen_from(subpixel: SubPixel) -> SourceGenerator:
        if int(samples) == 1:
            return first_hits_through((Fraction(0), subpixel.right))
        places = sampled_places(int(samples), subpixel, display.pixel_fill)
        return Supersampled(first_hits_through, places)

    return by_subpixel(display.subpixels, seen_from)


def _layers(rgbd: RGBD) -> tuple[Layer, ...]:
    """A picture's layers; without any, its front surface, solid all the way back."""
    if isinstance(rgbd, LayeredRGBD):
        return rgbd.layers
    back = np.full(rgbd.shape, -np.inf, np.float32)
    return (Layer(rgbd.color, rgbd.depth_mm, back, rgbd.covered),)


def _stacked(rgbd: RGBD) -> tuple[np.ndarray, np.ndarray]:
    """Fronts and backs, (layers, H, W) float32; fronts are -inf where there is no layer."""
    layers = _layers(rgbd)
    fronts = [np.where(layer.covered, layer.front_mm, np.float32(-np.inf)) for layer in layers]
    return np.stack(fronts), np.stack([layer.back_mm for layer in layers])


class _Shared(SourceGenerator):
    """One template per direction for all lenses, over the phases of every layer."""

    def __init__(
        self, display: Display, shape: PictureShape, pixel_mm: float, aside: Aside
    ) -> None:
        super().__init__(display, shape, pixel_mm)
        self._lists = build_lists(display, shape, pixel_mm, aside)
        self._phases = Phases.make(
            self._lists.per_pitch,
            self._lists.row,
            self._lists.column,
            (display.lens_rows, display.lens_columns),
        )
        self._offset = self._phases.row_offset(self._lists.row) + self._phases.column_offset(
            self._lists.column
        )
        # Offsets run along rows of slots of one phase: which of them each entry lies in.
        self._phase_row = self._offset // self._phases.depth.shape[3]
        entry = np.roll(self._lists.exit_mm, 1)
        entry[self._lists.first[:-1]] = np.inf
        self._entry = entry
        self._fronts = self._backs = np.empty((0, 0), np.float32)
        self._words = np.empty((0, 0), np.uint32)
        self._nearest = np.empty((0, 0, 0), np.float32)

    def _make_room(self, layers: int) -> None:
        """Buffers for as many layers as the picture has; kept for the next one."""
        if len(self._fronts) == layers:
            return
        cells = self._phases.depth.size
        self._fronts = np.full((layers, cells), -np.inf, np.float32)
        self._backs = np.full((layers, cells), -np.inf, np.float32)
        self._words = np.zeros((layers, cells), np.uint32)
        down, k, _, _ = self._phases.depth.shape
        strips = self._phases.nearest.shape[1]
        self._nearest = np.empty((layers, down * k * k, strips), np.float32)

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        cells = self.shape[0] * self.shape[1]
        own = np.arange(cells, dtype=np.uint32).reshape(self.shape)
        words = [own + np.uint32(n * cells) for n in range(len(_layers(rgbd)))]
        found = np.empty(self.display.eia_shape, np.int32)
        self._show(rgbd, words, HOLE % 2**32, found.view(np.uint32))
        return found

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`; RGBA goes to the panel without a source map between."""
        if rgbd.color.dtype != np.uint8:
            return super().generate(rgbd, out)
        self.check(rgbd)
        out = check_out(out, rgbd, self.display)
        words = [
            np.ascontiguousarray(layer.color).view(np.uint32)[..., 0] for layer in _layers(rgbd)
        ]
        self._show(rgbd, words, 0, out.view(np.uint32)[..., 0])
        return out

    def _show(self, rgbd: RGBD, words: list[np.ndarray], empty: int, out: np.ndarray) -> None:
        """Show each panel pixel the word of its first hit, all uint32."""
        layers = _layers(rgbd)
        self._make_room(len(layers))
        shape = self._phases.depth.shape
        for number, layer in enumerate(layers):
            self._fronts[number] = -np.inf
            self._nearest[number] = -np.inf
            _place(
                layer.front_mm, layer.back_mm, layer.covered, words[number], *self._phases.origin,
                self._phases.window[1], self._fronts[number].reshape(shape),
                self._backs[number].reshape(shape), self._words[number].reshape(shape),
                self._nearest[number],
            )  # fmt: skip
        lenses, pixels = self.display.lens_columns, self._lists.pixels
        _run(
            self._fronts, self._backs, self._words, self._phases.depth[0].size,
            shape[1] * shape[2], self._nearest,
            self._lists.first, self._offset, self._phase_row, self._lists.exit_mm, self._entry,
            np.arange(lenses) * pixels, np.full(lenses, pixels), np.uint32(empty), out,
        )  # fmt: skip


@numba.njit(cache=True, nogil=True)
def _place(  # type: ignore[no-untyped-def]
    front, back, covered, words, row0, column0, reach, fronts, backs, payload, nearest
):
    """Copy what a layer covers into its phases; note the nearest of each row of slots and strip.

    Deep layers cover little, and cost as little.
    """
    rows, columns = front.shape
    down, k, _, across = fronts.shape
    for r in range(rows):
        i, p = divmod(r - row0, k)
        if i < 0 or i >= down:
            continue
        for c in range(columns):
            if covered[r, c]:
                j, q = divmod(c - column0, k)
                if 0 <= j < across:
                    z = front[r, c]
                    fronts[i, p, q, j], backs[i, p, q, j] = z, back[r, c]
                    payload[i, p, q, j] = words[r, c]
                    row = (i * k + p) * k + q
                    for s in range(nearest.shape[1]):
                        start = min(s * LANES, across - LANES - reach + 1)
                        if start <= j < start + LANES + reach - 1 and z > nearest[row, s]:
                            nearest[row, s] = z


@numba.njit(parallel=True, cache=True, nogil=True)
def _run(  # type: ignore[no-untyped-def]
    fronts, backs, payload, row_stride, row_phases, nearest, first, offset, phase_row, exits,
    entries, columns, widths, empty, out,
):  # fmt: skip
    """All lens rows, shared among the threads."""
    pixels = widths[0]
    for m in numba.prange(out.shape[0] // pixels):
        strip = np.empty(pixels * LANES, np.uint32)
        _run_row(
            np.int64(m), fronts, backs, payload, row_stride, row_phases, nearest, first, offset,
            phase_row, exits, entries, columns, widths, empty, strip, out,
        )  # fmt: skip


@numba.njit(cache=True, nogil=True)
def _run_row(  # type: ignore[no-untyped-def]
    m, fronts, backs, payload, row_stride, row_phases, nearest, first, offset, phase_row, exits,
    entries, columns, widths, empty, strip, out,
):  # fmt: skip
    """One row of lenses, a panel row and a strip at a time; see `inim.generators.polyphase`."""
    pixels, lenses, layers = widths[0], len(widths), len(fronts)
    for v in range(pixels):
        for s in range(nearest.shape[2]):
            start = max(min(s * LANES, lenses - LANES), 0)
            base, first_row = m * row_stride + start, m * row_phases
            for u in range(pixels):
                direction = v * pixels + u
                searching, shown = all_lanes(), same(empty)
                for k in range(np.uintp(first[direction]), np.uintp(first[direction + 1])):
                    row = first_row + phase_row[k]
                    # Layers begin ever farther back: where one is out of reach, so are all.
                    if nearest[0, row, s] < exits[k]:
                        continue
                    cell = np.uintp(base + offset[k])
                    left, came = same(exits[k]), same(entries[k])
                    for layer in range(layers):
                        if nearest[layer, row, s] < exits[k]:
                            break
                        reaches = at_least(load(fronts[layer], cell), left)
                        solid = at_least(came, load(backs[layer], cell))
                        hit = both(searching, both(reaches, solid))
                        shown = choose(hit, load(payload[layer], cell), shown)
                        searching = but_not(searching, hit)
                    if not any_lane(searching):
                        break
                store(strip, np.uintp(u) * _LANES, shown)
            write_strip(strip, columns, widths, start, pixels, out[m * pixels + v])


class _RayByRay(SourceGenerator):
    """Every ray by itself, where rows and columns are separable."""

    def __init__(
        self, display: Display, shape: PictureShape, pixel_mm: float, aside: Aside
    ) -> None:
        super().__init__(display, shape, pixel_mm)
        columns, rows = cell_rays(shape, pixel_mm, display, aside)
        self._columns = (columns.start, columns.slope, columns.scale)
        self._rows = (rows.start, rows.slope, rows.scale)

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        found = np.empty(self.display.eia_shape, np.int32)
        fronts, backs = _stacked(rgbd)
        z_min, z_max = self.display.depth_range_mm
        _first_hits(fronts, backs, *self._columns, *self._rows, z_min, z_max, found)
        return found


class _FreeRays(SourceGenerator):
    """Every ray by itself, where no two share a coordinate."""

    def __init__(
        self, display: Display, shape: PictureShape, pixel_mm: float, aside: Aside
    ) -> None:
        super().__init__(display, shape, pixel_mm)
        self._aside = float(aside[0]), float(aside[1])

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        found = np.empty(self.display.eia_shape, np.int32)
        fronts, backs = _stacked(rgbd)
        for rows in row_blocks(self.display):
            rays = pixel_rays(self.display, rows, self._aside)
            cells = free_cell_rays(self.shape, self.pixel_mm, rays)
            _free_first_hits(fronts, backs, *cells, *self.display.depth_range_mm, found[rows])
        return found


@numba.njit(parallel=True, cache=True, nogil=True)
def _first_hits(fronts, backs, u0, du, u1, v0, dv, v1, z_min, z_max, found):  # type: ignore[no-untyped-def]
    """First hit of every panel pixel; rays of `cell_rays`, one u per column and one v per row."""
    for i in numba.prange(found.shape[0]):
        for j in range(found.shape[1]):
            found[i, j] = _first_hit(
                fronts, backs, u0[j], du[j], u1, v0[i], dv[i], v1, z_min, z_max
            )


@numba.njit(parallel=True, cache=True, nogil=True)
def _free_first_hits(fronts, backs, u0, du, v0, dv, z_min, z_max, found):  # type: ignore[no-untyped-def]
    """First hit of every panel pixel; rays of `free_cell_rays`."""
    for i in numba.prange(found.shape[0]):
        for j in range(found.shape[1]):
            found[i, j] = _first_hit(
                fronts, backs, u0[i, j], du[i, j], 1.0, v0[i, j], dv[i, j], 1.0, z_min, z_max
            )


@numba.njit(cache=True, nogil=True)
def _first_hit(fronts, backs, u0, du, u1, v0, dv, v1, z_min, z_max):  # type: ignore[no-untyped-def]
    """Walk one ray as `inim.generators.traversal.first_hit` does, asking every layer's solid."""
    layers, rows, columns = fronts.shape
    step_u = -1 if du > 0 else 1
    step_v = -1 if dv > 0 else 1
    u, v = entered(u0, du, u1, z_max), entered(v0, dv, v1, z_max)
    z_u, z_v = leaves(u, u0, du, u1), leaves(v, v0, dv, v1)
    z_entry = np.inf
    while True:
        z_exit = max(z_u, z_v, z_min)
        if 0 <= u < columns and 0 <= v < rows:
            for layer in range(layers):
                front = fronts[layer, v, u]
                if front < z_exit:
                    break
                if backs[layer, v, u] <= z_entry:
                    return (layer * rows + v) * columns + u
        if z_exit <= z_min:
            return HOLE
        z_entry = z_exit
        if z_u >= z_exit:
            u += step_u
            z_u = leaves(u, u0, du, u1)
        if z_v >= z_exit:
            v += step_v
            z_v = leaves(v, v0, dv, v1)
