"""From picture pixels to panel pixels: one axis of a forward mapping, prepared for its kernels."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from inim.display import Display
from inim.display.pixel_axis import PixelAxis, stated

__all__ = ["ForwardAxis", "forward_axes"]

# Whole numbers up to here are floats, and the quotient of two is rounded once.
_EXACT = 2**53


class ForwardAxis(NamedTuple):
    """One axis of the mapping, to the right for columns and downwards for rows.

    Through lens `n`, picture pixel `c` at depth z lands at the panel position, in panel pixels from
    the panel's middle,

        ``(lens_z[n] z + lens_g[n] - pixel_g[c]) / (unit z)``

    which is x = x0 + (x0 - X) g / z, Eq. 1 of Wang et al. 2024 solved for the panel. All are whole
    numbers wherever the display's lengths are short decimals or fractions: a position that is on a
    border between panel pixels is then known to be.

    Attributes
    ----------
    cells, pixels : int
        Pixels of the picture and of the panel.
    unit : float
    lens_z, lens_g : (lenses,) float64
    pixel_g : (cells,) float64
    first, end : (lenses,) int64
        Panel pixels of each elemental image, `end` excluded.
    low, high : (lenses,) int64
        Picture pixels that may land in each elemental image, at the depths of the picture; `high`
        excluded, one more on either side.
    """

    cells: int
    pixels: int
    unit: float
    lens_z: np.ndarray
    lens_g: np.ndarray
    pixel_g: np.ndarray
    first: np.ndarray
    end: np.ndarray
    low: np.ndarray
    high: np.ndarray


def forward_axes(
    display: Display, shape: tuple[int, int], pixel_mm: float, depths_mm: tuple[float, float]
) -> tuple[ForwardAxis, ForwardAxis]:
    """Columns and rows of the mapping of a picture with the lowest and highest depth given."""
    rows, columns = shape
    across = _lens_centres(display.lens_columns, display.pitch_mm, display.shift_x_mm)
    down = _lens_centres(display.lens_rows, display.row_pitch_mm, -display.shift_y_mm)
    return (
        _axis(display, display.columns, across, columns, pixel_mm, depths_mm),
        _axis(display, display.rows, down, rows, pixel_mm, depths_mm),
    )


def _lens_centres(lenses: int, pitch_mm: float, shift_mm: float) -> list[Fraction]:
    """Centres of the lenses of one axis, in its order."""
    pitch, shift = stated(pitch_mm), stated(shift_mm)
    return [Fraction(2 * n - lenses + 1, 2) * pitch + shift for n in range(lenses)]


def _axis(
    display: Display,
    panel: PixelAxis,
    centres: list[Fraction],
    cells: int,
    cell_mm: float,
    depths_mm: tuple[float, float],
) -> ForwardAxis:
    gap, pixel = stated(display.gap_mm), stated(display.pixel_pitch_mm)
    places = [Fraction(2 * c - cells + 1, 2) * stated(cell_mm) for c in range(cells)]
    lens_z, lens_g, pixel_g, unit = _whole(
        centres, [x0 * gap for x0 in centres], [x * gap for x in places], [pixel]
    )
    first, end = _elemental_images(panel, len(centres))
    middle = len(panel.lens) / 2
    edges_mm = np.stack([first - middle, end - middle]) * display.pixel_pitch_mm
    x0 = np.array(centres, np.float64)
    # X = x0 + (x0 - x) z / g is linear in x and in z: its extremes are at the corners.
    reach = [x0 + (x0 - edges_mm) * (z / display.gap_mm) for z in depths_mm]
    reach_cells = np.concatenate(reach) / cell_mm + cells / 2
    low = np.clip(np.floor(reach_cells.min(axis=0)) - 1, 0, cells).astype(np.int64)
    high = np.clip(np.ceil(reach_cells.max(axis=0)) + 1, 0, cells).astype(np.int64)
    return ForwardAxis(
        cells, len(panel.lens), float(unit[0]), lens_z, lens_g, pixel_g, first, end, low, high
    )


def _whole(*lengths: list[Fraction]) -> list[np.ndarray]:
    """The same lengths in a common unit that makes whole numbers of them, if floats hold those."""
    everything = [length for group in lengths for length in group]
    factor = Fraction(math.lcm(*(length.denominator for length in everything)))
    if max(abs(length) for length in everything) * factor >= _EXACT:
        factor = Fraction(1)
    return [np.array([float(length * factor) for length in group]) for group in lengths]


def _elemental_images(panel: PixelAxis, lenses: int) -> tuple[np.ndarray, np.ndarray]:
    """First panel pixel of each lens, and the one after its last; equal where it has none."""
    # Lenses ascend along the panel; those beside it are -1.
    covered = np.flatnonzero(panel.lens >= 0)
    start = covered[0] if len(covered) else 0
    order = panel.lens[covered]
    first = np.searchsorted(order, np.arange(lenses), side="left") + start
    end = np.searchsorted(order, np.arange(lenses), side="right") + start
    return first.astype(np.int64), end.astype(np.int64)
