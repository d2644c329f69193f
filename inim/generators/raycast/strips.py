"""Local depth templates: first hits of strips of neighbouring lenses at once, without a gather.

docs/theory/templates.md, "One list for all lenses", describes the method. A ray is in a cell
between its entry depth and its exit depth. The first cell, and in it the nearest layer, whose
column overlaps this interval is hit: ``front >= exit`` and ``back <= entry``. Rays of one pixel of
neighbouring lenses share a list of cells (`raycast.cell_lists`). A strip of lenses (`raycast.simd`)
follows it from near to far until each lens has a hit. With solid columns no depth ends the search:
a ray under the farthest surface still hits the next covered cell, and testing coverage costs as
much as loading depth.
"""

from functools import cache, cached_property
from typing import Any

import numpy as np

from inim.generators.base import HOLE, PanelRays, RaySearch, SourceFinder, Sources
from inim.generators.raycast.cell_lists import SIDES, Passes, Tables, cell_tables
from inim.generators.raycast.cells import check_ray_length
from inim.generators.raycast.columns import LAYERS, columns_of
from inim.generators.raycast.phases import Phases, fits_tables
from inim.generators.raycast.ray_by_ray import RayByRay
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
from inim.system.backend.kernels import compiled, share_rows

# Of the compiler's own type: a Python integer would make addresses signed, and checked.
_LANES = np.uintp(LANES)
_HOLE = np.uint32(HOLE % 2**32)


@cache
def _strip_loop(*, per_lens: bool, columns_end: bool, layered: bool) -> Any:
    """Compile the loop over panel rows, one strip of lenses at a time.

    There are separate versions for columns without backs, for one layer and for more: a common
    version would take a third longer.

    * `per_lens`: the cells are `Passes`, not `Directions`.
    * `columns_end`, `layered`: columns have backs; a picture has several layers.
    """
    sides = SIDES if per_lens else 1

    # Only constants from outside: numba never finds a kernel on disk that refers to a function.
    @compiled
    def trace_rows(  # type: ignore[no-untyped-def]
        start_line, stop_line, first_row, picture, lists, cells, continue_behind, out
    ):
        fronts, backs, nearest, farthest, row_stride, row_sources, lane_sources = picture[:7]
        front, back, layer_sources = fronts[0], backs[0], picture[7]
        lenses, pixels = len(lists.lens_first), lists.most_pixels
        strip = np.empty(pixels * LANES, np.uint32)
        from_first_lane = load(lane_sources, np.uintp(0))
        for line in range(start_line, stop_line):
            r, row = first_row + line, out[line]
            m, list_row = lists.lens[r], lists.list_row[r]
            if lists.has_gaps or m < 0:
                row[:] = _HOLE
            if m < 0:
                continue
            for s in range(nearest.shape[1]):
                start = max(min(s * LANES, lenses - LANES), 0)
                base = m * row_stride + start
                base_source = m * row_sources + lane_sources[1] * start
                top, bottom = m + lists.reach[list_row, 0], m + lists.reach[list_row, 1]
                # A loop: reductions over slices take the compiler a second.
                most, least = nearest[top, s], np.float32(-np.inf)
                for i in range(top + 1, bottom + 1):
                    most = max(most, nearest[i, s])
                if columns_end and not layered:
                    least = farthest[top, s]
                    for i in range(top + 1, bottom + 1):
                        least = min(least, farthest[i, s])
                members = lists.members[s * lists.strip_passes :]
                beginnings = lists.first[list_row * len(lists.members) + s * lists.strip_passes :]
                for part in range(pixels * sides):
                    searching = lanes_of(members[part]) if per_lens else all_lanes()
                    k, end = np.uintp(beginnings[part]), np.uintp(beginnings[part + 1])
                    while k < end and lists.exit_mm[k] > most:
                        k += np.uintp(1)
                    begin, behind, hits = k, no_lanes(), same(_HOLE)
                    while k < end:
                        if columns_end and not layered and lists.entry_mm[k] < least:
                            break
                        if per_lens:
                            crossing = _pass_cell(lists, cells, k)
                        else:
                            crossing = _direction_cell(lists, cells, k)
                        offset, source, exits, entries, visitors = crossing
                        cell = np.uintp(base + offset)
                        sources = add(same(np.uint32(base_source + source)), from_first_lane)
                        hit = and_flags(searching, visitors)
                        hit = and_flags(hit, at_least(load(front, cell), exits))
                        if columns_end:
                            behind = either(behind, hit)
                            below = hit
                            hit = and_flags(below, at_least(entries, load(back, cell)))
                        hits = choose(hit, sources, hits)
                        searching = but_not(searching, hit)
                        if layered:
                            # Layers begin ever farther back: rays above one are above those behind.
                            searching, hits = _hit_deeper(
                                but_not(below, hit), searching, hits, exits, entries, cell, fronts,
                                backs, sources, layer_sources,
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
                            if per_lens:
                                crossing = _pass_cell(lists, cells, k)
                            else:
                                crossing = _direction_cell(lists, cells, k)
                            offset, source, exits, entries, visitors = crossing
                            depth = load(front, np.uintp(base + offset))
                            sources = add(same(np.uint32(base_source + source)), from_first_lane)
                            passed = and_flags(and_flags(lost, visitors), less(depth, exits))
                            covered = less(same(np.float32(-np.inf)), depth)
                            hits = choose(and_flags(passed, covered), sources, hits)
                            lost = but_not(lost, passed)
                    place = np.uintp(part // sides) * _LANES
                    if part % sides:
                        hits = choose(lanes_of(members[part]), hits, load(strip, place))
                    store(strip, place, hits)
                _write_strip(strip, lists, start, row)

    return trace_rows


@compiled
def _direction_cell(lists, cells, k):  # type: ignore[no-untyped-def]
    """Offset and source of a cell; its exit depths, entry depths and visitors, by lens."""
    exits, entries = same(lists.exit_mm[k]), same(lists.entry_mm[k])
    return cells.offset[k], cells.source[k], exits, entries, all_lanes()


@compiled
def _pass_cell(_, cells, k):  # type: ignore[no-untyped-def]
    """Offset and source of a cell; its exit depths, entry depths and visitors, by lens."""
    i, q = np.uintp(cells.cell[k, 0]), np.uintp(cells.cell[k, 1])
    exits, entries = load(cells.exit_mm, q * _LANES), load(cells.entry_mm, q * _LANES)
    row_exit, row_entry = same(cells.row_exit_mm[i]), same(cells.row_entry_mm[i])
    return (
        cells.row_offset[i] + cells.offset[q],
        cells.row_source[i] + cells.source[q],
        choose(less(exits, row_exit), row_exit, exits),
        choose(less(row_entry, entries), row_entry, entries),
        lanes_of(cells.cell[k, 2]),
    )


@compiled
def _hit_deeper(  # type: ignore[no-untyped-def]
    below, searching, hits, exits, entries, cell, fronts, backs, sources, layer_sources
):
    """Search state and hits after a test of the lanes below the front against deeper layers."""
    layer = 1
    while layer < len(fronts) and any_lane(below):
        sources = add(sources, same(np.uint32(layer_sources)))
        below = and_flags(below, at_least(load(fronts[layer], cell), exits))
        hit = and_flags(below, at_least(entries, load(backs[layer], cell)))
        hits = choose(hit, sources, hits)
        searching = but_not(searching, hit)
        below = but_not(below, hit)
        layer += 1
    return searching, hits


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


class Strips:
    """Rays over whole cells per lens pitch, one strip of lenses at a time.

    Tables and buffers are created for the first picture.
    """

    def __init__(self, rays: PanelRays, rule: str) -> None:
        self._rays, self._rule = rays, rule

    @cached_property
    def _tables(self) -> Tables:
        rays = self._rays
        return cell_tables(rays.display, rays.shape, rays.pixel_mm, rays.offsets)

    @cached_property
    def _phases(self) -> Phases:
        return Phases(self._tables[0])

    def take(self, rgbd: RGBD) -> RaySearch:
        """Prepare a picture for all rays; see `SourceFinder`."""
        columns, phases = columns_of(rgbd, self._rule), self._phases
        layout, tables = self._tables
        phases.fill(columns)
        per_pitch, (rows, width) = layout.shape[1], self._rays.shape
        lane_sources = np.arange(LANES, dtype=np.uint32) * np.uint32(per_pitch)
        picture = (
            phases.depth, phases.back, phases.nearest, phases.farthest, layout.row_stride,
            per_pitch * width, lane_sources, rows * width,
        )  # fmt: skip

        def find_rows(ray: int, rows: slice, out: Sources) -> None:
            lists, cells = tables[ray]
            loop = _strip_loop(
                per_lens=isinstance(cells, Passes), columns_end=columns.end,
                layered=len(columns.layers) > 1,
            )  # fmt: skip
            share_rows(
                loop, len(out), rows.start, picture, lists, cells, columns.continue_behind,
                out.view(np.uint32),
            )  # fmt: skip

        return find_rows


# Share of the panel above which walking rays one by one takes longer than tables for all of them.
_MOST_ALONE = 0.1
# Of usual pictures, with sides: what tables are made for is not known before a picture comes.
_LAYERS = 12


def first_hits(name: str, rays: PanelRays, rule: str) -> SourceFinder:
    """Finder of first hits in the columns of pictures.

    * `rule`: see `raycast.columns`.

    Raises `UsageError`: rays of implausible length.
    """
    display, shape, pixel_mm, mask = rays.display, rays.shape, rays.pixel_mm, rays.mask
    check_ray_length(name, display, shape, pixel_mm)
    tables = fits_tables(display, shape, pixel_mm, _LAYERS if rule == LAYERS else 1)
    sparse = mask is not None and np.count_nonzero(mask) <= _MOST_ALONE * mask.size
    return (RayByRay if sparse or not tables else Strips)(rays, rule).take
