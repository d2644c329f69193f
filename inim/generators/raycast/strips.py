"""Local depth templates: first hits of strips of neighbouring lenses at once, without a gather.

docs/theory/templates.md, "One list for all lenses", describes the method. A ray is in a cell
between its entry depth and its exit depth. The first cell, and in it the nearest layer, whose
column overlaps this interval is hit: ``front >= exit`` and ``back <= entry``. Rays of one pixel of
neighbouring lenses share a list of cells (`raycast.cell_lists`). A strip of lenses (`raycast.simd`)
follows it from near to far until each lens has a hit. With solid columns no depth ends the search:
a ray under the farthest surface still hits the next covered cell, and testing coverage costs as
much as loading depth.

Several rays of a pixel are traced together. Payloads of their hits add up in registers: light of
colours (`raycast.light`) needs no sources in memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, cached_property
from typing import Any

import numpy as np

from inim.backend.kernels import compiled, share_rows
from inim.display import Display
from inim.display.pixels import CENTRE, PixelOffset
from inim.errors import UsageError
from inim.generators.base import (
    HOLE,
    JoinedRays,
    PictureShape,
    Search,
    SourceGenerator,
    Sources,
    masked,
)
from inim.generators.raycast.cell_lists import SIDES, Passes, Tables, cell_tables
from inim.generators.raycast.cells import check_ray_length
from inim.generators.raycast.colour import averaged
from inim.generators.raycast.columns import LAYERS, SOLID, Columns, columns_of
from inim.generators.raycast.light import code_table, encode_light
from inim.generators.raycast.phases import Phases, fits_tables
from inim.generators.raycast.ray_by_ray import FirstHits, RayByRay
from inim.generators.raycast.simd import (
    BLOCK,
    LANES,
    add,
    all_lanes,
    and_flags,
    any_lane,
    at_least,
    but_not,
    choose,
    either,
    lanes_of,
    less,
    load,
    no_lanes,
    same,
    store,
    transpose,
)
from inim.image.rgbd import RGBD

# Of the compiler's own type: a Python integer would make addresses signed, and checked.
_LANES = np.uintp(LANES)
_NO_CODES = np.empty(0, np.uint8)


def _strip_loop(*, per_lens: bool, columns_end: bool, layered: bool, light: bool) -> Any:
    """Compile the loop over panel rows, one strip of lenses at a time.

    There are separate versions for columns without backs, for one layer and for more: a common
    version would take a third longer.

    * `per_lens`: the cells are `Passes`, not `Directions`.
    * `columns_end`, `layered`: columns have backs; a picture has several layers.
    * `light`: payloads are light, whose sum is written as codes; see `raycast.light`.
    """
    sides = SIDES if per_lens else 1

    @compiled
    def trace_rows(  # type: ignore[no-untyped-def]
        start_line, stop_line, first_row, picture, lists, cells, start_ray, stop_ray,
        continue_behind, empty, no_payload, codes, out,
    ):  # fmt: skip
        front, back, payload, nearest, farthest, row_stride = picture[:6]
        deeper_front, deeper_back, deeper_payload, deeper_nearest, across = picture[6:]
        lenses, pixels, list_rows = len(lists.lens_first), lists.most_pixels, len(lists.reach)
        sums = np.empty(pixels * LANES, payload.dtype)
        words = np.empty(pixels * LANES, np.uint32)
        for line in range(start_line, stop_line):
            r, row = first_row + line, out[line]
            m, list_row = lists.lens[r], lists.list_row[r]
            if lists.has_gaps or m < 0:
                row[:] = np.uint32(empty)
            if m < 0:
                continue
            for s in range(nearest.shape[1]):
                start = max(min(s * LANES, lenses - LANES), 0)
                base = m * row_stride + start
                top, bottom = m + lists.reach[list_row, 0], m + lists.reach[list_row, 1]
                # A loop: reductions over slices take the compiler a second.
                most, least = nearest[top, s], np.float32(-np.inf)
                for i in range(top + 1, bottom + 1):
                    most = max(most, nearest[i, s])
                if columns_end and not layered:
                    least = farthest[top, s]
                    for i in range(top + 1, bottom + 1):
                        least = min(least, farthest[i, s])
                if per_lens:
                    sums[:] = empty
                for ray in range(start_ray, stop_ray):
                    number = s * lists.strip_passes
                    members = lists.members[ray * lists.passes + number :]
                    number += (ray * list_rows + list_row) * lists.passes
                    beginnings = lists.first[number:]
                    for part in range(pixels * sides):
                        searching = lanes_of(members[part]) if per_lens else all_lanes()
                        k, end = np.uintp(beginnings[part]), np.uintp(beginnings[part + 1])
                        while k < end and lists.exit_mm[k] > most:
                            k += np.uintp(1)
                        begin, behind, payloads = k, no_lanes(), same(no_payload)
                        while k < end:
                            if columns_end and not layered and lists.entry_mm[k] < least:
                                break
                            if per_lens:
                                offset, exits, entries, visitors = _pass_cell(lists, cells, k)
                            else:
                                offset, exits, entries, visitors = _direction_cell(lists, cells, k)
                            cell = np.uintp(base + offset)
                            hit = and_flags(searching, visitors)
                            hit = and_flags(hit, at_least(load(front, cell), exits))
                            if columns_end:
                                behind = either(behind, hit)
                                below = hit
                                hit = and_flags(below, at_least(entries, load(back, cell)))
                            payloads = choose(hit, load(payload, cell), payloads)
                            searching = but_not(searching, hit)
                            if layered:
                                # Layers begin ever farther back: rays above one are above
                                # those behind.
                                below = but_not(below, hit)
                                slot_row = (cell - np.uintp(start)) // np.uintp(across)
                                if (
                                    any_lane(below)
                                    and deeper_nearest[slot_row, s] >= lists.exit_mm[k]
                                ):
                                    searching, payloads = _hit_deeper(
                                        below, searching, payloads, exits, entries, cell,
                                        deeper_front, deeper_back, deeper_payload,
                                    )  # fmt: skip
                            if not any_lane(searching):
                                break
                            k += np.uintp(1)
                        if columns_end and continue_behind:
                            # Back up the rays that met nothing, to the last cell each passed
                            # over. Before the nearest surface there is none: such came in over
                            # a border.
                            lost, k = and_flags(behind, searching), end
                            while k > begin and any_lane(lost):
                                k -= np.uintp(1)
                                if per_lens:
                                    offset, exits, entries, visitors = _pass_cell(lists, cells, k)
                                else:
                                    offset, exits, entries, visitors = _direction_cell(
                                        lists, cells, k
                                    )
                                cell = np.uintp(base + offset)
                                depth = load(front, cell)
                                passed = and_flags(and_flags(lost, visitors), less(depth, exits))
                                covered = less(same(np.float32(-np.inf)), depth)
                                payloads = choose(
                                    and_flags(passed, covered), load(payload, cell), payloads
                                )
                                lost = but_not(lost, passed)
                        place = np.uintp(part // sides) * _LANES
                        before = same(empty)
                        if per_lens or ray > start_ray:
                            before = load(sums, place)
                        store(sums, place, add(before, payloads))
                if light:
                    encode_light(sums, codes, words)
                    _write_strip(words, lists, start, row)
                else:
                    _write_strip(sums, lists, start, row)

    return trace_rows


@compiled
def _direction_cell(lists, cells, k):  # type: ignore[no-untyped-def]
    """Offset of a cell; its exit depths, entry depths and visitors, by lens."""
    return cells.offset[k], same(lists.exit_mm[k]), same(lists.entry_mm[k]), all_lanes()


@compiled
def _pass_cell(_, cells, k):  # type: ignore[no-untyped-def]
    """Offset of a cell; its exit depths, entry depths and visitors, by lens."""
    i, q = np.uintp(cells.cell[k, 0]), np.uintp(cells.cell[k, 1])
    exits, entries = load(cells.exit_mm, q * _LANES), load(cells.entry_mm, q * _LANES)
    row_exit, row_entry = same(cells.row_exit_mm[i]), same(cells.row_entry_mm[i])
    return (
        cells.row_offset[i] + cells.offset[q],
        choose(less(exits, row_exit), row_exit, exits),
        choose(less(row_entry, entries), row_entry, entries),
        lanes_of(cells.cell[k, 2]),
    )


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


@compiled
def _write_strip(strip, lists, start, row):  # type: ignore[no-untyped-def]
    """Write a strip to its panel row.

    * `strip`: (most pixels x LANES,) uint32.
    * `row`: (panel columns,) uint32.
    """
    lens_first, pixels = lists.lens_first, lists.least_pixels
    lanes = min(LANES, len(lens_first))
    blocked = lanes - lanes % BLOCK
    whole = pixels - pixels % BLOCK
    # A last block that covers some pixels again is cheaper than three or more one by one.
    again = pixels >= BLOCK and pixels - whole > 2
    for n in range(0, blocked, BLOCK):
        lens = np.uintp(start + n)
        for u in range(0, whole, BLOCK):
            transpose(strip, np.uintp(u * LANES + n), row, np.uintp(u), lens_first, lens)
        if again:
            u = pixels - BLOCK
            transpose(strip, np.uintp(u * LANES + n), row, np.uintp(u), lens_first, lens)
    for n in range(lanes):
        transposed = 0 if n >= blocked else pixels if again else whole
        for u in range(transposed, lists.lens_pixels[start + n]):
            row[lens_first[start + n] + u] = strip[u * LANES + n]


_loop = cache(_strip_loop)


class Strips(FirstHits):
    """First hits of one or several rays of every pixel, of whole cells per lens pitch.

    Tables and buffers are created for the first picture.

    * `display`, `shape`, `pixel_mm`, `rule`: as for `FirstHits`.
    """

    def __init__(
        self,
        display: Display,
        shape: PictureShape,
        pixel_mm: float,
        rule: str,
        *offsets: PixelOffset,
    ) -> None:
        self._offsets = offsets or (CENTRE,)
        super().__init__(display, shape, pixel_mm, rule, self._offsets[0])

    @cached_property
    def _tables(self) -> Tables:
        return cell_tables(self.display, self.shape, self.pixel_mm, self._offsets)

    @cached_property
    def _phases(self) -> Phases:
        return Phases(self._tables[0], self.shape, end=self._rule != SOLID)

    @cached_property
    def _index(self) -> tuple[np.ndarray, np.ndarray]:
        """Flat numbers of cells from 1 on, (H, W), and their phases: payloads for sources."""
        index = np.arange(1, self.shape[0] * self.shape[1] + 1, dtype=np.uint32)
        index = index.reshape(self.shape)
        return index, self._spread(index)

    @cached_property
    def _buffer(self) -> np.ndarray:
        """Phases of colours."""
        return np.zeros(len(self._phases.depth), np.uint32)

    @cached_property
    def _light_buffer(self) -> np.ndarray:
        """Phases of light."""
        return np.zeros(len(self._phases.depth), np.uint64)

    def joined(self, rays: Sequence[SourceGenerator]) -> JoinedRays | None:
        """See `SourceGenerator.joined`."""
        strips = [ray for ray in rays if isinstance(ray, Strips)]
        offsets = [offset for ray in strips for offset in ray._offsets]
        if len(strips) < len(rays):
            return None
        return Strips(self.display, self.shape, self.pixel_mm, self._rule, *offsets)

    def search(self, rgbd: RGBD) -> Search:
        """See `SourceGenerator.search`; of several rays, into (rays, rows, columns)."""
        columns = columns_of(rgbd, self._rule)
        self._phases.fill(columns)
        index, payload = self._index
        deeper = [index + np.uint32(n * index.size) for n in range(1, len(columns.layers))]
        payloads = payload, self._phases.deeper_payloads(deeper, index.dtype)

        def find_rows(rows: slice, out: Sources) -> None:
            # A hit adds its number to that of a hole.
            for ray, sources in enumerate(out.reshape(-1, *out.shape[-2:])):
                self._trace(
                    columns, payloads, np.uint32(HOLE % 2**32), (ray, ray + 1), rows.start,
                    sources.view(np.uint32),
                )  # fmt: skip

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
        colours = [
            np.ascontiguousarray(layer.color).view(np.uint32)[..., 0] for layer in rgbd.layers
        ]
        self._show(rgbd, colours, self._buffer, out)
        return out

    def show_light(self, rgbd: RGBD, words: np.ndarray, out: np.ndarray) -> None:
        """See `JoinedRays.show_light`."""
        self._show(rgbd, list(words.reshape(-1, *self.shape)), self._light_buffer, out)

    def _show(
        self, rgbd: RGBD, payloads: Sequence[np.ndarray], buffer: np.ndarray, out: np.ndarray
    ) -> None:
        """Show the sum of a payload (H, W) of each layer, over all rays, on RGBA (H, W, 4)."""
        columns = columns_of(rgbd, self._rule)
        self._phases.fill(columns)
        self._tables[0].spread(payloads[0], buffer)
        deeper = self._phases.deeper_payloads(payloads[1 : len(columns.layers)], buffer.dtype)
        rays = 0, len(self._offsets)
        self._trace(
            columns, (buffer, deeper), buffer.dtype.type(0), rays, 0, out.view(np.uint32)[..., 0]
        )

    def _spread(self, values: np.ndarray) -> np.ndarray:
        phases = np.zeros(len(self._phases.depth), values.dtype)
        self._tables[0].spread(values, phases)
        return phases

    def _trace(
        self,
        columns: Columns,
        payloads: tuple[np.ndarray, np.ndarray],
        empty: np.generic,
        rays: tuple[int, int],
        first_row: int,
        out: np.ndarray,
    ) -> None:
        """Write ``empty`` plus the payloads of the first hits of some rays on panel rows."""
        (layout, lists, cells), phases = self._tables, self._phases
        payload, deeper = payloads
        light = payload.dtype == np.uint64
        loop = _loop(
            per_lens=isinstance(cells, Passes), columns_end=columns.end,
            layered=len(deeper) > 0, light=light,
        )  # fmt: skip
        picture = (
            phases.depth, phases.back, payload, phases.nearest, phases.farthest, layout.row_stride,
            phases.deeper_depth, phases.deeper_back, deeper, phases.deeper_nearest, layout.shape[3],
        )  # fmt: skip
        share_rows(
            loop, len(out), first_row, picture, lists, cells, *rays, columns.continue_behind, empty,
            payload.dtype.type(0), code_table() if light else _NO_CODES, out,
        )  # fmt: skip


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

    * `display`, `shape`, `pixel_mm`, `mask`: see `inim.generators.prepare`.
    * `samples`: {1, 2, 4}.

    Raises `UsageError`: an invalid number of samples, or rays of implausible length.
    """
    if str(samples) not in ("1", "2", "4"):
        raise UsageError(f"{name}: samples = {samples!r}; use 1, 2 or 4")
    check_ray_length(name, display, shape, pixel_mm)
    tables = fits_tables(display, shape, pixel_mm, _LAYERS if rule == LAYERS else 1)
    sparse = mask is not None and np.count_nonzero(mask) <= _MOST_ALONE * mask.size

    def through(pixel_offset: PixelOffset) -> SourceGenerator:
        if sparse or not tables:
            return RayByRay(display, shape, pixel_mm, rule, pixel_offset, mask)
        generator = Strips(display, shape, pixel_mm, rule, pixel_offset)
        return generator if mask is None else masked(generator, mask)

    return averaged(display, int(samples), through)
