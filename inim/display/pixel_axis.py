"""The pixels of a panel along one axis, exactly: positions, lenses, directions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

__all__ = ["PixelAxis", "pixel_axis", "stated"]

# Beyond this a float says more than a person states: 7 digits after the point, or 1/999983.
_LARGEST_DENOMINATOR = 10**6


def stated(value: float) -> Fraction:
    """The length a person meant: the simplest fraction that rounds to this float.

    0.0636 stands for 636/10000 and 1/17 for a seventeenth, not for the binary fractions beside
    them. Sums of such lengths are then exact, and equal directions come out equal to the bit.
    """
    mantissa, exponent = math.frexp(value)  # so that doubling a length doubles its fraction
    simple = Fraction(mantissa).limit_denominator(_LARGEST_DENOMINATOR)
    exact = simple if float(simple) == mantissa else Fraction(mantissa)
    return exact * Fraction(2) ** exponent


@dataclass(frozen=True)
class PixelAxis:
    """One axis of the panel: where each pixel is, which lens it lies under, where its ray goes.

    Rays of a square lattice that is neither turned nor tilted are separable, so such a display is
    two of these; `inim.display.pixel_rays` is for the others. Pixel `i` sends its chief ray along
    ``X(z) = centre_mm[i] + slope[i] z`` (Eq. 1).

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
    """

    position_mm: np.ndarray
    lens: np.ndarray
    centre_mm: np.ndarray
    slope: np.ndarray
    centre: tuple[int, ...]
    offset: tuple[int, ...]
    step: int
    unit_mm: Fraction

    def moved_offset(self, pixels: Fraction) -> tuple[int, ...]:
        """Offsets of points moved inside their pixels, in ``unit_mm / pixels.denominator``.

        Each keeps its pixel's lens: the pixel's whole area shines through it.
        """
        fold, by = pixels.denominator, pixels.numerator * self.step
        return tuple(fold * offset - by for offset in self.offset)


def pixel_axis(
    pixels: int,
    lenses: int,
    sign: int,
    *,
    pixel: Fraction,
    pitch: Fraction,
    elemental: Fraction,
    gap: Fraction,
    shift: Fraction = Fraction(0),
) -> PixelAxis:
    """Address pixels by position: a running ``int(P / P_D)`` would drift over the array.

    In whole numbers of a common unit, so that nothing is rounded before the last division and the
    two halves of the panel mirror each other bit for bit (all but a pixel on the axis that lies on
    a border between lenses: it has to go one way).

    Parameters
    ----------
    pixels, lenses : int
        Of the panel, centred on the axis, and of the array, centred at `shift`.
    sign : {+1, -1}
        Whether positions ascend with the index, as columns do, or descend, as rows do.
    pixel, pitch, elemental, gap : Fraction
        P_D, P, the elemental images' pitch and g in millimetres.
    shift : Fraction
        Where the array's centre lies on the display axis: lenses and elemental images move with it.
    """
    # In halves, as centres lie at half-integers: position = (2 i - n + 1) pixel / 2.
    lengths = (pixel / 2, pitch / 2, elemental, shift)
    unit = _common_measure(lengths)
    half_pixel, half_pitch, cell, aside = (int(length / unit) for length in lengths)
    place = [(2 * i - pixels + 1) * half_pixel for i in range(pixels)]
    # Beside the array the lattice is carried on, so that every pixel has a ray.
    lattice = [_cell_of(x - sign * aside, cell, lenses) for x in place]
    centre = tuple(sign * (2 * n - lenses + 1) * half_pitch + aside for n in lattice)
    offset = tuple(c - sign * x for c, x in zip(centre, place, strict=True))
    return PixelAxis(
        position_mm=np.array([_ratio(sign * x, unit) for x in place]),
        lens=np.array([n if 0 <= n < lenses else -1 for n in lattice], np.int64),
        centre_mm=np.array([_ratio(c, unit) for c in centre]),
        slope=np.array([_ratio(o, unit / gap) for o in offset]),
        centre=centre,
        offset=offset,
        step=2 * sign * half_pixel,
        unit_mm=unit,
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


def _ratio(count: int, unit: Fraction) -> float:
    """A count of units as the nearest float: Python divides integers with one rounding."""
    return count * unit.numerator / unit.denominator
