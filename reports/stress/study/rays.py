"""The rays that oracles judge by: of every panel pixel, from the definition alone.

Where rows and columns of a panel are independent they are fractions, and nothing is rounded. What
a length means (0.0636 is 636/10000) is part of the definition: `pixel_axis.stated`. Those of
arrays that are hexagonal, turned or tilted are made in `inim.stress.free_rays`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from fractions import Fraction

import numpy as np

from inim.display import Display
from inim.display.pixel_axis import stated
from inim.rgbd import RGBD

__all__ = ["CENTRE", "Aside", "AxisRays", "Line", "Rays", "band_of", "lensed_pixels", "rays_of"]

# Rounding errors a coordinate collects on its way: of start, slope, depth, product and sum.
_ROUNDINGS = 4

#: Where in its pixel a ray starts: (down, right) of the centre, in pixels.
Aside = tuple[Fraction, Fraction]
CENTRE: Aside = (Fraction(0), Fraction(0))
#: Row and column ``v0 + dv z, u0 + du z`` of a ray: v0, dv, u0, du.
Line = tuple[Fraction, Fraction, Fraction, Fraction]


@dataclass(frozen=True)
class AxisRays:
    """Rays of one panel axis: ``cell(z) = start + slope z`` in picture cells; lens -1: none."""

    lens: tuple[int, ...]
    start: tuple[Fraction, ...]
    slope: tuple[Fraction, ...]


@dataclass(frozen=True)
class Rays:
    """Rays of some panel pixels over a picture.

    Attributes
    ----------
    pixels : (n, 2) int
        Row and column of each.
    axes : (AxisRays, AxisRays), or None
        Of all panel rows and all columns, exactly; None: rays share nothing.
    v0, dv, u0, du : (n,) float64
        Row and column of the picture each pixel's ray is in: ``v0 + dv z``, ``u0 + du z``.
    slack_v, slack_u : (n,) float64
        How far, in cells, float64 may move the ray itself within the depth range; 0 where rays are
        whole numbers.
    doubtful : (n,) bool
        Whether rounding decides which lens the pixel belongs to.
    fine : (n, 4) long double, or None
        v0, dv, u0, du of rays that share nothing, as exactly as they are known.
    """

    pixels: np.ndarray
    axes: tuple[AxisRays, AxisRays] | None
    v0: np.ndarray
    dv: np.ndarray
    u0: np.ndarray
    du: np.ndarray
    slack_v: np.ndarray
    slack_u: np.ndarray
    doubtful: np.ndarray
    fine: np.ndarray | None = None

    @property
    def rows(self) -> AxisRays:
        """Of all panel rows."""
        assert self.axes is not None
        return self.axes[0]

    @property
    def columns(self) -> AxisRays:
        """Of all panel columns."""
        assert self.axes is not None
        return self.axes[1]

    def line(self, index: int) -> Line:
        """One ray in fractions."""
        if self.fine is not None:
            v0, dv, u0, du = (Fraction(*n.as_integer_ratio()) for n in self.fine[index])
            return v0, dv, u0, du
        row, column = self.pixels[index]
        rows, columns = self.rows, self.columns
        return rows.start[row], rows.slope[row], columns.start[column], columns.slope[column]

    def chosen(self, kept: np.ndarray) -> Rays:
        """Some of them, by their numbers."""
        each = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "axes"}
        return replace(self, **{k: v[kept] for k, v in each.items() if v is not None})


def lensed_pixels(display: Display) -> np.ndarray:
    """Row and column of every panel pixel under a lens, (n, 2); of a separable display."""
    rows, columns = display.eia_shape
    down = np.array(_lenses(display, rows, display.lens_rows, -display.shift_y_mm)) >= 0
    across = np.array(_lenses(display, columns, display.lens_columns, display.shift_x_mm)) >= 0
    return np.argwhere(down[:, None] & across[None, :])


def _lenses(display: Display, pixels: int, lenses: int, shift_mm: float) -> list[int]:
    """Lens over each pixel of an axis: the elemental image that holds its centre, -1 outside.

    On a border: the one nearer the array's centre, and on that the left or upper one.
    """
    elemental = stated(display.elemental_image_pitch_mm)
    pixel, shift = stated(display.pixel_pitch_mm), stated(shift_mm)
    found = []
    for i in range(pixels):
        from_axis = (Fraction(2 * i + 1 - pixels, 2) * pixel - shift) / elemental
        place = from_axis + Fraction(lenses, 2)
        lens = math.floor(place)
        if lens == place and from_axis >= 0:
            lens -= 1
        found.append(lens if 0 <= lens < lenses else -1)
    return found


def _axis(
    display: Display,
    panel: tuple[int, int, float],
    cells: int,
    cell_mm: float,
    aside: Fraction,
) -> AxisRays:
    """Eq. 1, X(z) = x0 + (x0 - x) z / g, in cells; to the right or downwards alike.

    `panel` is the number of pixels, that of lenses, and the array's shift.
    """
    pixels, lenses, shift_mm = panel
    pitch, gap, cell = stated(display.pitch_mm), stated(display.gap_mm), stated(cell_mm)
    pixel, shift = stated(display.pixel_pitch_mm), stated(shift_mm)
    start, slope = [], []
    owners = _lenses(display, pixels, lenses, shift_mm)
    for i, owner in enumerate(owners):
        x = (Fraction(2 * i + 1 - pixels, 2) + aside) * pixel
        x0 = Fraction(2 * owner + 1 - lenses, 2) * pitch + shift
        start.append(x0 / cell + Fraction(cells, 2))
        slope.append((x0 - x) / (gap * cell))
    return AxisRays(tuple(owners), tuple(start), tuple(slope))


def rays_of(display: Display, rgbd: RGBD, pixels: np.ndarray, aside: Aside = CENTRE) -> Rays:
    """The rays of panel pixels, (n, 2) rows and columns, over a picture; of a separable display.

    A ray moved aside in its pixel keeps that pixel's lens.
    """
    high, wide = display.eia_shape
    across = (wide, display.lens_columns, display.shift_x_mm)
    downwards = (high, display.lens_rows, -display.shift_y_mm)
    rows = _axis(display, downwards, rgbd.shape[0], rgbd.pixel_mm, aside[0])
    columns = _axis(display, across, rgbd.shape[1], rgbd.pixel_mm, aside[1])
    v0, dv = np.array(rows.start, float), np.array(rows.slope, float)
    u0, du = np.array(columns.start, float), np.array(columns.slope, float)
    r, c = pixels[:, 0], pixels[:, 1]
    none = np.zeros(len(pixels))
    return Rays(
        pixels, (rows, columns), v0[r], dv[r], u0[c], du[c], none, none, np.zeros(len(pixels), bool)
    )


def band_of(rays: Rays, display: Display, dtype: type) -> tuple[np.ndarray, np.ndarray, float]:
    """How far rounding in a type may move columns, rows (cells) and depths (mm) of each ray."""
    farthest = max(map(abs, display.depth_range_mm))
    unit = _ROUNDINGS * float(np.finfo(dtype).eps)
    across = unit * (np.abs(rays.u0) + np.abs(rays.du) * farthest + 1) + rays.slack_u
    down = unit * (np.abs(rays.v0) + np.abs(rays.dv) * farthest + 1) + rays.slack_v
    return across, down, unit * farthest
