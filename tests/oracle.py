"""Oracle of the source map in rational numbers: the picture pixel that each panel pixel shows.

It is written from the definition of the `template` generator, and shares neither code nor method
with it. Nothing is rounded, and the definition decides ties. Each axis is divided into runs: the
depths that a ray spends in one column, or in one row. The cells of a ray are the intersections of
its column runs and its row runs. It checks `inim.generators.oracle`, which scores users'
algorithms; it is written separately and by another method, including `exact_length` and the rays.

Lengths: a panel pitch of ``1 / 17`` or ``0.0636`` means that number, not the binary fraction next
to it. `exact_length` finds the simplest fraction that rounds to the float, `length_of` the simplest
multiple of the pitch or the pixel. Depths are measurements: a float32 depth has exactly its binary
value.

Conventions: a cell counts if the ray spends an interval of depth in it, not if it touches it in one
point. This also holds for the ends of the ray at z_max and z_min. A panel pixel centred exactly
between two elemental images belongs to the one nearer the axis, and on the axis to the left or
upper one.
"""

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import partial

import numpy as np

from inim.display import Display
from inim.image.rgbd import RGBD, LayeredRGBD

HOLE = -1
NO_LENS = -2


def exact_length(value: float) -> Fraction:
    """Simplest fraction that rounds to this float, in any unit."""
    mantissa, power = math.frexp(value)
    simple = Fraction(mantissa).limit_denominator(10**6)
    exact = simple if float(simple) == mantissa else Fraction(mantissa)
    return exact * Fraction(2) ** power


def length_of(display: Display, value: float) -> Fraction:
    """Length of a display or its picture, as a number of lens pitches or panel pixels if simple.

    A length may be a product or a quotient of others, each of which is rounded: it is a simple
    multiple of another if it is within 8 ulp of one.
    """
    length, pitch = exact_length(value), exact_length(display.pitch_mm)
    pixel = exact_length(display.pixel_pitch_mm)
    pixel = pitch * _near(pixel / pitch)
    for unit in (pitch, pixel):
        if _near(length / unit) != length / unit:
            return unit * _near(length / unit)
    return length


def _near(ratio: Fraction) -> Fraction:
    """Fraction below a denominator of a million within 8 ulp of a ratio, or the ratio."""
    # Counted in powers of two, as the floats are.
    power = Fraction(2) ** (ratio.numerator.bit_length() - ratio.denominator.bit_length())
    simple = (ratio / power).limit_denominator(10**6) * power
    return simple if abs(simple - ratio) * 2**52 <= 8 * abs(ratio) else ratio


@dataclass(frozen=True)
class Rays:
    """Rays of one axis, in cells of the picture: ``cell(z) = start + slope z``, lens -1: none."""

    lens: list[int]
    start: list[Fraction]
    slope: list[Fraction]


def panel_pixels(display: Display) -> tuple[int, int]:
    """Rows and columns of the panel; by default the fewest that cover the elemental images."""
    down, across = (
        _near(elemental / length_of(display, display.pixel_pitch_mm))
        for elemental in _elemental(display)
    )
    return (
        display.panel_rows or math.ceil(display.lens_rows * down),
        display.panel_columns or math.ceil(display.lens_columns * across),
    )


def _elemental(display: Display) -> tuple[Fraction, Fraction]:
    """Pitch of the elemental images, down and across."""
    pitch, elemental = length_of(display, display.pitch_mm), display.elemental_pitch_mm
    across = pitch if elemental is None else length_of(display, elemental)
    rows = pitch if display.pitch_y_mm is None else length_of(display, display.pitch_y_mm)
    return across * rows / pitch, across


def lens_of_pixel(
    pixel: int, pixels: int, lenses: int, ratio: Fraction, moved: Fraction = Fraction(0)
) -> int:
    """Lens over a pixel of an axis of `pixels` pixels, with `ratio` pixels per lens; -1 outside.

    `moved` is the shift of the array from the panel's middle, in pixels.
    """
    from_axis = (Fraction(pixel) - Fraction(pixels - 1, 2) - moved) / ratio
    place = from_axis + Fraction(lenses, 2)
    lens = math.floor(place)
    if place == lens and from_axis >= 0:  # on a border: to the axis side
        lens -= 1
    return lens if 0 <= lens < lenses else -1


def all_rays(rgbd: RGBD, display: Display) -> tuple[Rays, Rays]:
    """Rays of the panel's rows, downwards, and of its columns, to the right."""
    exact = partial(length_of, display)
    gap, cell = exact(display.gap_mm), exact(rgbd.pixel_mm)
    pixel_pitch, across = exact(display.pixel_pitch_mm), exact(display.pitch_mm)
    down = across if display.pitch_y_mm is None else exact(display.pitch_y_mm)
    axes = []
    for pixels, lenses, cells, pitch, elemental, shift in zip(
        panel_pixels(display), (display.lens_rows, display.lens_columns), rgbd.shape,
        (down, across), _elemental(display),
        (-exact(display.shift_y_mm), exact(display.shift_x_mm)), strict=True,
    ):  # fmt: skip
        lens, start, slope = [], [], []
        for i in range(pixels):
            moved = shift / pixel_pitch
            n = lens_of_pixel(i, pixels, lenses, elemental / pixel_pitch, moved)
            x = (i - Fraction(pixels - 1, 2)) * pixel_pitch
            x0 = (n - Fraction(lenses - 1, 2)) * pitch + shift
            lens.append(n)
            start.append(x0 / cell + Fraction(cells, 2))
            slope.append((x0 - x) / gap / cell)
        axes.append(Rays(lens, start, slope))
    return axes[0], axes[1]


def depth_range(display: Display) -> tuple[Fraction, Fraction]:
    """Exact lengths of z_min and z_max."""
    low, high = display.depth_range_mm
    return length_of(display, low), length_of(display, high)


# -- exact --------------------------------------------------------------------------------------


def runs(
    start: Fraction, slope: Fraction, low: Fraction, high: Fraction
) -> list[tuple[Fraction, int]]:
    """Cells of a ray on one axis, from `high` down, each with the depth at which the ray leaves."""
    at_high, at_low = start + slope * high, start + slope * low
    left, right = min(at_high, at_low), max(at_high, at_low)
    borders = range(math.floor(left) + 1, math.ceil(right))  # strictly between the two ends
    ends = [*sorted(((k - start) / slope for k in borders), reverse=True), low]
    cells, top = [], high
    for end in ends:
        cells.append((end, math.floor(start + slope * (top + end) / 2)))
        top = end
    return cells


def column_ends(rgbd: RGBD, columns: str) -> tuple[list[tuple[np.ndarray, np.ndarray]], bool]:
    """Fronts and backs of each layer, NaN without one; True if hidden surfaces continue."""
    if columns == "layers" and isinstance(rgbd, LayeredRGBD):
        layers = [(layer.front_mm, layer.back_mm, layer.covered) for layer in rgbd.layers]
        return [(np.where(c, f, np.nan), np.where(c, b, np.nan)) for f, b, c in layers], False
    front = np.where(rgbd.covered, rgbd.depth_mm, np.float32(np.nan))
    back = np.full(rgbd.shape, -np.inf, np.float32)
    if columns != "solid":
        for i, j in zip(*np.nonzero(rgbd.covered), strict=True):
            back[i, j] = _surface_back(front, int(i), int(j), rgbd.pixel_mm)
    return [(front, back)], columns != "solid"


def _surface_back(front: np.ndarray, i: int, j: int, pixel_mm: float) -> np.float32:
    """Depth ten pixels behind the front, or the lowest connected neighbour; in float32."""
    here = front[i, j]
    low = here - np.float32(10 * pixel_mm)
    for p in range(max(i - 1, 0), min(i + 2, front.shape[0])):
        for q in range(max(j - 1, 0), min(j + 2, front.shape[1])):
            steepest = 20 * pixel_mm * (math.sqrt(2) if p != i and q != j else 1.0)
            if here - front[p, q] <= np.float32(steepest):
                low = min(low, front[p, q])
    return low


def exact_sources(rgbd: RGBD, display: Display, columns: str = "surface") -> np.ndarray:
    """Source map in rational arithmetic, for the columns of `template` and `layered`."""
    low, high = depth_range(display)
    row_rays, column_rays = all_rays(rgbd, display)
    row_runs = [runs(s, d, low, high) for s, d in zip(row_rays.start, row_rays.slope, strict=True)]
    column_runs = [
        runs(s, d, low, high) for s, d in zip(column_rays.start, column_rays.slope, strict=True)
    ]
    # Integers compare faster: depths in units of 1 / scale.
    scale = math.lcm(*{end.denominator for r in row_runs + column_runs for end, _ in r})
    row_runs = [[(int(end * scale), cell) for end, cell in r] for r in row_runs]
    column_runs = [[(int(end * scale), cell) for end, cell in r] for r in column_runs]
    layers, continues = column_ends(rgbd, columns)
    solids = [_whole(front, back, scale) for front, back in layers]
    sources = np.full((len(row_runs), len(column_runs)), NO_LENS, np.int32)
    for i, by_row in enumerate(row_runs):
        for j, by_column in enumerate(column_runs):
            if row_rays.lens[i] >= 0 and column_rays.lens[j] >= 0:
                sources[i, j] = _first_cell(by_row, by_column, solids, rgbd.shape, continues)
    return sources


_Solids = dict[tuple[int, int], tuple[int, float]]


def _whole(front: np.ndarray, back: np.ndarray, scale: int) -> _Solids:
    """Front and back of each covered cell, in units of 1 / scale.

    For an integer `end`, depth >= end is equivalent to floor(depth) >= end. For an integer `entry`,
    depth <= entry is equivalent to ceil(depth) <= entry.
    """
    return {
        (int(r), int(c)): (
            math.floor(Fraction(float(front[r, c])) * scale),
            float(back[r, c])
            if np.isinf(back[r, c])
            else math.ceil(Fraction(float(back[r, c])) * scale),
        )
        for r, c in np.argwhere(~np.isnan(front))
    }


def _first_cell(
    by_row: list[tuple[int, int]],
    by_column: list[tuple[int, int]],
    solids: list[_Solids],
    shape: tuple[int, int],
    continues: bool,
) -> int:
    """Source of a ray: the first hit among the overlaps of its row runs and column runs."""
    (high, wide), a, b, entry = shape, 0, 0, math.inf
    last, hidden = HOLE, False
    while a < len(by_row) and b < len(by_column):
        row_end, row = by_row[a]
        column_end, column = by_column[b]
        end = max(row_end, column_end)
        for number, solid in enumerate(solids):
            front, back = solid.get((row, column), (-math.inf, math.inf))
            if front >= end and back <= entry:
                return (number * high + row) * wide + column
        if (row, column) in solids[0] and solids[0][row, column][0] >= end:
            hidden = True
        elif 0 <= row < high and 0 <= column < wide:
            last = row * wide + column if (row, column) in solids[0] else HOLE
        a += row_end == end
        b += column_end == end
        entry = end
    return last if hidden and continues else HOLE
