"""Transfer between linear light and display-referred sRGB (IEC 61966-2-1), and false colours."""

import base64
import io

import numpy as np
from numpy.typing import NDArray

from inim.system.row_bands import row_bands

# Where the straight part of the curve ends, in linear light and in code value.
_KNEE = 0.0031308
_KNEE_CODE = 0.04045


def srgb_from_linear(linear: np.ndarray) -> np.ndarray:
    """Linear RGB to sRGB in 0..1, clipped to the panel's range.

    * `linear`, (...) float array: linear radiance, 1 being the panel's white.

    Returns (...) float32 array.
    """
    clipped = np.clip(np.asarray(linear, np.float32), 0.0, 1.0)
    curve = 1.055 * np.power(np.maximum(clipped, _KNEE), 1 / 2.4) - 0.055
    return np.where(clipped <= _KNEE, 12.92 * clipped, curve).astype(np.float32)


def srgb_slope(linear: np.ndarray) -> np.ndarray:
    """Derivative of `srgb_from_linear` within the panel's range; continued above white.

    Parameters
    ----------
    linear : (...) float array
        Linear radiance, at least 0.
    """
    curve = 1.055 / 2.4 * np.power(np.maximum(linear, _KNEE), 1 / 2.4 - 1)
    return np.where(linear <= _KNEE, 12.92, curve)


def linear_from_srgb(srgb: np.ndarray) -> np.ndarray:
    """The linear RGB of sRGB in 0..1, by IEC 61966-2-1: the inverse of `srgb_from_linear`.

    * `srgb`, (...) float array: code values over the largest one: 8-bit values divided by 255.

    Returns (...) float32 array.
    """
    srgb = np.asarray(srgb, np.float32)
    curve = np.power((np.maximum(srgb, _KNEE_CODE) + 0.055) / 1.055, 2.4)
    return np.where(srgb <= _KNEE_CODE, srgb / 12.92, curve).astype(np.float32)


def srgb_to_uint8(srgb: np.ndarray) -> np.ndarray:
    """The 8-bit code values of sRGB in 0..1, rounded to nearest."""
    codes: np.ndarray = np.rint(np.clip(srgb, 0.0, 1.0) * 255.0).astype(np.uint8)
    return codes


def to_srgb(linear: np.ndarray) -> NDArray[np.uint8]:
    """Convert linear light to 8-bit sRGB (IEC 61966-2-1), as a PNG or a panel has it.

    Parameters
    ----------
    linear : (rows, columns, ...) float array
        Linear radiance, 1 being the panel's white; clipped to 0..1.

    Returns
    -------
    (rows, columns, ...) uint8 array.
    """
    codes = np.empty(linear.shape, np.uint8)
    for band in row_bands(*linear.shape[:2]):
        codes[band] = srgb_to_uint8(srgb_from_linear(linear[band]))
    return codes


def png_data_uri(pixels: np.ndarray) -> str:
    """A PNG of (rows, columns, 3) uint8 sRGB, as a data URI."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(stream, "PNG")
    return f"data:image/png;base64,{base64.b64encode(stream.getvalue()).decode()}"


def magma(share: np.ndarray) -> np.ndarray:
    """Matplotlib's colours for shares of one, (rows, columns, 3) uint8; FLIP's maps have them."""
    from matplotlib import colormaps

    return np.asarray(colormaps["magma"](np.clip(share, 0, 1), bytes=True)[..., :3], np.uint8)
