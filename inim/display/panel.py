"""What of a panel's pixel shines in which colour."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

__all__ = ["SUBPIXELS", "SubPixel", "shining"]


@dataclass(frozen=True)
class SubPixel:
    """Where one colour of a pixel shines.

    Attributes
    ----------
    right : Fraction
        Its centre, to the right of the pixel's, in pixels.
    width : Fraction
        In pixels; its height is the pixel's.
    turn : {0, 1}, optional
        Only pixels whose row and column, counted from the top left, add up to an even (0) or odd
        (1) number have it; all have if None.
    """

    right: Fraction
    width: Fraction
    turn: int | None = None

    @property
    def share(self) -> Fraction:
        """Its part of the panel's area."""
        return self.width if self.turn is None else self.width / 2


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
}


def shining(subpixel: SubPixel, fill: Any, where: Any, right: Any, down: Any, turn: Any) -> Any:
    """Radiance of a point of a pixel at full drive, as a multiple of the panel's mean.

    Parameters
    ----------
    subpixel : SubPixel
    fill : float
        `Display.pixel_fill`.
    where : callable
        NumPy's `where` or Dr.Jit's `select`.
    right, down : array of float
        Place inside the pixel, from its centre, in pixels: -1/2 .. 1/2.
    turn : array
        (row + column) modulo 2 of the pixel, counted from the top left.

    Returns
    -------
    array of float
        0 where nothing shines. Its mean over the panel is 1: drive 1 in all colours is white.
    """
    aside, half = right - float(subpixel.right), float(subpixel.width) / 2 * fill
    shines = (aside < half) & (aside >= -half) & (down < fill / 2) & (down >= -fill / 2)
    if subpixel.turn is not None:
        shines &= turn == subpixel.turn
    return where(shines, 1.0 / (float(subpixel.share) * fill * fill), 0.0)
