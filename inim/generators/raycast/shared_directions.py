"""First hits of every panel pixel's ray in a picture's columns, with the fastest method available.

A ray is in a cell between its entry depth and its exit depth. The first cell, and in it
the nearest layer, whose column overlaps this interval is hit: ``front >= exit`` and
``back <= entry``. The last cell ends at z_min.

If one list of cells per direction serves all lenses, the front surface of a picture is stored
in phases (`raycast.polyphase`). The deeper layers of a layered depth image are sparse: only their
cells are stored, and tested by rays that passed behind the previous layers. Solid columns,
behind which no ray passes, have a separate loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from inim.backend.kernels import compiled, prange
from inim.display import Display
from inim.errors import UsageError
from inim.generators.base import PictureShape, PixelOffset, SourceGenerator, masked
from inim.generators.raycast.cells import check_ray_length
from inim.generators.raycast.columns import LAYERS, SOLID, Columns
from inim.generators.raycast.non_integer_pitch import NonIntegerPitch
from inim.generators.raycast.polyphase import (
    DirectionLists,
    Layout,
    PhaseGenerator,
    Phases,
    build_lists,
    farthest_end,
    fits_tables,
    nearest_surface,
    shares_directions,
    write_strip,
)
from inim.generators.raycast.ray_by_ray import NonSeparable, RayByRay
from inim.generators.raycast.simd import (
    LANES,
    all_lanes,
    and_flags,
    any_lane,
    at_least,
    but_not,
    choose,
    either,
    less,
    load,
    no_lanes,
    same,
    store,
)
from inim.generators.raycast.supersampling import averaged
from inim.image.rgbd import Layer

# Of the compiler's own type: a Python integer would make addresses signed, and checked.
_LANES = np.uintp(LANES)


class SharedDirections(PhaseGenerator):
    """One list of cells per direction for all lenses."""

    def _prepare(self) -> None:
        super()._prepare()
        self._tables = _direction_tables(self.display, self.shape, self.pixel_mm, self.pixel_offset)
        layout = self._tables.layout
        self._phases = Phases(layout, end=self._rule != SOLID)
        self._deeper_layers = _DeeperLayers.empty(layout)
        self._slots = layout.slots(self.shape) if self._rule == LAYERS else np.empty(0, np.int32)

    def _take(self, columns: Columns, payloads: Sequence[np.ndarray]) -> None:
        """See `PhaseGenerator._take`."""
        self._fill(columns, payloads[0])
        deeper = columns.layers[1:]
        if len(deeper) != len(self._deeper_layers.occupied):
            self._deeper_layers = _DeeperLayers.empty(self._phases.layout, len(deeper))
        self._deeper_layers.hold(deeper, payloads[1:], self._slots)

    def _run(self, columns: Columns, empty: int, first: int, out: np.ndarray) -> None:
        """See `PhaseGenerator._run`."""
        phases, tables, deeper = self._phases, self._tables, self._deeper_layers
        lists, row_stride = tables.lists, phases.layout.row_stride
        run = _run_layered if deeper.occupied else _run_surface if columns.end else _run_solid
        run(
            first, lists.pixels,
            (
                phases.depth, phases.back, phases.payload, deeper.front, deeper.back,
                deeper.payload, row_stride, row_stride // phases.layout.shape[3], phases.nearest,
                phases.farthest, deeper.nearest,
            ),
            (
                lists.first, tables.offset, tables.phase_row, tables.reach, lists.exit_mm,
                lists.entry_mm,
            ),
            (
                columns.continue_behind, np.arange(self.display.lens_columns) * lists.pixels,
                lists.pixels, np.uint32(empty),
            ),
            out,
        )  # fmt: skip


class _DirectionTables(NamedTuple):
    """Lists of a display and picture size, and their addresses in phases.

    Attributes
    ----------
    lists : DirectionLists
    layout : Layout
    offset : (n,) int64
        Flat distance of the lists' cells from slot (0, 0).
    phase_row : (n,) int64
        Row of slots, of one phase, of each entry.
    reach : (pixels, 2) int64
        See `Layout.row_reach`.
    """

    lists: DirectionLists
    layout: Layout
    offset: np.ndarray
    phase_row: np.ndarray
    reach: np.ndarray


@lru_cache(maxsize=8)
def _direction_tables(
    display: Display, shape: PictureShape, pixel_mm: float, pixel_offset: PixelOffset
) -> _DirectionTables:
    lists = build_lists(display, shape, pixel_mm, pixel_offset)
    layout = Layout.of(lists.per_pitch, lists.row, lists.column, display)
    offset = layout.row_offset(lists.row) + layout.column_offset(lists.column)
    reach = layout.row_reach(lists.row, lists.first[: -1 : lists.pixels])
    return _DirectionTables(lists, layout, offset, offset // layout.shape[3], reach)


@dataclass(frozen=True)
class _DeeperLayers:
    """Phases of all layers except the first, (layers, slots), reused for later pictures.

    Attributes
    ----------
    front, back : float32
        -inf, and any value, where no layer exists.
    payload : uint32
    nearest : (rows of slots, strips) float32
        Greatest depth within reach of a strip of lenses.
    occupied : list of int32 array
        Occupied slots of each layer.
    reach : int
        Slots across that the rays of one lens can reach.
    """

    front: np.ndarray
    back: np.ndarray
    payload: np.ndarray
    nearest: np.ndarray
    occupied: list[np.ndarray]
    reach: int

    @classmethod
    def empty(cls, layout: Layout, layers: int = 0) -> _DeeperLayers:
        """No layers, or empty ones."""
        size = math.prod(layout.shape)
        rows = size // layout.shape[3]
        return cls(
            np.full((layers, size), -np.inf, np.float32),
            np.zeros((layers, size), np.float32),
            np.zeros((layers, size), np.uint32),
            np.full((rows, layout.strips), -np.inf, np.float32),
            [np.empty(0, np.int32)] * layers,
            layout.window[1],
        )

    def hold(self, layers: Sequence[Layer], words: Sequence[np.ndarray], slots: np.ndarray) -> None:
        """Store the same number of other layers; only cells occupied now or before change."""
        self.nearest[:] = -np.inf
        for number, (layer, word) in enumerate(zip(layers, words, strict=True)):
            self.front[number][self.occupied[number]] = -np.inf
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
            self.occupied[number] = own


@compiled
def _put_cells(cells, own, front, back, words, fronts, backs, payload):  # type: ignore[no-untyped-def]
    """Write some cells of a layer into their own slots."""
    for i in range(len(cells)):
        cell, slot = np.uintp(cells[i]), np.uintp(own[i])
        fronts[slot], backs[slot], payload[slot] = front[cell], back[cell], words[cell]


@compiled
def _bound(own, fronts, reach, nearest):  # type: ignore[no-untyped-def]
    """Note the greatest depth of some slots that each strip can reach, by rows of slots."""
    across = len(fronts) // len(nearest)
    for slot in own:
        row, j = divmod(np.uint32(slot), np.uint32(across))
        for s in range(nearest.shape[1]):
            start = min(s * LANES, across - LANES - reach + 1)
            if start <= j < start + LANES + reach - 1:
                nearest[row, s] = max(nearest[row, s], fronts[slot])


def _row_loop(columns_end: bool, layered: bool) -> Callable[..., None]:
    """Compile the loop over one panel row, one strip at a time; see `raycast.polyphase`.

    There are separate versions for columns without backs, for one layer and for more: a common
    version would take a third longer.
    """

    @compiled
    def run_row(  # type: ignore[no-untyped-def]
        r, front, back, payload, deeper_front, deeper_back, deeper_payload, row_stride, row_phases,
        nearest, farthest, deeper_nearest, first, offset, phase_row, reach, exits, entries,
        continue_behind, columns, pixels, empty, strip, row,
    ):  # fmt: skip
        m, v = divmod(r, pixels)
        lenses = len(columns)
        for s in range(nearest.shape[1]):
            start = max(min(s * LANES, lenses - LANES), 0)
            base, first_row = m * row_stride + start, m * row_phases
            top, bottom = m + reach[v, 0], m + reach[v, 1]
            most = nearest_surface(nearest, top, bottom, s)
            least = -np.inf
            if columns_end and not layered:
                least = farthest_end(farthest, top, bottom, s)
            for u in range(pixels):
                direction = v * pixels + u
                k, end = np.uintp(first[direction]), np.uintp(first[direction + 1])
                while k < end and exits[k] > most:
                    k += np.uintp(1)
                begin, searching, payloads = k, all_lanes(), same(empty)
                behind = no_lanes()
                while k < end:
                    if columns_end and not layered and entries[k] < least:
                        break
                    cell = np.uintp(base + offset[k])
                    hit = and_flags(searching, at_least(load(front, cell), same(exits[k])))
                    if columns_end:
                        behind = either(behind, hit)
                        below = hit
                        hit = and_flags(below, at_least(same(entries[k]), load(back, cell)))
                    payloads = choose(hit, load(payload, cell), payloads)
                    searching = but_not(searching, hit)
                    # Layers begin ever farther back: rays above one are above those behind.
                    if layered and deeper_nearest[first_row + phase_row[k], s] >= exits[k]:
                        searching, payloads = _hit_deeper(
                            but_not(below, hit), searching, payloads, same(exits[k]),
                            same(entries[k]), cell, deeper_front, deeper_back, deeper_payload,
                        )  # fmt: skip
                    if not any_lane(searching):
                        break
                    k += np.uintp(1)
                if columns_end and continue_behind:
                    # Back up the rays that met nothing, to the last cell each passed over.
                    # Before the nearest surface there is none: such came in over a border.
                    lost, k = and_flags(behind, searching), end
                    while k > begin and any_lane(lost):
                        k -= np.uintp(1)
                        cell = np.uintp(base + offset[k])
                        depth = load(front, cell)
                        over = and_flags(lost, less(depth, same(exits[k])))
                        covered = and_flags(over, less(same(np.float32(-np.inf)), depth))
                        payloads = choose(covered, load(payload, cell), payloads)
                        lost = but_not(lost, over)
                store(strip, np.uintp(u) * _LANES, payloads)
            write_strip(strip, columns, start, pixels, row)

    row: Callable[..., None] = run_row
    return row


@compiled
def _hit_deeper(below, searching, word, exit_z, entry_z, cell, fronts, backs, words):  # type: ignore[no-untyped-def]
    """Search state and payloads after a test of the lanes below the front against deeper layers."""
    layer = 0
    while layer < len(fronts) and any_lane(below):
        below = and_flags(below, at_least(load(fronts[layer], cell), exit_z))
        hit = and_flags(below, at_least(entry_z, load(backs[layer], cell)))
        word = choose(hit, load(words[layer], cell), word)
        searching = but_not(searching, hit)
        below = but_not(below, hit)
        layer += 1
    return searching, word


_solid_row, _surface_row, _layered_row = (
    _row_loop(columns_end=False, layered=False),
    _row_loop(columns_end=True, layered=False),
    _row_loop(columns_end=True, layered=True),
)


@compiled(parallel=True)
def _run_solid(first, pixels, picture, lists, payload_of, out):  # type: ignore[no-untyped-def]
    """Panel rows from the first on, of columns without an end, shared among the threads."""
    for line in prange(out.shape[0]):
        strip = np.empty(pixels * LANES, np.uint32)
        # The loop's own index is unsigned: passed on as it is, the row is compiled twice.
        _solid_row(first + np.int64(line), *picture, *lists, *payload_of, strip, out[line])


@compiled(parallel=True)
def _run_surface(first, pixels, picture, lists, payload_of, out):  # type: ignore[no-untyped-def]
    """Panel rows of columns of one layer that end; see `_run_solid`."""
    for line in prange(out.shape[0]):
        strip = np.empty(pixels * LANES, np.uint32)
        _surface_row(first + np.int64(line), *picture, *lists, *payload_of, strip, out[line])


@compiled(parallel=True)
def _run_layered(first, pixels, picture, lists, payload_of, out):  # type: ignore[no-untyped-def]
    """Panel rows of layered columns; see `_run_solid`."""
    for line in prange(out.shape[0]):
        strip = np.empty(pixels * LANES, np.uint32)
        _layered_row(first + np.int64(line), *picture, *lists, *payload_of, strip, out[line])


# Share of the panel above which walking rays one by one takes longer than tables for all of them.
_MOST_ALONE = 0.1
# Of usual pictures, with sides: what tables are made for is not known before a picture comes.
_LAYERS = 12


def first_hits(
    name: str,
    display: Display,
    shape: PictureShape,
    pixel_mm: float,
    rule: str,
    samples: int | str,
    mask: np.ndarray | None,
) -> SourceGenerator:
    """Create the generator of first hits in the columns of pictures.

    Parameters
    ----------
    name : str
        Name of the algorithm, for error messages.
    display, shape, pixel_mm, mask :
        See `inim.generators.prepare`.
    rule : str
        Rule of the columns; see `raycast.columns`.
    samples : {1, 2, 4}

    Raises
    ------
    UsageError
        An invalid number of samples, or rays of implausible length.
    """
    if str(samples) not in ("1", "2", "4"):
        raise UsageError(f"{name}: samples = {samples!r}; use 1, 2 or 4")
    check_ray_length(name, display, shape, pixel_mm)
    layers = _LAYERS if rule == LAYERS else 1
    shared = shares_directions(display)
    # Deeper layers are laid out for shared directions alone.
    tables = (shared or rule != LAYERS) and fits_tables(display, shape, pixel_mm, layers)

    sparse = mask is not None and np.count_nonzero(mask) <= _MOST_ALONE * mask.size

    def through(pixel_offset: PixelOffset) -> SourceGenerator:
        if not display.is_separable:
            return NonSeparable(display, shape, pixel_mm, rule, pixel_offset, mask)
        if sparse or not tables:
            return RayByRay(display, shape, pixel_mm, rule, pixel_offset, mask)
        tabled = SharedDirections if shared else NonIntegerPitch
        generator = tabled(display, shape, pixel_mm, rule, pixel_offset)
        return generator if mask is None else masked(generator, mask)

    return averaged(display, int(samples), through)
