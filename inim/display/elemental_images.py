"""Elemental image arrays as arrays: the axis order in one place."""

from __future__ import annotations

import numpy as np

from inim.display.display import Display
from inim.errors import UsageError

__all__ = ["elemental_images", "sub_aperture_view"]


def elemental_images(eia: np.ndarray, display: Display) -> np.ndarray:
    """View an EIA as ``(lens row, pixel row, lens column, pixel column, ...)`` without copying.

    Raises
    ------
    UsageError
        When the display has no whole number of pixels per lens, or the shape is another's.
    """
    if not display.has_integer_ratio:
        raise UsageError(
            f"display {display.name} has {display.pixels_per_lens:.4g} pixels per lens: its "
            "elemental images have no common shape; address pixels by position instead"
        )
    if eia.shape[:2] != display.eia_shape:
        raise UsageError(
            f"EIA of {eia.shape[0]} x {eia.shape[1]} pixels; display {display.name} has "
            f"{display.eia_shape[0]} x {display.eia_shape[1]}"
        )
    pixels = round(display.pixels_per_lens)
    shape = (display.lens_rows, pixels, display.lens_columns, pixels, *eia.shape[2:])
    return eia.reshape(shape)


def sub_aperture_view(eia: np.ndarray, display: Display, row: int, column: int) -> np.ndarray:
    """The co-located pixels (row, column) of all lenses: one parallel projection of the scene.

    Returns
    -------
    (lens_rows, lens_columns, ...) array, a view where NumPy can make one.
    """
    return elemental_images(eia, display)[:, row, :, column]
