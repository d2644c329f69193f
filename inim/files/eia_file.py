"""Finished elemental image arrays from files, whatever program made them."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from inim.color import linear_from_srgb
from inim.display import Display
from inim.errors import FileError
from inim.files.image import exr_size, read_exr_channels
from inim.files.png import check_png
from inim.row_bands import row_bands

__all__ = ["check_eia_name", "read_eia"]

# Pillow's names for grey of 16 bits.
_GREY_16 = ("I;16", "I;16B", "I")


def check_eia_name(path: Path) -> None:
    """Raise `FileError` for a file that is missing or of another kind; it is not opened.

    Decoders are native code: only a worker under supervision lets them at a file.
    """
    if path.suffix.lower() not in (".png", ".exr"):
        raise FileError(f"{path}: a finished EIA is a .png (sRGB) or an .exr (linear)")
    if not path.is_file():
        raise FileError(f"{path}: no such file")


def read_eia(path: Path, display: Display) -> tuple[np.ndarray, np.ndarray | None]:
    """A finished EIA: linear EXR, or sRGB PNG (grey or colour, 8 or 16 bits, alpha or none).

    Pillow reads colour of 16 bits as 8; grey and EXR keep what they have. A PNG's colour profile
    is not looked at: its values are taken as sRGB.

    Parameters
    ----------
    path : Path
    display : Display
        Whose `eia_shape` it must have.

    Returns
    -------
    eia : (rows, columns, 3) float32
        Linear RGB, over black where it is transparent.
    shown : (rows, columns) bool, or None
        Where alpha is above 0; None for a file without alpha.

    Raises
    ------
    FileError
        Missing, damaged, of another kind or another size.
    """
    check_eia_name(path)
    read = _read_png if path.suffix.lower() == ".png" else _read_exr
    eia, alpha = read(path, display)
    return eia, None if alpha is None else alpha > 0


def _check_size(path: Path, size: tuple[int, int], display: Display) -> None:
    rows, columns = display.eia_shape
    if size != (columns, rows):
        raise FileError(
            f"{path}: has {size[0]} x {size[1]} pixels, display {display.name} needs {columns} x "
            f"{rows}; make it for this display, or describe its own with --display or -D"
        )


def _read_exr(path: Path, display: Display) -> tuple[np.ndarray, np.ndarray | None]:
    _check_size(path, exr_size(path), display)
    channels = read_exr_channels(path)
    wrong = [n for n in "RGB" if n not in channels or channels[n].shape != display.eia_shape]
    if wrong:
        raise FileError(
            f"{path}: no full channel {', '.join(wrong)}; it has {', '.join(channels) or 'none'}"
        )
    rgb = np.stack([channels[name] for name in "RGB"], axis=-1)
    alpha = channels.get("A")
    if alpha is None or alpha.shape != display.eia_shape:
        return rgb, None
    # Colour is already multiplied by alpha, as EXR has it.
    return np.where((alpha > 0)[..., None], rgb, np.float32(0)), alpha


def _read_png(path: Path, display: Display) -> tuple[np.ndarray, np.ndarray | None]:
    from PIL import Image

    check_png(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # on sizes, which are checked below
            with Image.open(path, formats=["PNG"]) as picture:
                _check_size(path, picture.size, display)
                return _linear(picture)
    except FileError:
        raise
    except Exception as error:
        cause = getattr(error, "strerror", None) or str(error).partition("\n")[0]
        raise FileError(f"{path}: not a readable PNG ({cause})") from error


def _linear(picture: Any) -> tuple[np.ndarray, np.ndarray | None]:
    """Linear RGB and alpha of an open picture, decoded here."""
    if picture.mode in _GREY_16:
        return _linear_codes(np.asarray(picture)[..., None], 65535), None
    if "transparency" not in picture.info and "A" not in picture.getbands():
        return _linear_codes(np.asarray(picture.convert("RGB")), 255), None
    rgba = np.asarray(picture.convert("RGBA"))
    alpha = rgba[..., 3].astype(np.float32) / 255
    rgb = _linear_codes(rgba[..., :3], 255)
    rgb *= alpha[..., None]
    return rgb, alpha


def _linear_codes(codes: np.ndarray, white: int) -> np.ndarray:
    """Linear RGB, (rows, columns, 3) float32, of grey or colour codes up to that of white."""
    linear = np.empty((*codes.shape[:2], 3), np.float32)
    for band in row_bands(*codes.shape[:2]):
        linear[band] = linear_from_srgb(codes[band].astype(np.float32) / white)
    return linear
