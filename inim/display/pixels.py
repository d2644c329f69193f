"""Pixels of a panel: emitting areas, lenses, and rays.

`PixelAxis` is one axis of the panel, exactly, for displays that are separable. `pixel_rays` takes
pixels one by one, in float64 from their positions: where the layout has no rows and columns, or the
array is turned or tilted against its panel, a pixel's lens does not follow from its row and column
apart. Where the lenses are, `inim.display.layouts` tells.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from inim.display.cells import cell_centres, cell_offsets, farthest_cell
from inim.system.errors import DisplayError
from inim.system.row_bands import row_bands

if TYPE_CHECKING:
    from inim.display.display import Display

MM_PER_INCH = 25.4


@dataclass(frozen=True)
class SubPixel:
    """Emitting area of one colour in a pixel."""

    right: Fraction  #: Its centre, to the right of the pixel's, in pixels.
    width: Fraction  #: In pixels.
    #: {0, 1}, optional: only pixels whose row and column, counted from the top left, add up to an
    #: even (0) or odd (1) number have it; all have if None.
    turn: int | None = None
    height: Fraction = Fraction(1)  #: In pixels.
    #: Colour of `Display.subpixel_cells`, whose centre differs between pixels.
    channel: int | None = None

    @property
    def share(self) -> Fraction:
        """Its part of the panel's area."""
        area = self.width * self.height
        return area if self.turn is None else area / 2


class PixelOffset(NamedTuple):
    """Point of every pixel from which a ray starts, from its centre, in pixels.

    * `channel`: colour of `Display.subpixel_cells` from whose centre it counts instead.
    """

    down: Fraction
    right: Fraction
    channel: int | None = None


CENTRE = PixelOffset(Fraction(0), Fraction(0))


_THIRD, _QUARTER, _HALF = Fraction(1, 3), Fraction(1, 4), Fraction(1, 2)

#: Red, green and blue of each `Display.subpixels`.
SUBPIXELS: dict[str, tuple[SubPixel, SubPixel, SubPixel]] = {
    "none": (SubPixel(Fraction(0), Fraction(1)),) * 3,
    "rgb-stripe": (
        SubPixel(-_THIRD, _THIRD),
        SubPixel(Fraction(0), _THIRD),
        SubPixel(_THIRD, _THIRD),
    ),
    "pentile": (
        SubPixel(-_QUARTER, _HALF, turn=0),
        SubPixel(_QUARTER, _HALF),
        SubPixel(-_QUARTER, _HALF, turn=1),
    ),
    # Calibration files have no areas: a sixth of the pixel is assumed.
    "cells": (
        SubPixel(Fraction(0), _THIRD, height=_HALF, channel=0),
        SubPixel(Fraction(0), _THIRD, height=_HALF, channel=1),
        SubPixel(Fraction(0), _THIRD, height=_HALF, channel=2),
    ),
}


def farthest_subpixel(display: Display) -> tuple[float, float]:
    """Largest distances of a colour's centre from its pixel's, across and up, in pixels."""
    centres = [abs(float(colour.right)) for colour in SUBPIXELS[display.subpixels]]
    across, up = farthest_cell(display)
    return max(*centres, across), up


def emission_profile(
    subpixel: SubPixel, fill: Any, select: Any, right: Any, down: Any, turn: Any
) -> Any:
    """Radiance of a point of a pixel at full drive, as a multiple of the panel's mean.

    * `fill`: `Display.pixel_fill`.
    * `select`: NumPy's `where` or Dr.Jit's `select`.
    * `right`, `down`, array of float: position inside the pixel, from its centre, in pixels: -1/2
      .. 1/2.
    * `turn`: (row + column) modulo 2 of the pixel, counted from the top left.

    Returns array of float: 0 outside the emitting area. Its mean over the panel is 1: drive 1 in
    all colours is white.
    """
    pixel_offset, half = right - float(subpixel.right), float(subpixel.width) / 2 * fill
    high = float(subpixel.height) / 2 * fill
    shines = (pixel_offset < half) & (pixel_offset >= -half) & (down < high) & (down >= -high)
    if subpixel.turn is not None:
        shines &= turn == subpixel.turn
    return select(shines, 1.0 / (float(subpixel.share) * fill * fill), 0.0)


class PanelPoints(NamedTuple):
    """Pixels and sub-pixels under panel points, arrays of the points' shape."""

    row: np.ndarray  #: int64; 0 beside the panel.
    column: np.ndarray  #: int64; 0 beside the panel.
    #: Of red, green and blue, float64: see `emission_profile`; 0 beside the panel.
    shines: list[np.ndarray]
    #: Of each, float64: centre of the sub-pixel across the array, array frame, mm.
    across_mm: list[np.ndarray]


def panel_points(display: Display, x_mm: np.ndarray, y_mm: np.ndarray) -> PanelPoints:
    """Pixels and sub-pixels under points of the panel, display frame."""
    (rows, columns), pitch, (c, s) = display.eia_shape, display.pixel_pitch_mm, _turn(display)
    # Positions in pixels, from the panel's upper left corner.
    across, along = x_mm / pitch + columns / 2, rows / 2 - y_mm / pitch
    on_panel = (across >= 0) & (across < columns) & (along >= 0) & (along < rows)
    column, row = (
        np.where(on_panel, np.floor(place), 0).astype(np.int64) for place in (across, along)
    )
    light, places = [], []
    for channel, subpixel in enumerate(SUBPIXELS[display.subpixels]):
        right, up = np.zeros((2, *column.shape))
        if subpixel.channel is not None:
            right, up = cell_offsets(display, column, rows - 1 - row, channel)
        shines = emission_profile(
            subpixel, display.pixel_fill, np.where, across - column - 0.5 - right,
            along - row - 0.5 + up, (row + column) % 2,
        )  # fmt: skip
        x = (column + 0.5 - columns / 2 + right + float(subpixel.right)) * pitch
        y = (rows / 2 - row - 0.5 + up) * pitch
        light.append(np.where(on_panel, shines, 0.0))
        places.append(c * (x - display.shift_x_mm) + s * (y - display.shift_y_mm))
    return PanelPoints(row, column, light, places)


# Beyond this a float says more than a person states: 7 digits after the point, or 1/999983.
_LARGEST_DENOMINATOR = 10**6


# Relative error of the ratio of two lengths that each took up to seven roundings of 2^-53, such as
# a decimal that was divided and scaled; the ratio may be rounded twice itself. It is 8 ulp of 1.
# Fractions of denominators up to the largest are 10^-12 apart: the nearest one is unambiguous.
RATIO_ERROR = 2.0**-49


def _simple(value: Fraction) -> Fraction:
    """Nearest fraction with a small denominator, except for powers of two."""
    # Powers of two apart: doubling a length doubles its fraction.
    power = Fraction(2) ** (value.numerator.bit_length() - value.denominator.bit_length())
    return (value / power).limit_denominator(_LARGEST_DENOMINATOR) * power


@lru_cache(1024)
def exact_length(value: float) -> Fraction:
    """The length a person meant: the simplest fraction that rounds to this float.

    0.0636 stands for 636/10000 and 1/17 for a seventeenth, not for the binary fractions near
    them. Sums of such lengths are then exact, and equal directions come out equal to the bit.
    """
    exact = Fraction(value)
    simple = _simple(exact)
    return simple if float(simple) == value else exact


@lru_cache(1024)
def exact_ratio(ratio: Fraction | float) -> Fraction:
    """The ratio of lengths a person meant: the simplest fraction within 8 ulp, if there is one.

    Every number of lenses, pixels or steps is derived from it: 0.3 / (0.3 / 3) is 3, in any unit.
    """
    exact = Fraction(ratio)
    simple = _simple(exact)
    return simple if abs(simple - exact) <= RATIO_ERROR * abs(exact) else exact


@lru_cache(1024)
def exact_multiple(value: float, *units: float) -> Fraction:
    """A length as `exact_length`, unless it is a simple multiple of one of the units.

    0.3 / 3 is a third of 0.3, although the float is not 0.1. A unit counts as a multiple of those
    before it.
    """
    exact = exact_length(value)
    for n, unit in enumerate(units):
        exact_unit = exact_multiple(unit, *units[:n])
        ratio = exact_ratio(exact / exact_unit)
        if ratio * exact_unit != exact:
            return ratio * exact_unit
    return exact


@dataclass(frozen=True)
class PixelAxis:
    """One axis of the panel: position, lens and ray of each pixel.

    A separable display is two of these; `pixel_rays` is for the others. Pixel `i` sends its chief
    ray along ``X(z) = centre_mm[i] + slope[i] z`` (Eq. 1).

    Attributes
    ----------
    position_mm : (n,) float64
        Pixel centres, ascending along the display axis for columns, descending for rows.
    lens : (n,) int64
        Index of the lens whose elemental image holds the pixel; -1 outside the array.
    centre_mm : (n,) float64
        Centre of that lens.
    slope : (n,) float64
        Lateral travel of the ray per millimetre towards the viewer, ``(x0 - x) / g``.
    centre, offset : tuple of int
        x0 and x0 - x exactly, in units of `unit_mm`: equal offsets are equal directions.
    step : int
        From one pixel to the next, in the same units; negative for rows.
    unit_mm : Fraction
    lenses : int
        Number of lenses along the axis.
    """

    position_mm: np.ndarray
    lens: np.ndarray
    centre_mm: np.ndarray
    slope: np.ndarray
    centre: tuple[int, ...]
    offset: tuple[int, ...]
    step: int
    unit_mm: Fraction
    lenses: int

    def moved_offset(self, pixels: Fraction) -> tuple[int, ...]:
        """Offsets of points moved inside their pixels, in ``unit_mm / pixels.denominator``.

        Each keeps its pixel's lens: the pixel's whole area shines through it.
        """
        fold, by = pixels.denominator, pixels.numerator * self.step
        return tuple(fold * offset - by for offset in self.offset)

    def elemental_images(self) -> tuple[np.ndarray, np.ndarray]:
        """First pixel of each lens, and the one after its last; equal where it has none."""
        # Lenses ascend along the panel; those beside it are -1.
        covered = np.flatnonzero(self.lens >= 0)
        start = covered[0] if len(covered) else 0
        order = self.lens[covered]
        first = np.searchsorted(order, np.arange(self.lenses), side="left") + start
        end = np.searchsorted(order, np.arange(self.lenses), side="right") + start
        return first.astype(np.int64), end.astype(np.int64)


def pixel_axis(display: Display, sign: int) -> PixelAxis:
    """Columns (`sign` +1) or rows (-1, as positions descend) of a panel's pixels.

    Pixels are addressed by position: a running ``int(P / P_D)`` would drift over the array.
    Positions are whole numbers of a common unit, so that only the last division rounds, and the two
    halves of the panel are mirror images bit for bit (except a pixel on the axis at a border
    between lenses, which must belong to one side).

    Raises `DisplayError`: the display is not separable, or no pixel is under a lens.
    """
    axis, gap = display.layout.axis(sign), display.exact_mm(display.gap_mm)
    # In halves, as centres lie at half-integers: position = (2 i - n + 1) pixel / 2.
    lengths = (axis.pixel / 2, axis.pitch / 2, axis.cell, axis.shift)
    unit = _common_measure(lengths)
    half_pixel, half_pitch, cell, shift = (int(length / unit) for length in lengths)
    pixels, lenses = axis.pixels, axis.lenses
    place = [(2 * i - pixels + 1) * half_pixel for i in range(pixels)]
    # Beside the array the layout is carried on, so that every pixel has a ray.
    cells = [_cell_of(x - shift, cell, lenses) for x in place]
    centre = tuple(sign * ((2 * n - lenses + 1) * half_pitch + shift) for n in cells)
    offset = tuple(c - sign * x for c, x in zip(centre, place, strict=True))
    lens = np.array([n if 0 <= n < lenses else -1 for n in cells], np.int64)
    if (lens < 0).all():
        name = "shift_x_mm" if sign > 0 else "shift_y_mm"
        raise DisplayError(
            f"{name} = {getattr(display, name):g}: the array is completely outside its panel; "
            "shift it less"
        )
    return PixelAxis(
        position_mm=np.array([_to_float(sign * x, unit) for x in place]),
        lens=lens,
        centre_mm=np.array([_to_float(c, unit) for c in centre]),
        slope=np.array([_to_float(o, unit / gap) for o in offset]),
        centre=centre,
        offset=offset,
        step=2 * sign * half_pixel,
        unit_mm=unit,
        lenses=lenses,
    )


def _cell_of(place: int, cell: int, cells: int) -> int:
    """The cell that holds a place, in a row of cells about 0, carried on to both sides.

    A place on the border of two belongs to the one nearer the array's centre; on the centre
    itself, to the left or upper one.
    """
    twice = 2 * place + cells * cell  # from the first cell's start, doubled
    index, rest = divmod(twice, 2 * cell)
    if rest == 0 and place >= 0:
        index -= 1
    return index


def _common_measure(lengths: tuple[Fraction, ...]) -> Fraction:
    """The largest length that divides all of them."""
    below = math.lcm(*(v.denominator for v in lengths))
    return Fraction(math.gcd(*(int(v * below) for v in lengths)), below)


def _to_float(count: int, unit: Fraction) -> float:
    """A count of units as the nearest float: Python divides integers with one rounding."""
    return count * unit.numerator / unit.denominator


# Pixels whose rays are made at once: a few arrays of them stay in a processor's cache.
_PIXELS_AT_ONCE = 2**16


@dataclass(frozen=True)
class PixelRays:
    """Lens and ray of every pixel of a block of panel rows, (rows, columns) each.

    A pixel's chief ray is ``(x0 + slope_x z, y0 + slope_y z)`` in the display frame, which is Eq. 1
    of Wang et al. 2024 with the pixel's own gap.
    """

    #: int64: ``row * columns + column`` of lenses, rows from the top; -1 outside the array, where
    #: the layout is carried on, so that every pixel has a ray.
    lens: np.ndarray
    #: float64: where the ray crosses the array's plane, the lens's centre, mm.
    x0: np.ndarray
    y0: np.ndarray
    #: float64: lateral travel per millimetre towards the viewer, ``(x0 - x) / gap_mm``.
    slope_x: np.ndarray
    slope_y: np.ndarray
    gap_mm: np.ndarray  #: float64: from the array down to the pixel.


def row_blocks(display: Display) -> Iterator[slice]:
    """The panel's rows, top to bottom, in blocks of bounded size if each pixel has its own ray."""
    if display.is_separable:
        return iter([slice(0, display.eia_shape[0])])
    return row_bands(*display.eia_shape, _PIXELS_AT_ONCE)


def pixel_rays(
    display: Display,
    rows: slice,
    pixel_offset: PixelOffset = CENTRE,
    columns: slice = slice(None),
) -> PixelRays:
    """Rays of a block of panel rows, or of some columns of it.

    A pixel belongs to the lens whose elemental-image cell contains its centre: cells of the layout
    at the elemental images' pitch, shifted and rotated with the array.

    Parameters
    ----------
    display : Display
    rows : slice
        Slice with start and stop, from `row_blocks`.
    pixel_offset : PixelOffset
    columns : slice

    Raises
    ------
    DisplayError
        The tilted panel meets the array.
    """
    least_gap_mm(display)
    x, y, centres, offset = ray_starts(display, rows, pixel_offset, columns)
    lens, across, along = display.layout.find_rays(*centres, offset)
    c, s = _turn(display)
    x0 = c * across - s * along + display.shift_x_mm
    y0 = c * along + s * across + display.shift_y_mm
    tilt_x, tilt_y = display.tilt_slopes
    gap = display.gap_mm + tilt_x * x + tilt_y * y
    return PixelRays(lens, x0, y0, (x0 - x) / gap, (y0 - y) / gap, gap)


def ray_starts(
    display: Display, rows: slice, pixel_offset: PixelOffset, columns: slice = slice(None)
) -> tuple[Any, Any, tuple[Any, Any], tuple[Any, Any]]:
    """Points of pixels from which rays start.

    Returns `x`, `y`: display frame; `centres`: of their pixels, array frame; `offset`: from these
    to the points, array frame. They broadcast to (rows, columns).
    """
    panel_rows, panel_columns = display.eia_shape
    pitch, (c, s) = display.pixel_pitch_mm, _turn(display)
    x = ((np.arange(panel_columns)[columns] - (panel_columns - 1) / 2) * pitch)[None, :]
    y = (((panel_rows - 1) / 2 - np.arange(rows.start, rows.stop)) * pitch)[:, None]
    from_x, from_y = x - display.shift_x_mm, y - display.shift_y_mm
    right: Any = float(pixel_offset.right) * pitch
    up: Any = -float(pixel_offset.down) * pitch
    if pixel_offset.channel is not None:
        cell_right, cell_up = cell_centres(display, rows, columns, pixel_offset.channel)
        right, up = right + cell_right * pitch, up + cell_up * pitch
    centres = c * from_x + s * from_y, c * from_y - s * from_x
    return x + right, y + up, centres, (c * right + s * up, c * up - s * right)


def _turn(display: Display) -> tuple[float, float]:
    """Cosine and sine of the array's rotation."""
    angle = math.radians(display.rotation_deg)
    return math.cos(angle), math.sin(angle)


def least_gap_mm(display: Display) -> float:
    """The smallest gap over the panel, where that is tilted.

    Raises `DisplayError`: the panel meets the array.
    """
    rows, columns = display.eia_shape
    slopes = [abs(slope) for slope in display.tilt_slopes]
    gap = display.gap_mm - (slopes[0] * columns + slopes[1] * rows) * display.pixel_pitch_mm / 2
    if gap <= 0:
        raise DisplayError(
            f"{display.not_separable_by}: the panel, tilted, meets the array (gap_mm = "
            f"{display.gap_mm:g}); tilt it less"
        )
    return gap
