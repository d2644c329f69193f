"""Local depth templates: first hits of strips of neighbouring lenses at once, without a gather.

A ray is in a cell between its entry depth and its exit depth. The first cell, and in it the nearest
layer, whose column overlaps this interval is hit: ``front >= exit`` and ``back <= entry``. The last
cell ends at z_min.

If the picture has a whole number of pixels per lens pitch, the rays of one pixel of every lens meet
the same cells, shifted by whole lenses. The list of cells is built once, and a strip of lenses
(`raycast.simd`) follows it from near to far until each lens has a hit. Depths and colours are
contiguous (`raycast.phases`).

With a whole number of panel pixels per lens as well, these rays are parallel: one list per
*direction* has the depths at which all lenses leave its cells (`_Directions`). Otherwise (15.7
pixels per lens, and the like) exit depths differ a little from lens to lens, and are vectors along
the strip (`_Passes`). Rays are separable, so depths are stored per panel row and per panel column.
Which lenses visit a cell, ``max(exits) < min(entries)``, does not depend on the picture: it is
stored, as float64 has it. All tables hold exits as float32, rounded up, and entries, rounded
down: they compare with a float32 depth as the exact ones do.

Entries with exits above the nearest surface within reach of the strip cannot hit, and are skipped.
Entries below the end of every column within reach cannot hit either, and end the search. With solid
columns there is no such bound: a ray under the farthest surface still hits the next covered cell,
and testing coverage costs as much as loading depth.

Several rays of a pixel are traced together. Payloads of their hits add up in registers: light of
colours (`raycast.light`) needs no sources in memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from inim.backend.kernels import compiled, share_rows
from inim.display import Display
from inim.errors import UsageError
from inim.generators.base import (
    CENTRE,
    HOLE,
    PictureShape,
    PixelOffset,
    Search,
    SourceGenerator,
    Sources,
    masked,
)
from inim.generators.raycast.cells import (
    AxisRuns,
    CellRays,
    axis_runs,
    cell_rays,
    check_ray_length,
    rounded_up,
)
from inim.generators.raycast.columns import LAYERS, SOLID, Columns, columns_of
from inim.generators.raycast.light import code_table, encode_light
from inim.generators.raycast.phases import Layout, Phases, cells_per_pitch, fits_tables
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
from inim.generators.raycast.supersampling import averaged
from inim.image.rgbd import RGBD

# Of the compiler's own type: a Python integer would make addresses signed, and checked.
_LANES = np.uintp(LANES)
_NO_CODES = np.empty(0, np.uint8)
# Rays of a pixel of neighbouring lenses lean to the left or to the right.
_SIDES = 2


class _Lists(NamedTuple):
    """Lists of the cells of rays, of one display and picture size.

    A *pass* is a ray of the pixels u of those lenses of a strip that visit cells in the same order.
    It has the number ``p = strip * strip_passes + u * sides + side``. On a row of lists, its list
    begins at ``first[(ray * list_rows + list_row) * passes + p]``.

    Attributes
    ----------
    lens, list_row : (panel rows,) int64
        Lens row, -1 where none; and row of lists.
    reach : (list rows, 2) int64
        See `Layout.row_reach`; of all rays.
    first : (n,) int64
        Where the list of each pass begins.
    exit_mm : (cells,) float32
        Depth at which a lens leaves a cell, rounded up; the least of all lenses.
    entry_mm : (cells,) float32
        Depth at which it enters the cell, rounded down; a bound of all lenses.
    members : (rays x passes,) uint32
        Lenses of a strip that take part in a pass, a bit each.
    passes, strip_passes : int
        Passes of a ray; and of a strip, 0 if all strips share them.
    lens_first, lens_pixels : (lens columns,) int64
        First panel column of each lens, and how many it has.
    most_pixels, least_pixels : int
        Largest and smallest of these numbers.
    has_gaps : bool
        Some panel columns have no lens.
    """

    lens: np.ndarray
    list_row: np.ndarray
    reach: np.ndarray
    first: np.ndarray
    exit_mm: np.ndarray
    entry_mm: np.ndarray
    members: np.ndarray
    passes: int
    strip_passes: int
    lens_first: np.ndarray
    lens_pixels: np.ndarray
    most_pixels: int
    least_pixels: int
    has_gaps: bool


class _Directions(NamedTuple):
    """Cells of directions that all lenses share; their depths are those of `_Lists`.

    Attributes
    ----------
    offset : (cells,) int64
        Flat distance from slot (0, 0).
    """

    offset: np.ndarray


class _Passes(NamedTuple):
    """Cells of rays whose exit depths differ between lenses, nearest first.

    Rays of a pass lean to one side.

    Attributes
    ----------
    cell : (n, 3) uint32
        Index in the row arrays and in the column arrays, and lenses that visit it, a bit each.
    row_offset : (rows,) int64
        See `Layout.row_offset`.
    row_exit_mm, row_entry_mm : (rows,) float32
    offset : (columns,) int64
        See `Layout.column_offset`.
    exit_mm, entry_mm : (columns, LANES) float32
        Per lens; anything where a lens does not visit a cell.
    """

    cell: np.ndarray
    row_offset: np.ndarray
    row_exit_mm: np.ndarray
    row_entry_mm: np.ndarray
    offset: np.ndarray
    exit_mm: np.ndarray
    entry_mm: np.ndarray


_Tables = tuple[Layout, _Lists, _Directions | _Passes]


@dataclass(frozen=True)
class DirectionLists:
    """Templates of one display and picture size; direction (v, u) has the index ``v * pixels + u``.

    Attributes
    ----------
    first : (pixels^2 + 1,) int64
        Start of each direction's entries.
    row, column : (n,) int64
        Cells of the lens with index (0, 0); lens (m, n) adds ``per_pitch * (m, n)``. Nearest first.
    exit_mm, entry_mm : (n,) float64
        Depths at which the ray leaves and enters them; inf for the first cells.
    """

    first: np.ndarray
    row: np.ndarray
    column: np.ndarray
    exit_mm: np.ndarray
    entry_mm: np.ndarray


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
    assert shares_directions(display)
    pixels, depths = round(display.pixels_per_lens), display.depth_range_mm
    columns, rows = (
        axis_runs(CellRays(rays.start[:pixels], rays.slope[:pixels], rays.scale), depths)
        for rays in cell_rays(shape, pixel_mm, display, pixel_offset)
    )
    parts: list[tuple[np.ndarray, ...]] = []
    for row_cell, row_exit in zip(rows.cell, rows.exit_mm, strict=True):
        # All borders, nearest first, and once where a row's and a column's meet in a corner.
        exits = np.concatenate(
            [columns.exit_mm, np.broadcast_to(row_exit, (pixels, len(row_exit)))], axis=1
        )
        exits = -np.sort(-exits, axis=1)
        entries = np.roll(exits, 1, axis=1)
        entries[:, 0] = np.inf
        ends = exits < entries
        # The cell that a ray leaves is as far on as borders are above.
        column = np.count_nonzero(columns.exit_mm[:, None] > exits[..., None], axis=2)
        row = np.count_nonzero(row_exit > exits[..., None], axis=2)
        cells = row_cell[row], np.take_along_axis(columns.cell, column, axis=1), exits, entries
        parts.append((np.count_nonzero(ends, axis=1), *(values[ends] for values in cells)))
    count, *values = (np.concatenate(of_row) for of_row in zip(*parts, strict=True))
    return DirectionLists(np.concatenate([[0], np.cumsum(count)]), *values)


@lru_cache(maxsize=8)
def _tables(
    display: Display, shape: PictureShape, pixel_mm: float, offsets: tuple[PixelOffset, ...]
) -> _Tables:
    """Tables of rays of a display over pictures of one size."""
    build = _direction_tables if shares_directions(display) else _pass_tables
    return build(display, shape, pixel_mm, offsets)


def _direction_tables(
    display: Display, shape: PictureShape, pixel_mm: float, offsets: tuple[PixelOffset, ...]
) -> _Tables:
    per_pitch, pixels = cells_per_pitch(display, pixel_mm), round(display.pixels_per_lens)
    assert per_pitch is not None
    lists = [build_lists(display, shape, pixel_mm, offset) for offset in offsets]
    row, column, exit_mm, entry_mm = (
        np.concatenate([getattr(of_ray, name) for of_ray in lists])
        for name in ("row", "column", "exit_mm", "entry_mm")
    )
    layout = Layout.of(per_pitch, row, column, display)
    first = _joined_first([of_ray.first for of_ray in lists])
    reach = layout.row_reach(row, first[:-1:pixels]).reshape(len(offsets), pixels, 2)
    panel_rows = np.arange(display.eia_shape[0])
    return (
        layout,
        _Lists(
            display.rows.lens, panel_rows % pixels, _widest(reach), first,
            rounded_up(exit_mm), -rounded_up(-entry_mm),
            np.full(len(offsets) * pixels, 2**32 - 1, np.uint32), pixels, 0,
            np.arange(display.lens_columns) * pixels, np.full(display.lens_columns, pixels),
            pixels, pixels, False,
        ),
        _Directions(layout.row_offset(row) + layout.column_offset(column)),
    )  # fmt: skip


def _joined_first(firsts: Sequence[np.ndarray]) -> np.ndarray:
    """Beginnings of lists that follow one another, from those of each ray."""
    counts = np.concatenate([np.diff(first) for first in firsts])
    return np.concatenate([[0], np.cumsum(counts)])


def _widest(reach: np.ndarray) -> np.ndarray:
    """Reach of all rays, (list rows, 2), from that of each, (rays, list rows, 2)."""
    return np.stack([reach[..., 0].min(axis=0), reach[..., 1].max(axis=0)], axis=1)


class _RayRuns(NamedTuple):
    """Runs of one ray of every pixel; cells as if under the lens 0."""

    row: np.ndarray
    column: np.ndarray
    rows: AxisRuns
    columns: AxisRuns


def _pass_tables(
    display: Display, shape: PictureShape, pixel_mm: float, offsets: tuple[PixelOffset, ...]
) -> _Tables:
    per_pitch = cells_per_pitch(display, pixel_mm)
    assert per_pitch is not None
    row_lens, owner = display.rows.lens, display.columns.lens
    rays = []
    for offset in offsets:
        columns, rows = (
            axis_runs(axis, display.depth_range_mm)
            for axis in cell_rays(shape, pixel_mm, display, offset)
        )
        row, column = (
            runs.cell - per_pitch * lens[:, None]
            for runs, lens in ((rows, row_lens), (columns, owner))
        )
        rays.append(_RayRuns(row, column, rows, columns))
    layout = Layout.of(
        per_pitch,
        np.concatenate([ray.row[ray.rows.used & (row_lens >= 0)[:, None]] for ray in rays]),
        np.concatenate([ray.column[ray.columns.used & (owner >= 0)[:, None]] for ray in rays]),
        display,
    )
    lens_pixels = np.bincount(owner[owner >= 0], minlength=display.lens_columns)
    lens_first = np.array([np.argmax(owner == n) for n in range(display.lens_columns)])
    pixels = int(lens_pixels.max())
    parts = [_ray_passes(ray, owner, lens_first, pixels, layout) for ray in rays]
    row_first = [np.concatenate([[0], np.cumsum(ray.rows.count)]) for ray in rays]
    reach = [
        layout.row_reach(ray.row[ray.rows.used], first[:-1])
        for ray, first in zip(rays, row_first, strict=True)
    ]
    listed = [
        _find_pass_cells(row_lens, ray.rows, exits, entries)
        for ray, (*_, exits, entries) in zip(rays, parts, strict=True)
    ]
    rows_before, columns_before = 0, 0
    for ray, (_, cell), (column_offset, *_) in zip(rays, listed, parts, strict=True):
        cell[:, :2] += np.array([rows_before, columns_before], np.uint32)
        rows_before += ray.rows.count.sum()
        columns_before += column_offset.size
    used = [ray.rows.used for ray in rays]
    row, row_exit, row_entry = (
        np.concatenate([values[visited] for values, visited in zip(of_rays, used, strict=True)])
        for of_rays in (
            [ray.row for ray in rays],
            [ray.rows.exit_mm for ray in rays],
            [ray.rows.entry_mm for ray in rays],
        )
    )
    column_offset, members, exits, entries = (
        np.concatenate([values.reshape(-1, *values.shape[2:]) for values in of_rays])
        for of_rays in zip(*parts, strict=True)
    )
    exit_mm, row_exit, row_entry = rounded_up(exits), rounded_up(row_exit), -rounded_up(-row_entry)
    cell = np.concatenate([cell for _, cell in listed])
    nearest_exit = np.maximum(row_exit[cell[:, 0]], exit_mm.min(axis=1)[cell[:, 1]])
    return (
        layout,
        _Lists(
            row_lens, np.arange(len(row_lens)), _widest(np.stack(reach)),
            _joined_first([first for first, _ in listed]), nearest_exit,
            row_entry[cell[:, 0]], members,
            len(members) // len(offsets), _SIDES * pixels, lens_first, lens_pixels, pixels,
            int(lens_pixels.min()), bool((owner < 0).any()),
        ),
        _Passes(
            cell, layout.row_offset(row), row_exit, row_entry, column_offset, exit_mm,
            -rounded_up(-entries),
        ),
    )  # fmt: skip


def _ray_passes(
    ray: _RayRuns, owner: np.ndarray, lens_first: np.ndarray, pixels: int, layout: Layout
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Column cells of the passes of one ray.

    Parameters
    ----------
    ray : _RayRuns
    owner : (panel columns,) int64
        Lens of each; -1 where none.
    lens_first : (lenses,) int64
        First panel column of each lens.
    pixels : int
        Most pixels of a lens.
    layout : Layout

    Returns
    -------
    offset : (passes, cells) int64
        See `Layout.column_offset`.
    members : (passes,) uint32
        See `_Lists`.
    exits, entries : (passes, cells, LANES) float64
        inf and -inf where a lens does not visit a cell.
    """
    lenses, runs = len(lens_first), ray.columns
    last = np.take_along_axis(runs.cell, runs.count[:, None] - 1, axis=1)[:, 0]
    within = 2 * (np.arange(len(owner)) - lens_first[owner]) + (last >= runs.cell[:, 0])
    strips = -(-lenses // LANES)
    # Panel columns of each strip, with the number and the lane of their pass.
    column, number, lane = [], [], []
    for strip in range(strips):
        start = max(min(strip * LANES, lenses - LANES), 0)
        own = np.flatnonzero((owner >= start) & (owner < start + LANES))
        column.append(own)
        number.append(2 * pixels * strip + within[own])
        lane.append(owner[own] - start)
    of_column = np.concatenate(column)
    cells, used = ray.column[of_column], runs.used[of_column]
    number_of_run = np.repeat(np.concatenate(number), used.sum(axis=1))
    lane_of_run = np.repeat(np.concatenate(lane), used.sum(axis=1))
    # The nearest cell of any lens: the leftmost of rays that go right.
    step = np.tile([-1, 1], strips * pixels)
    along = step[number_of_run] * cells[used]
    nearest = np.full(len(step), np.iinfo(np.int64).max)
    np.minimum.at(nearest, number_of_run, along)
    nearest[nearest == np.iinfo(np.int64).max] = 0  # a pass without lenses
    rank = along - nearest[number_of_run]
    most = int(rank.max()) + 1
    exits = np.full((len(step), most, LANES), np.inf)
    entries = np.full((len(step), most, LANES), -np.inf)
    place = number_of_run, rank, lane_of_run
    exits[place], entries[place] = runs.exit_mm[of_column][used], runs.entry_mm[of_column][used]
    members = np.isfinite(exits).any(axis=1) @ (1 << np.arange(LANES))
    offset = layout.column_offset(step[:, None] * (nearest[:, None] + np.arange(most)))
    return offset, members.astype(np.uint32), exits, entries


def _find_pass_cells(
    lens: np.ndarray, rows: AxisRuns, exits: np.ndarray, entries: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find the cells that some lens of a pass visits, on every panel row: first and cells."""
    # Bounds of all cells from here on.
    latest = np.maximum.accumulate(entries.max(axis=2)[:, ::-1], axis=1)[:, ::-1]
    row_first = np.concatenate([[0], np.cumsum(rows.count)])
    depths = (
        row_first, lens, rows.exit_mm[rows.used], rows.entry_mm[rows.used], exits, entries,
        exits.min(axis=2), np.ascontiguousarray(latest),
    )  # fmt: skip
    count = np.zeros(len(lens) * len(exits), np.int64)
    share_rows(_find_cells, len(lens), *depths, count, np.empty((0, 3), np.uint32), False)
    first = np.concatenate([[0], np.cumsum(count)])
    cell = np.empty((first[-1], 3), np.uint32)
    share_rows(_find_cells, len(lens), *depths, first, cell, True)
    return first, cell


@compiled
def _find_cells(  # type: ignore[no-untyped-def]
    start, stop, row_first, lens, row_exit, row_entry, exits, entries, least_exit, latest, first,
    cell, write,
):  # fmt: skip
    """Count the cells of each pass on some panel rows, or write them."""
    passes, most, _ = exits.shape
    for r in range(start, stop):
        if lens[r] < 0:
            continue
        for p in range(passes):
            at, begin = 0, 0
            for i in range(row_first[r], row_first[r + 1]):
                # Cells left above this row's entry are left above those of all further rows.
                while begin < most and least_exit[p, begin] >= row_entry[i]:
                    begin += 1
                for q in range(begin, most):
                    if latest[p, q] <= row_exit[i]:
                        break
                    bits = np.uint32(0)
                    for n in range(LANES):
                        z_exit = max(exits[p, q, n], row_exit[i])
                        visits = z_exit < min(entries[p, q, n], row_entry[i])
                        bits |= np.uint32(visits) << np.uint32(n)
                    if bits:
                        if write:
                            place = first[r * passes + p] + at
                            cell[place, 0], cell[place, 1] = i, p * most + q
                            cell[place, 2] = bits
                        at += 1
            if not write:
                first[r * passes + p] = at


def _strip_loop(*, per_lens: bool, columns_end: bool, layered: bool, light: bool) -> Any:
    """Compile the loop over panel rows, one strip of lenses at a time.

    There are separate versions for columns without backs, for one layer and for more: a common
    version would take a third longer.

    Parameters
    ----------
    per_lens : bool
        The cells are `_Passes`, not `_Directions`.
    columns_end, layered : bool
        Columns have backs; a picture has several layers.
    light : bool
        Payloads are light, whose sum is written as codes; see `raycast.light`.
    """
    sides = _SIDES if per_lens else 1

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

    Parameters
    ----------
    strip : (most pixels x LANES,) uint32
    lists : _Lists
    start : int
        The strip's first lens.
    row : (panel columns,) uint32
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

    Parameters
    ----------
    display, shape, pixel_mm, rule :
        As for `FirstHits`.
    *offsets : PixelOffset
        Start of each ray in its pixel.
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
    def _tables(self) -> _Tables:
        return _tables(self.display, self.shape, self.pixel_mm, self._offsets)

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

    def joined(self, rays: Sequence[SourceGenerator]) -> SourceGenerator | None:
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
        """See `SourceGenerator.show_light`."""
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
            per_lens=isinstance(cells, _Passes), columns_end=columns.end,
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
    tables = fits_tables(display, shape, pixel_mm, _LAYERS if rule == LAYERS else 1)
    sparse = mask is not None and np.count_nonzero(mask) <= _MOST_ALONE * mask.size

    def through(pixel_offset: PixelOffset) -> SourceGenerator:
        if sparse or not tables:
            return RayByRay(display, shape, pixel_mm, rule, pixel_offset, mask)
        generator = Strips(display, shape, pixel_mm, rule, pixel_offset)
        return generator if mask is None else masked(generator, mask)

    return averaged(display, int(samples), through)
