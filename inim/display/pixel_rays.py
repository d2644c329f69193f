"""The pixels of a panel one by one: their lenses and rays, however the array lies over them.

Where the lattice is hexagonal, or the array is turned or tilted against its panel, a pixel's lens
does not follow from its row and its column apart. These are float64 from the pixel's position;
`inim.display.pixel_axis` is exact, for displays that are separable.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from inim.buffers import row_bands
from inim.errors import DisplayError

if TYPE_CHECKING:
    from inim.display.display import Display

__all__ = ["PixelRays", "least_gap_mm", "pixel_rays", "row_blocks"]

# Pixels whose rays are made at once: a few arrays of them stay in a processor's cache.
_PIXELS_AT_ONCE = 2**16


@dataclass(frozen=True)
class PixelRays:
    """Lens and ray of every pixel of a block of panel rows, (rows, columns) each.

    A pixel's chief ray is ``(x0 + slope_x z, y0 + slope_y z)`` in the display frame, which is Eq. 1
    of Wang et al. 2024 with the pixel's own gap.

    Attributes
    ----------
    lens : int64
        ``row * lens_columns + column``, rows from the top; -1 outside the array, where the lattice
        is carried on, so that every pixel has a ray.
    x0, y0 : float64
        The lens's centre, mm.
    slope_x, slope_y : float64
        Lateral travel per millimetre towards the viewer, ``(x0 - x) / gap_mm``.
    gap_mm : float64
        From the array down to the pixel.
    """

    lens: np.ndarray
    x0: np.ndarray
    y0: np.ndarray
    slope_x: np.ndarray
    slope_y: np.ndarray
    gap_mm: np.ndarray


def row_blocks(display: Display) -> Iterator[slice]:
    """The panel's rows in blocks of bounded size, top to bottom."""
    return row_bands(*display.eia_shape, _PIXELS_AT_ONCE)


def pixel_rays(display: Display, rows: slice, aside: tuple[float, float] = (0.0, 0.0)) -> PixelRays:
    """The rays of a block of panel rows.

    A pixel belongs to the lens whose elemental-image cell contains its centre: cells of the lens
    lattice at the elemental images' pitch, moved and turned with the array.

    Parameters
    ----------
    display : Display
    rows : slice
        With start and stop, as `row_blocks` gives them.
    aside : (down, right) of float
        Where in its pixel each ray starts, in pixels from the centre; it keeps its pixel's lens.

    Raises
    ------
    DisplayError
        When the panel is tilted so far that it meets the array.
    """
    least_gap_mm(display)
    panel_rows, panel_columns = display.eia_shape
    pitch = display.pixel_pitch_mm
    x = ((np.arange(panel_columns) - (panel_columns - 1) / 2) * pitch)[None, :]
    y = (((panel_rows - 1) / 2 - np.arange(rows.start, rows.stop)) * pitch)[:, None]
    angle = math.radians(display.rotation_deg)
    c, s = math.cos(angle), math.sin(angle)
    from_x, from_y = x - display.shift_x_mm, y - display.shift_y_mm
    row, column, stagger = _cell(display, c * from_x + s * from_y, c * from_y - s * from_x)
    # Lens centres have the lens pitch, whatever the pitch of the cells under them.
    across = (column + 0.5 - display.lens_columns / 2 + stagger) * display.pitch_mm
    up = (display.lens_rows / 2 - row - 0.5) * display.row_pitch_mm
    x0 = c * across - s * up + display.shift_x_mm
    y0 = c * up + s * across + display.shift_y_mm
    inside = (row >= 0) & (row < display.lens_rows)
    inside = inside & (column >= 0) & (column < display.lens_columns)
    lens = np.where(inside, row * display.lens_columns + column, -1).astype(np.int64)
    down, right = aside
    x, y = x + right * pitch, y - down * pitch
    tilt_x, tilt_y = _tilt(display)
    gap = display.gap_mm + tilt_x * x + tilt_y * y
    return PixelRays(lens, x0, y0, (x0 - x) / gap, (y0 - y) / gap, gap)


def least_gap_mm(display: Display) -> float:
    """The smallest gap over the panel, where that is tilted.

    Raises
    ------
    DisplayError
        When the panel meets the array.
    """
    rows, columns = display.eia_shape
    slopes = [abs(slope) for slope in _tilt(display)]
    gap = display.gap_mm - (slopes[0] * columns + slopes[1] * rows) * display.pixel_pitch_mm / 2
    if gap <= 0:
        raise DisplayError(
            f"{display.not_separable_by}: the panel, tilted, meets the array (gap_mm = "
            f"{display.gap_mm:g}); tilt it less"
        )
    return gap


def _tilt(display: Display) -> tuple[float, float]:
    """Growth of the gap per millimetre to the right and up."""
    return (
        math.tan(math.radians(display.tilt_x_deg)),
        math.tan(math.radians(display.tilt_y_deg)),
    )


def _cell(
    display: Display, x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Row from the top and column of the cell that holds points of the array's frame.

    And how far its row is staggered, in pitches. Whole numbers as floats; beyond the array they
    count on.
    """
    across = x / display.elemental_image_pitch_mm + display.lens_columns / 2
    down = display.lens_rows / 2 - y / display.elemental_row_pitch_mm
    if display.lattice != "hexagonal":
        return np.floor(down), np.floor(across), np.zeros(())
    # A point's nearest centre lies in the row of centres above it or in the one below.
    upper = np.floor(down - 0.5)
    rows = upper, upper + 1
    staggers = [_stagger(display, row) for row in rows]
    columns = [np.floor(across - stagger) for stagger in staggers]
    squares = [
        ((across - column - 0.5 - stagger) * display.elemental_image_pitch_mm) ** 2
        + ((down - row - 0.5) * display.elemental_row_pitch_mm) ** 2
        for row, column, stagger in zip(rows, columns, staggers, strict=True)
    ]
    above = squares[0] < squares[1]
    row, column, stagger = (np.where(above, *pair) for pair in (rows, columns, staggers))
    return row, column, stagger


def _stagger(display: Display, row: np.ndarray) -> np.ndarray:
    """How far right a row of a hexagonal lattice lies, in pitches: as a whole it is centred."""
    aside: np.ndarray = np.mod(row, 2) / 2 - 0.25
    return aside if display.lens_rows > 1 else np.zeros_like(aside)
