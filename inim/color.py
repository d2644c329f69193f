"""Transfer between linear light and display-referred sRGB (IEC 61966-2-1)."""

from __future__ import annotations

import numpy as np

__all__ = ["srgb_from_linear", "srgb_to_uint8"]

_KNEE = 0.0031308


def srgb_from_linear(linear: np.ndarray) -> np.ndarray:
    """Linear RGB to sRGB in 0..1, clipped to the panel's range.

    Parameters
    ----------
    linear : (...) float array
        Linear radiance, 1 being the panel's white.

    Returns
    -------
    (...) float32 array.
    """
    clipped = np.clip(np.asarray(linear, np.float32), 0.0, 1.0)
    curve = 1.055 * np.power(np.maximum(clipped, _KNEE), 1 / 2.4) - 0.055
    return np.where(clipped <= _KNEE, 12.92 * clipped, curve).astype(np.float32)


def srgb_to_uint8(srgb: np.ndarray) -> np.ndarray:
    """The 8-bit code values of sRGB in 0..1, rounded to nearest."""
    codes: np.ndarray = np.rint(np.clip(srgb, 0.0, 1.0) * 255.0).astype(np.uint8)
    return codes
