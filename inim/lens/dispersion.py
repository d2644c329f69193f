"""A lens material's refractive index for each colour of the panel."""

from __future__ import annotations

from inim.display import Display

__all__ = ["CHANNEL_WAVELENGTHS_NM", "channel_indices"]

#: Dominant wavelengths of the sRGB primaries under D65: red, green, blue.
CHANNEL_WAVELENGTHS_NM = (611.4, 549.1, 464.2)
# Fraunhofer's lines that the Abbe number V = (n_d - 1) / (n_F - n_C) is defined by.
_BLUE_F_NM, _YELLOW_D_NM, _RED_C_NM = 486.13, 587.56, 656.27


def channel_indices(display: Display) -> tuple[float, float, float]:
    """Index for red, green and blue, by Cauchy's n = A + B / wavelength^2.

    The display's `refractive_index` is the one of the d line, and its focal length too; without an
    Abbe number all three are equal to it.
    """
    n = display.refractive_index
    if display.abbe_number is None:
        return n, n, n
    slope = (n - 1) / display.abbe_number / (_BLUE_F_NM**-2 - _RED_C_NM**-2)
    red, green, blue = (
        n + slope * (wavelength**-2 - _YELLOW_D_NM**-2) for wavelength in CHANNEL_WAVELENGTHS_NM
    )
    return red, green, blue
