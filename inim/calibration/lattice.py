"""Lattice of lenses in a decoded photograph.

Within a lens, panel coordinates hardly change; between adjacent lenses they jump by about a pitch,
modulo a period of the cosines. Smooth regions are therefore lenses, and the jumps determine the
neighbours. Lenses and periods are counted from neighbour to neighbour, without a search. A region
that fits none of its neighbours is removed. The marks that lenses show number the periods.

Between two lenses the cosine's complex amplitude changes from one value to another as the camera's
response to an edge. The second moment of this transition is the variance of the blur, for any
shape of it, including that of a sharpened photograph.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from inim.calibration.patterns import MARK, has_mark, marks_begin, periods_px
from inim.display import Display
from inim.display.pixels import SUBPIXELS
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
# Where pixels of a lens are taken: about four places, in squares that fill its middle. Their extent
# from its centre, in lenses, ends at this many sigmas of the blur from the seams, where less than a
# hundredth of the light is the next lens's.
_PLACES = np.array([(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)])
_LEAST_EXTENT, _MOST_EXTENT, _SEAM_SIGMAS = 0.15, 0.38, 3.0
# Sigma of the blur, in lenses, above which lenses show too little of their own.
_MOST_BLUR = 0.17
# Least decoded share of a square.
_FULL_SQUARE = 0.8
#: Pixels taken of each lens.
SAMPLES = len(_PLACES)
# Fewer lenses say nothing about a lattice.
_LEAST_LENSES = 25
# Lenses that look well into the middle of a period show its mark, if there is one. Of those that
# contradict the numbering: the share of marks, and how many more contradict any other numbering.
_MIDDLE = 0.75 * MARK
_MOST_CONTRADICTIONS, _LEAST_MARGIN, _LEAST_MARKED = 0.25, 3, 4
# Transitions between lenses: samples per pixel, and the part of the way between two centres.
_SAMPLES_PER_PX, _TRANSITION = 4, 0.35


#: Fields of `Lenses` that have an entry for each lens.
PER_LENS = ("index", "centre_px", "is_whole", "middle_px", "pixel", "panel_px")


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
    #: (2,) float: panel columns and rows are known modulo this; 0 if marks number the periods.
    period_px: np.ndarray
    blur_px2: float  #: Variance of what a camera pixel covers, along an axis.
    square_px2: float  #: Variance of the squares that `panel_px` are means of.
    motion_px: float  #: Corrected displacement of the photographs, root mean square.
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
    period = periods_px(display)
    panel = np.stack([decoded.column, decoded.row], axis=-1, dtype=np.float32)
    label = _regions(panel, step, period)
    regions = _lens_regions(label, panel, decoded.is_marked, step, period)
    lens_regions, index, middle, steps = _walk(regions, step, period, name)
    order = np.lexsort((index[:, 0], index[:, 1]))
    lens_regions, index, middle = lens_regions[order], index[order], middle[order]
    centre = regions.centre[lens_regions]
    rows, columns = display.eia_shape
    marked = regions.marked[lens_regions]
    offset, is_contradicted = period_numbers(middle, marked, display)
    check_marks(is_contradicted and marked.sum() >= _LEAST_MARKED, display, name)
    middle = middle + (0 if offset is None else offset * period)
    lens_px = float(np.abs(steps).max(axis=1).min())
    blur_px2, extent = 0.0, _LEAST_EXTENT
    for _ in range(2):
        pixel, panel_px, square_px2 = _inside(
            label, panel, regions.number[lens_regions], centre, middle, steps * extent, period
        )
        blur_px2 = _blur(decoded.waves, index, centre, panel_px, period, extent)
        sigma_px = np.sqrt(max(blur_px2, 0.0))
        margin = _SEAM_SIGMAS * sigma_px / lens_px
        extent = float(np.clip(0.5 - margin, _LEAST_EXTENT, _MOST_EXTENT))
    if sigma_px > _MOST_BLUR * lens_px:
        raise FileError(
            f"{name}: blurred by {sigma_px:.1f} pixels, with lenses of {lens_px:.0f} pixels; focus "
            "on the lens sheet, hold the camera still, move closer"
        )
    # From the panel's left and top edge; the green sub-pixel may be off the pixel's middle.
    green = float(SUBPIXELS[display.subpixels][1].right)
    origin = np.array([columns / 2 + green, rows / 2])
    return Lenses(
        index,
        centre,
        _whole(index, regions.area[lens_regions]),
        middle + origin,
        0 * period if offset is not None else period,
        blur_px2,
        square_px2,
        decoded.motion_px,
        pixel,
        panel_px + origin,
        label.shape,
    )


def _nearest(difference: np.ndarray, period: np.ndarray) -> np.ndarray:
    """Differences of panel coordinates modulo a period, the least ones."""
    least: np.ndarray = difference - period * np.rint(difference / period)
    return least


class _Regions(NamedTuple):
    number: np.ndarray
    area: np.ndarray
    centre: np.ndarray
    panel: np.ndarray
    marked: np.ndarray


def _regions(panel: np.ndarray, step: np.ndarray, period: np.ndarray) -> np.ndarray:
    """Number of each pixel's smooth region, from 1; 0 if not decoded."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    is_decoded = np.isfinite(panel).all(axis=-1)

    def joined(a: Any, b: Any) -> np.ndarray:
        with np.errstate(invalid="ignore"):
            jump = np.abs(_nearest(panel[a] - panel[b], period.astype(np.float32)))
            near: np.ndarray = (jump < _SAME_LENS * step).all(axis=-1)
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


def _lens_regions(
    label: np.ndarray, panel: np.ndarray, marked: np.ndarray, step: np.ndarray, period: np.ndarray
) -> _Regions:
    """Regions that may be lenses: neither splinters nor the bare panel."""
    rows, columns = np.nonzero(label)
    number = label[rows, columns]
    area = np.bincount(number)
    safe = np.maximum(area, 1)

    def mean(values: np.ndarray) -> np.ndarray:
        total: np.ndarray = np.bincount(number, values, area.size) / safe
        return total

    panel_px = panel[rows, columns]
    first = np.zeros((area.size, 2))
    first[number[::-1]] = panel_px[::-1]
    from_first = _nearest(panel_px - first[number], period)
    middle = np.stack([mean(from_first[:, 0]), mean(from_first[:, 1])], axis=-1)
    square = np.stack([mean((from_first[:, k] - middle[number, k]) ** 2) for k in (0, 1)], axis=-1)
    centre = np.stack([mean(columns + 0.5), mean(rows + 0.5)], axis=-1)
    large = area >= _LEAST_PIXELS
    flat = (square < (_SAME_LENS * step) ** 2).all(axis=-1)
    is_lens = large & flat
    if is_lens.any():  # the area that most of the picture is made of: splinters may be many
        sizes = np.sort(area[is_lens])
        usual = sizes[np.searchsorted(np.cumsum(sizes), sizes.sum() / 2)]
        is_lens &= area >= _SPLINTER * usual
    chosen = np.flatnonzero(is_lens)
    share = mean(marked[rows, columns])
    return _Regions(
        chosen, area[chosen], centre[chosen], (first + middle)[chosen], share[chosen] > 0.5
    )


def _walk(
    regions: _Regions, step: np.ndarray, period: np.ndarray, name: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Regions that are lenses, their indices and panel points, and the lattice steps in pixels."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import breadth_first_order, connected_components

    count = len(regions.number)
    if count < _LEAST_LENSES:
        raise _no_lattice(name, count)
    a, b, jump = _neighbours(regions, step, period)
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
    index, panel = np.zeros((count, 2), int), regions.panel.copy()
    for region in order[1:]:
        other = before[region]
        vote = jumps.get((other, region))
        index[region] = index[other] + (vote if vote is not None else -jumps[(region, other)])
        panel[region] = panel[other] + _nearest(panel[region] - panel[other], period)
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
    return lens_regions, index[lens_regions], panel[lens_regions], moved


def _neighbours(
    regions: _Regions, step: np.ndarray, period: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of lenses a pitch apart, and the step from the first to the second: right or down."""
    from scipy.spatial import cKDTree

    tree = cKDTree(regions.centre)
    spacing = np.median(tree.query(regions.centre, k=2)[0][:, 1])
    pairs = tree.query_pairs(_REACH * spacing, output_type="ndarray")
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    a, b = pairs[:, 0], pairs[:, 1]
    pitches = _nearest(regions.panel[b] - regions.panel[a], period) / step
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


def check_marks(is_wrong: bool, display: Display, name: str) -> None:
    """Raise `FileError` for photographs whose marks are not those of the display."""
    if is_wrong:
        raise FileError(
            f"{name}: the marks of the white pattern are not those of display {display.name}; give "
            "the display whose patterns were shown, and photograph them in order"
        )


def period_numbers(
    middle: np.ndarray, marked: np.ndarray, display: Display
) -> tuple[np.ndarray | None, bool]:
    """Periods to add to panel points so that lenses with marks see the panel's marks.

    None without a numbering that is much better than all others; True if none fits.
    """
    period, (rows, columns) = periods_px(display), display.eia_shape
    cell = np.rint(middle / period)
    inside = (np.abs(middle / period - cell) < _MIDDLE).all(axis=-1)
    cell, marked = cell[inside], marked[inside]
    if not marked.any():
        return None, True
    last = np.ceil(np.array([columns, rows]) / period / 2)
    x, y = (
        np.arange(-n - low, n + 1 - high)
        for n, low, high in zip(last, cell.min(axis=0), cell.max(axis=0), strict=True)
    )
    if not (x.size and y.size):
        return None, True
    x, y = (axis.ravel() for axis in np.meshgrid(x, y))
    at = cell[:, 0] + x[:, None], cell[:, 1] + y[:, None]
    expected = has_mark(*at, period, marks_begin(display))
    wrong = (expected != marked).sum(axis=1)
    best, second = np.argsort(wrong, kind="stable")[[0, min(1, len(wrong) - 1)]]
    is_clear = best == second or wrong[second] - wrong[best] >= _LEAST_MARGIN
    is_contradicted = bool(wrong[best] > _MOST_CONTRADICTIONS * marked.sum())
    if is_contradicted or not is_clear:
        return None, is_contradicted
    return np.array([x[best], y[best]]), False


def _blur(
    waves: np.ndarray,
    index: np.ndarray,
    centre: np.ndarray,
    panel_px: np.ndarray,
    period: np.ndarray,
    extent: float,
) -> float:
    """Variance of the blur, from the transitions between adjacent lenses."""
    table = np.full(index.max(axis=0) - index.min(axis=0) + 2, -1)
    table[tuple((index - index.min(axis=0)).T)] = np.arange(len(index))
    around = panel_px.reshape(len(index), 2, 2, 2)
    moments = []
    for axis, wave in enumerate(waves):
        pair = index - index.min(axis=0) + np.eye(2, dtype=int)[axis]
        second = table[tuple(pair.T)]
        first = np.flatnonzero(second >= 0)
        second = second[first]
        begin, way = centre[first], centre[second] - centre[first]
        length = np.sqrt((way**2).sum(axis=-1, keepdims=True))
        samples = int(_SAMPLES_PER_PX * length.max())
        places = 0.5 + np.linspace(-_TRANSITION, _TRANSITION, samples)
        pixel = np.floor(begin[:, None] + places[:, None] * way[:, None]).astype(int)
        pixel = np.clip(pixel, 0, np.array(wave.shape[::-1]) - 1)
        along = ((pixel + 0.5 - begin[:, None]) * way[:, None]).sum(axis=-1) / length
        # Within a lens the phase changes evenly.
        side = np.take(around, [0, -1], axis=2 - axis)[..., axis]
        slope = float(np.nanmedian(np.diff(side, axis=2 - axis)))
        turn = 2j * np.pi / period[axis] * slope / extent / length
        at = np.floor(centre).astype(int)
        value = wave[at[:, 1], at[:, 0]][:, None]
        begin_wave = value[first] * np.exp(turn * along)
        end_wave = value[second] * np.exp(turn * (along - length))
        change = end_wave - begin_wave
        here = wave[pixel[..., 1], pixel[..., 0]]
        share = ((here - begin_wave) * change.conj()).real / np.abs(change) ** 2
        off = along - length / 2
        width = 2 * _TRANSITION * length / samples
        rest = (off > 0) - share
        moments.append(
            2 * np.median((off * rest * width).sum(axis=-1))
            - np.median((rest * width).sum(axis=-1)) ** 2
        )
    return float(np.mean(moments))


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
    label: np.ndarray,
    panel: np.ndarray,
    number: np.ndarray,
    centre: np.ndarray,
    middle: np.ndarray,
    steps: np.ndarray,
    period: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Camera pixels well inside each lens, and the panel coordinates that they see.

    These are means over small squares, which add to the blur: the last value is their variance.
    """
    target_px = centre[:, None] + _PLACES @ steps
    column, row = np.floor(target_px).astype(int).transpose(2, 0, 1)
    height, width = label.shape
    half = int(np.abs(steps).max(axis=1).min() / 2)
    total, count = np.zeros((*row.shape, 2)), np.zeros((*row.shape, 1), int)
    for down in range(-half, half + 1):
        for across in range(-half, half + 1):
            y, x = np.clip(row + down, 0, height - 1), np.clip(column + across, 0, width - 1)
            is_inside = (label[y, x] == number[:, None])[..., None]
            off = _nearest(panel[y, x] - middle[:, None], period)
            total += np.where(is_inside, off, 0)
            count += is_inside
    blur_px2 = ((2 * half + 1) ** 2 - 1) / 12
    is_full = count >= _FULL_SQUARE * (2 * half + 1) ** 2
    panel_px = middle[:, None] + np.where(is_full, total / np.maximum(count, 1), np.nan)
    return np.stack([column, row], axis=-1) + 0.5, panel_px, blur_px2


def _no_lattice(name: str, count: int) -> FileError:
    return FileError(
        f"{name}: no lattice of lenses in these photographs ({count} lenses at a distance of one "
        "pitch); check that they show this display, sharp, with at least 6 pixels per lens; give "
        "the display with --display, or move closer"
    )
