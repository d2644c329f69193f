"""Lattice of lenses in a decoded photograph.

Within a lens, panel coordinates hardly change; between adjacent lenses they jump by about a pitch.
Smooth regions are therefore lenses, and the jumps determine the neighbours. Lenses are counted from
neighbour to neighbour, without a search. A decoding error of one period, about a pitch, creates a
lens that fits none of its neighbours; it is removed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from inim.display import Display
from inim.errors import FileError

if TYPE_CHECKING:
    from inim.calibration.decode import Decoded

# Jumps of panel coordinates, in lens pitches: above it pixels belong to two lenses, ...
_SAME_LENS = 0.3
# ... and a whole jump may be off by this much: pitch, perspective and rotation are all within it.
_JUMP_OFF = 0.25
# Of the usual area: less is a splinter between lenses.
_SPLINTER = 0.3
_LEAST_PIXELS = 6
# Neighbours are looked for within so many distances between lenses.
_REACH = 1.7
# A lens whose outline is whole has an area within this of its neighbours'.
_WHOLE_AREA = 0.3
# Where pixels of a lens are taken: places along the lattice's steps in the photograph.
_PLACES = (-0.25, 0.0, 0.25)
#: Pixels taken of each lens.
SAMPLES = len(_PLACES) ** 2
# Fewer lenses say nothing about a lattice.
_LEAST_LENSES = 25


@dataclass(frozen=True)
class Lenses:
    """Lenses visible from one camera position."""

    #: (lenses, 2) int: column to the right and row down, counted from an arbitrary lens.
    index: np.ndarray
    #: (lenses, 2) float: centre of gravity of the region seen through the lens, x and y in the
    #: photograph.
    centre_px: np.ndarray
    #: (lenses,) bool: True if the outline is that of the whole lens, so that `centre_px` is valid.
    is_whole: np.ndarray
    middle_px: np.ndarray  #: (lenses, 2) float: mean panel column and row seen through the lens.
    pixel: np.ndarray  #: (lenses, SAMPLES, 2) float: camera pixels well inside the lens, x and y.
    #: (lenses, SAMPLES, 2) float: panel column and row seen by each of these pixels; NaN for
    #: samples outside the lens.
    panel_px: np.ndarray
    shape: tuple[int, int]  #: Height and width of the photograph.


def find_lenses(decoded: Decoded, display: Display, name: str) -> Lenses:
    """Find the lenses in a decoded photograph and their lattice indices.

    * `display`: nominal display with a square lattice. Its pitch may be wrong by a fifth.
    * `name`: name of the photographs in error messages.

    Raises `FileError`: too few lenses are visible to determine a lattice.
    """
    step = np.array([display.pitch_mm, display.row_pitch_mm]) / display.pixel_pitch_mm
    panel = np.stack([decoded.column, decoded.row], axis=-1, dtype=np.float32)
    label = _regions(panel, step)
    regions = _lens_regions(label, panel, step)
    lens_regions, index, steps = _walk(regions, step, name)
    order = np.lexsort((index[:, 0], index[:, 1]))
    lens_regions, index = lens_regions[order], index[order]
    centre = regions.centre[lens_regions]
    pixel, panel_px = _inside(label, panel, regions.number[lens_regions], centre, steps)
    return Lenses(
        index,
        centre,
        _whole(index, regions.area[lens_regions]),
        regions.panel[lens_regions],
        pixel,
        panel_px,
        label.shape,
    )


class _Regions(NamedTuple):
    number: np.ndarray
    area: np.ndarray
    centre: np.ndarray
    panel: np.ndarray


def _regions(panel: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Number of each pixel's smooth region, from 1; 0 if not decoded."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    is_decoded = np.isfinite(panel).all(axis=-1)

    def joined(a: Any, b: Any) -> np.ndarray:
        with np.errstate(invalid="ignore"):
            near: np.ndarray = (np.abs(panel[a] - panel[b]) < _SAME_LENS * step).all(axis=-1)
        return near

    # Runs along the rows first: they are far fewer than pixels.
    begins = is_decoded.copy()
    begins[:, 1:] &= ~joined(np.s_[:, 1:], np.s_[:, :-1])
    run = np.cumsum(begins).reshape(is_decoded.shape)
    above, below = np.s_[:-1], np.s_[1:]
    touch = joined(above, below)
    pairs = (run[above][touch] - 1, run[below][touch] - 1)
    runs = int(run[-1, -1])
    graph = coo_matrix((np.ones(pairs[0].size, bool), pairs), shape=(runs, runs))
    region = connected_components(graph, directed=False)[1] if runs else np.zeros(0, int)
    label = np.zeros(is_decoded.shape, np.int64)
    label[is_decoded] = region[run[is_decoded] - 1] + 1
    return label


def _lens_regions(label: np.ndarray, panel: np.ndarray, step: np.ndarray) -> _Regions:
    """Regions that may be lenses: neither splinters nor the bare panel."""
    rows, columns = np.nonzero(label)
    number = label[rows, columns]
    area = np.bincount(number)
    safe = np.maximum(area, 1)

    def mean(values: np.ndarray) -> np.ndarray:
        total: np.ndarray = np.bincount(number, values, area.size) / safe
        return total

    panel_px = panel[rows, columns]
    middle = np.stack([mean(panel_px[:, 0]), mean(panel_px[:, 1])], axis=-1)
    square = np.stack([mean((panel_px[:, k] - middle[number, k]) ** 2) for k in (0, 1)], axis=-1)
    centre = np.stack([mean(columns + 0.5), mean(rows + 0.5)], axis=-1)
    large = area >= _LEAST_PIXELS
    flat = (square < (_SAME_LENS * step) ** 2).all(axis=-1)
    is_lens = large & flat
    if is_lens.any():  # the area that most of the picture is made of: splinters may be many
        sizes = np.sort(area[is_lens])
        usual = sizes[np.searchsorted(np.cumsum(sizes), sizes.sum() / 2)]
        is_lens &= area >= _SPLINTER * usual
    chosen = np.flatnonzero(is_lens)
    return _Regions(chosen, area[chosen], centre[chosen], middle[chosen])


def _walk(
    regions: _Regions, step: np.ndarray, name: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Regions that are lenses, their indices, and the lattice steps in pixels, lens by lens."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import breadth_first_order, connected_components

    count = len(regions.number)
    if count < _LEAST_LENSES:
        raise _no_lattice(name, count)
    a, b, jump = _neighbours(regions, step)
    if not jump.any(axis=0).all():  # a single row of lenses, or none
        raise _no_lattice(name, 0)
    graph = coo_matrix((np.ones(a.size), (a, b)), shape=(count, count)).tocsr()
    member = connected_components(graph, directed=False)[1]
    largest = np.bincount(member).argmax()
    if np.count_nonzero(member == largest) < _LEAST_LENSES:
        raise _no_lattice(name, int(np.count_nonzero(member == largest)))
    start = int(np.flatnonzero(member == largest)[0])
    order, before = breadth_first_order(graph, start, directed=False)
    jumps = {(int(i), int(j)): k for i, j, k in zip(a, b, jump, strict=True)}
    index = np.zeros((count, 2), int)
    for region in order[1:]:
        other = before[region]
        vote = jumps.get((other, region))
        index[region] = index[other] + (vote if vote is not None else -jumps[(region, other)])
    inside = np.isin(a, order)
    a, b, jump = a[inside], b[inside], jump[inside]
    # Whatever contradicts a neighbour more often than not is no lens.
    right = (index[b] - index[a] == jump).all(axis=-1)
    votes = np.bincount(np.concatenate([a, b]), np.tile(np.where(right, 1.0, -1.0), 2), count)
    moved = np.stack(
        [
            np.median((regions.centre[b] - regions.centre[a])[(jump == k).all(axis=-1)], axis=0)
            for k in np.eye(2, dtype=int)
        ]
    )
    lens_regions = order[votes[order] > 0]
    lens_regions = lens_regions[_unique(index[lens_regions], regions.area[lens_regions])]
    return lens_regions, index[lens_regions], moved


def _neighbours(regions: _Regions, step: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of lenses a pitch apart, and the step from the first to the second: right or down."""
    from scipy.spatial import cKDTree

    tree = cKDTree(regions.centre)
    spacing = np.median(tree.query(regions.centre, k=2)[0][:, 1])
    pairs = tree.query_pairs(_REACH * spacing, output_type="ndarray")
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    a, b = pairs[:, 0], pairs[:, 1]
    pitches = (regions.panel[b] - regions.panel[a]) / step
    jump = np.rint(pitches).astype(int)
    fits = (np.abs(pitches - jump) < _JUMP_OFF).all(axis=-1) & (np.abs(jump).sum(axis=-1) == 1)
    a, b, jump = a[fits], b[fits], jump[fits]
    back = jump.sum(axis=-1) < 0
    a, b = np.where(back, b, a), np.where(back, a, b)
    jump = np.abs(jump)
    # In the photograph, too, all steps of a kind are nearly one.
    moved = regions.centre[b] - regions.centre[a]
    usual = np.zeros_like(moved)
    for axis in (0, 1):
        of_kind = jump[:, axis] == 1
        if of_kind.any():
            usual[of_kind] = np.median(moved[of_kind], axis=0)
    length = np.sqrt((usual**2).sum(axis=-1))
    alike = np.sqrt(((moved - usual) ** 2).sum(axis=-1)) < 0.5 * length
    return a[alike], b[alike], jump[alike]


def _unique(index: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Indices of the largest lens at each lattice position."""
    order = np.lexsort((-area, index[:, 0], index[:, 1]))
    first = np.ones(order.size, bool)
    first[1:] = (np.diff(index[order], axis=0) != 0).any(axis=-1)
    chosen: np.ndarray = np.sort(order[first])
    return chosen


def _whole(index: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Mask of lenses that have four neighbours, mutually, of similar area."""
    low = index.min(axis=0) - 1
    table = np.zeros(tuple(index.max(axis=0) - low + 2))
    x, y = (index - low).T

    def around(values: np.ndarray) -> np.ndarray:
        table[x, y] = values
        return np.stack([table[x - 1, y], table[x + 1, y], table[x, y - 1], table[x, y + 1]])

    areas = around(area)
    usual = np.median(areas, axis=0)
    surrounded = np.all(areas > 0, axis=0)
    alike = surrounded & (np.abs(area - usual) < _WHOLE_AREA * usual)
    # A neighbour at the edge may be cut off, and its cut may reach over the seam.
    inner: np.ndarray = alike & np.all(around(surrounded) > 0, axis=0)
    return inner


def _inside(
    label: np.ndarray, panel: np.ndarray, number: np.ndarray, centre: np.ndarray, steps: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Camera pixels well inside each lens, and the panel coordinates that they see."""
    places = np.array([(i, j) for j in _PLACES for i in _PLACES])
    target_px = centre[:, None] + places @ steps
    column, row = np.floor(target_px).astype(int).transpose(2, 0, 1)
    height, width = label.shape
    column, row = np.clip(column, 0, width - 1), np.clip(row, 0, height - 1)
    panel_px = np.where(
        (label[row, column] == number[:, None])[..., None], panel[row, column], np.nan
    )
    return np.stack([column, row], axis=-1) + 0.5, panel_px


def _no_lattice(name: str, count: int) -> FileError:
    return FileError(
        f"{name}: no lattice of lenses in these photographs ({count} lenses at a distance of one "
        "pitch); check that they show this display, sharp, with at least 6 pixels per lens; give "
        "the display with --display, or move closer"
    )
