"""What the live display shows, computed without a graphics card: its stand-in, and its oracle."""

from __future__ import annotations

import numpy as np

from inim.display import Display
from inim.image.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.lens import channel_indices, trace_to_pixels, white_exposure


def still_view(
    eia: np.ndarray,
    display: Display,
    eye_mm: tuple[float, float, float],
    lens_model: str = "pinhole",
    *,
    pixels_per_lens: int = 4,
    grid: int = 4,
) -> np.ndarray:
    """A view of a display from one eye position, by the lens models in NumPy.

    Parameters
    ----------
    eia : (rows, columns, 3) uint8, sRGB
        Row 0 on top.
    display : Display
    eye_mm : (x, y, z)
    lens_model : str
        One of `inim.lens.lens_models`.
    pixels_per_lens : int
        Of the view, which shows exactly the lens array.
    grid : int
        Samples along one side of a view pixel, at the shader's places.

    Returns
    -------
    (rows, columns, 3) uint8, sRGB
        Panel pixels are evenly lit: sub-pixels are drawn as none.
    """
    rows, columns = (n * pixels_per_lens for n in (display.lens_rows, display.lens_columns))
    light = linear_from_srgb(np.arange(256) / 255)
    total = np.zeros((rows, columns, 3), np.float32)
    for j in range(grid):
        for i in range(grid):
            x = _places(columns, (i + (j + 0.5) / grid) / grid, display.width_mm)[None, :]
            y = _places(rows, (j + (i + 0.5) / grid) / grid, display.height_mm)[::-1, None]
            codes, weight = _codes(eia, display, lens_model, x, y, eye_mm)
            total += light[codes] * weight
    total *= white_exposure(display, lens_model)
    return srgb_to_uint8(srgb_from_linear(total / grid**2))


def _places(count: int, within: float, size_mm: float) -> np.ndarray:
    """One place inside each of `count` pixels that fill `size_mm` about the axis, ascending."""
    return ((np.arange(count) + within) / count - 0.5) * size_mm


def _codes(
    eia: np.ndarray,
    display: Display,
    lens_model: str,
    x: np.ndarray,
    y: np.ndarray,
    eye_mm: tuple[float, float, float],
) -> tuple[np.ndarray, np.ndarray]:
    """Code values that rays through points (x, y) of the array land on, and their weights.

    Both (rows, columns, 3), of red, green and blue.
    """
    slopes = (x - eye_mm[0]) / eye_mm[2], (y - eye_mm[1]) / eye_mm[2]
    seen = np.zeros((y.shape[0], x.shape[1], 3), np.uint8)
    weights = np.zeros(seen.shape, np.float32)
    for channel, index in enumerate(channel_indices(display)):
        row, column, weights[..., channel] = trace_to_pixels(
            display, lens_model, x, y, *slopes, index=index
        )
        seen[..., channel] = eia[row, column, channel]
    return seen, weights
