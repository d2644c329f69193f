"""First hits in solids: cells whose layers begin at a front and end at a back.

A ray is in a cell between the depths at which it enters and leaves it; the first cell, and in it
the nearest layer, whose solid reaches into that span is hit: ``front >= exit`` and
``back <= entry``. The last cell ends at z_min.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np

from inim.display import Display
from inim.generators.base import (
    HOLE,
    PictureShape,
    PixelList,
    SourceGenerator,
    Sources,
    for_mask,
)
from inim.generators.raycast.cells import Aside, cell_rays
from inim.generators.raycast.direction_lists import build_lists, shares_directions
from inim.generators.raycast.polyphase import (
    Phases,
    fits_tables,
    index_payload,
    nearest_surface,
    write_strip,
)
from inim.generators.raycast.ray_by_ray import NonSeparable, entered, leaves, ray_blocks
from inim.generators.raycast.simd import (
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
from inim.generators.raycast.supersampling import averaged
from inim.rgbd import RGBD, Layer

__all__ = ["NonSeparableSolids", "SharedSolids", "SolidsRayByRay", "first_hits_in_solids"]

_LANES = np.uintp(LANES)


def first_hits_in_solids(
    display: Display,
    shape: PictureShape,
    pixel_mm: float,
    samples: int,
    mask: np.ndarray | None,
    *,
    layers: int,
) -> SourceGenerator:
    """The generator of first hits in solids, by the fastest way that a display allows.

    Parameters
    ----------
    display, shape, pixel_mm, mask :
        See `inim.generators.prepare`.
    samples : {1, 2, 4}
    layers : int
        Of usual pictures: what tables are made for is not known before a picture comes.
    """
    tables = fits_tables(display, shape, pixel_mm, layers) and shares_directions(display)

    def first_hits(pixels: PixelList | None) -> SourceGenerator:
        def through(aside: Aside) -> SourceGenerator:
            if not display.is_separable:
                return NonSeparableSolids(display, shape, pixel_mm, aside, pixels)
            if pixels is not None or not tables:
                return SolidsRayByRay(display, shape, pixel_mm, aside, pixels)
            return SharedSolids(display, shape, pixel_mm, aside)

        return averaged(display, samples, through)

    return for_mask(mask, display, first_hits, dense_in_full=tables)


def _stacked(rgbd: RGBD) -> tuple[np.ndarray, np.ndarray]:
    """Fronts and backs, (layers, H, W) float32; fronts are -inf where there is no layer."""
    layers = rgbd.layers
    fronts = [np.where(layer.covered, layer.front_mm, np.float32(-np.inf)) for layer in layers]
    return np.stack(fronts), np.stack([layer.back_mm for layer in layers])


class SharedSolids(SourceGenerator):
    """One template per direction for all lenses, over the phases of every layer.

    The front surface is laid out as `template` does; what lies deeper is little, and only its cells
    are written, and looked at by rays that passed behind what is before them.
    """

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
        self._offset = self._phases.offset(self._lists.row, self._lists.column)
        by_pixel_row = self._lists.first[: -1 : self._lists.pixels]
        self._reach = self._phases.row_reach(self._lists.row, by_pixel_row)
        self._slots = self._phases.slots(shape)
        self._back = np.zeros(self._phases.depth.size, np.float32)
        # Offsets run along rows of slots of one phase: which of them each entry lies in.
        self._phase_row = self._offset // self._phases.depth.shape[3]
        self._deeper = _Deeper.none(self._phases)

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        own = index_payload(self.shape)
        words = [own + np.uint32(n * own.size) for n in range(len(rgbd.layers))]
        found = np.empty(self.display.eia_shape, np.int32)
        self._show(rgbd, words, HOLE % 2**32, found.view(np.uint32))
        return found

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`; RGBA goes to the panel without a source map between."""
        if rgbd.color.dtype != np.uint8:
            return super().generate(rgbd, out)
        self.check(rgbd)
        out = self.place(rgbd, out)
        words = [np.ascontiguousarray(layer.color).view(np.uint32)[..., 0] for layer in rgbd.layers]
        self._show(rgbd, words, 0, out.view(np.uint32)[..., 0])
        return out

    def _show(self, rgbd: RGBD, words: list[np.ndarray], empty: int, out: np.ndarray) -> None:
        """Show each panel pixel the word of its first hit, all uint32."""
        front, *deeper = rgbd.layers
        self._phases.fill(front.front_mm, front.covered, words[0])
        _put(front.covered.reshape(-1), front.back_mm.reshape(-1), self._slots, self._back)
        if len(deeper) != len(self._deeper.held):
            self._deeper = _Deeper.none(self._phases, len(deeper))
        self._deeper.hold(deeper, words[1:], self._slots)
        lenses, pixels = self.display.lens_columns, self._lists.pixels
        phases, held, lists = self._phases, self._deeper, self._lists
        _, down, across, _ = phases.depth.shape
        _run(
            phases.depth.reshape(-1), self._back, phases.payload.reshape(-1),
            held.front, held.back, held.payload,
            phases.depth[0].size, down * across, phases.nearest, held.nearest,
            lists.first, self._offset, self._phase_row, self._reach, lists.exit_mm, lists.entry_mm,
            np.arange(lenses) * pixels, np.full(lenses, pixels), np.uint32(empty), out,
        )  # fmt: skip


@dataclass(frozen=True)
class _Deeper:
    """Phases of all layers but the first, (layers, slots); taken over from picture to picture.

    Attributes
    ----------
    front, back : float32
        -inf where there is no layer; anything.
    payload : uint32
    nearest : (rows of slots, strips) float32
        Greatest depth of what a strip of lenses can reach of them.
    held : list of int32 array
        The slots of each layer that hold something.
    reach : int
        Slots across that the rays of one lens can reach.
    """

    front: np.ndarray
    back: np.ndarray
    payload: np.ndarray
    nearest: np.ndarray
    held: list[np.ndarray]
    reach: int

    @classmethod
    def none(cls, phases: Phases, layers: int = 0) -> _Deeper:
        """No layers, or empty ones."""
        size = phases.depth.size
        rows = size // phases.depth.shape[3]
        return cls(
            np.full((layers, size), -np.inf, np.float32),
            np.zeros((layers, size), np.float32),
            np.zeros((layers, size), np.uint32),
            np.full((rows, phases.nearest.shape[1]), -np.inf, np.float32),
            [np.empty(0, np.int32)] * layers,
            phases.window[1],
        )

    def hold(self, layers: Sequence[Layer], words: Sequence[np.ndarray], slots: np.ndarray) -> None:
        """Hold other layers, as many; only cells that hold something, or did, are touched."""
        self.nearest[:] = -np.inf
        for number, (layer, word) in enumerate(zip(layers, words, strict=True)):
            self.front[number][self.held[number]] = -np.inf
            cells = np.flatnonzero(layer.covered)
            own = slots[cells]
            reached = own >= 0
            cells, own = cells[reached], own[reached]
            _put_cells(
                cells, own, layer.front_mm.reshape(-1), layer.back_mm.reshape(-1),
                word.reshape(-1), self.front[number], self.back[number], self.payload[number],
            )  # fmt: skip
            if number == 0:
                _bound(own, self.front[0], self.reach, self.nearest)
            self.held[number] = own


@numba.njit(cache=True, nogil=True)
def _put_cells(cells, own, front, back, words, fronts, backs, payload):  # type: ignore[no-untyped-def]
    """Write some cells of a layer into their own slots."""
    for i in range(len(cells)):
        cell, slot = np.uintp(cells[i]), np.uintp(own[i])
        fronts[slot], backs[slot], payload[slot] = front[cell], back[cell], words[cell]


@numba.njit(cache=True, nogil=True)
def _bound(own, fronts, reach, nearest):  # type: ignore[no-untyped-def]
    """Note the greatest depth of some slots that each strip can reach, by rows of slots."""
    across = len(fronts) // len(nearest)
    for slot in own:
        row, j = divmod(np.uint32(slot), np.uint32(across))
        for s in range(nearest.shape[1]):
            start = min(s * LANES, across - LANES - reach + 1)
            if start <= j < start + LANES + reach - 1:
                nearest[row, s] = max(nearest[row, s], fronts[slot])


@numba.njit(parallel=True, cache=True, nogil=True)
def _put(covered, values, slots, out):  # type: ignore[no-untyped-def]
    """Write what is covered into its slots."""
    for i in numba.prange(len(slots)):
        if covered[i] and slots[i] >= 0:
            out[np.uintp(slots[i])] = values[i]


@numba.njit(parallel=True, cache=True, nogil=True)
def _run(  # type: ignore[no-untyped-def]
    front, back, payload, deeper_front, deeper_back, deeper_payload, row_stride, row_phases,
    nearest, deeper_nearest, first, offset, phase_row, reach, exits, entries, columns, widths,
    empty, out,
):  # fmt: skip
    """All lens rows, shared among the threads."""
    pixels = widths[0]
    for m in numba.prange(out.shape[0] // pixels):
        strip = np.empty(pixels * LANES, np.uint32)
        _run_row(
            np.int64(m), front, back, payload, deeper_front, deeper_back, deeper_payload,
            row_stride, row_phases, nearest, deeper_nearest, first, offset, phase_row, reach, exits,
            entries, columns, widths, empty, strip, out,
        )  # fmt: skip


@numba.njit(cache=True, nogil=True)
def _run_row(  # type: ignore[no-untyped-def]
    m, front, back, payload, deeper_front, deeper_back, deeper_payload, row_stride, row_phases,
    nearest, deeper_nearest, first, offset, phase_row, reach, exits, entries, columns, widths,
    empty, strip, out,
):  # fmt: skip
    """One row of lenses, a panel row and a strip at a time; see `raycast.polyphase`."""
    pixels, lenses, layers = widths[0], len(widths), len(deeper_front)
    for v in range(pixels):
        for s in range(nearest.shape[1]):
            start = max(min(s * LANES, lenses - LANES), 0)
            base, first_row = m * row_stride + start, m * row_phases
            most = nearest_surface(nearest, m + reach[v, 0], m + reach[v, 1], s)
            for u in range(pixels):
                direction = v * pixels + u
                k, end = np.uintp(first[direction]), np.uintp(first[direction + 1])
                while k < end and exits[k] > most:
                    k += np.uintp(1)
                searching, shown = all_lanes(), same(empty)
                while k < end:
                    cell = np.uintp(base + offset[k])
                    left = same(exits[k])
                    below = both(searching, at_least(load(front, cell), left))
                    if any_lane(below):
                        came = same(entries[k])
                        hit = both(below, at_least(came, load(back, cell)))
                        if any_lane(hit):
                            shown = choose(hit, load(payload, cell), shown)
                            searching = but_not(searching, hit)
                            if not any_lane(searching):
                                break
                        # Layers begin ever farther back: rays above one are above those behind.
                        if layers > 0 and deeper_nearest[first_row + phase_row[k], s] >= exits[k]:
                            below = but_not(below, hit)
                            layer = 0
                            while layer < layers and any_lane(below):
                                below = both(below, at_least(load(deeper_front[layer], cell), left))
                                hit = both(below, at_least(came, load(deeper_back[layer], cell)))
                                shown = choose(hit, load(deeper_payload[layer], cell), shown)
                                searching = but_not(searching, hit)
                                below = but_not(below, hit)
                                layer += 1
                            if not any_lane(searching):
                                break
                    k += np.uintp(1)
                store(strip, np.uintp(u) * _LANES, shown)
            write_strip(strip, columns, widths, start, pixels, out[m * pixels + v])


class SolidsRayByRay(SourceGenerator):
    """Every ray, or those of a list, by itself, where rows and columns are separable."""

    def __init__(
        self,
        display: Display,
        shape: PictureShape,
        pixel_mm: float,
        aside: Aside,
        pixels: PixelList | None = None,
    ) -> None:
        super().__init__(display, shape, pixel_mm, pixels)
        columns, rows = cell_rays(shape, pixel_mm, display, aside)
        self._columns = (columns.start, columns.slope, columns.scale)
        self._rows = (rows.start, rows.slope, rows.scale)

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        found = np.empty(self.made_shape, np.int32)
        fronts, backs = _stacked(rgbd)
        rays = (*self._columns, *self._rows, *self.display.depth_range_mm)
        if self.pixels is None:
            _first_hits(fronts, backs, *rays, found)
        else:
            at = (self.pixels.rows, self.pixels.columns)
            _first_hits_at(fronts, backs, *rays, *at, found[0])
        return found


class NonSeparableSolids(NonSeparable):
    """Every ray, or those of a list, by itself, where no two share a coordinate."""

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        found = np.empty(self.made_shape, np.int32)
        fronts, backs = _stacked(rgbd)
        for _, cells, at in ray_blocks(self, self._aside):
            _free_first_hits(fronts, backs, *cells, *self.display.depth_range_mm, found[at])
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
def _first_hits_at(  # type: ignore[no-untyped-def]
    fronts, backs, u0, du, u1, v0, dv, v1, z_min, z_max, rows, columns, found
):
    """As `_first_hits`, of the panel pixels in some rows and columns, (n,) each."""
    for n in numba.prange(len(rows)):
        i, j = rows[n], columns[n]
        found[n] = _first_hit(fronts, backs, u0[j], du[j], u1, v0[i], dv[i], v1, z_min, z_max)


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
    """Walk one ray as `raycast.ray_by_ray.first_hit` does, through every layer's solids."""
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
