"""Reading of a camera's colour and depth picture."""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inim.image.files.image import read_exr, read_exr_channels
from inim.image.files.picture import is_exr, open_picture, read_pfm
from inim.system.errors import FileError
from inim.system.files import check_file

_COLOR_FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "WEBP", "PPM")
_NO_COLOR = "not a colour picture that inim reads; save it as PNG, JPEG or EXR"
_OPAQUE = 255
_WITH_PROFILE = ("RGB", "RGBA", "L", "CMYK")
_CODES_OF_16_BITS = 65535 / 255
_PICTURES = {
    ".png": ("PNG",),
    ".pgm": ("PPM",),
    ".tif": ("TIFF",),
    ".tiff": ("TIFF",),
    ".jpg": ("JPEG",),
    ".jpeg": ("JPEG",),
}
# Names of the depth channel of an EXR in this program, renderers and depth estimators, by priority.
_CHANNELS = ("Z", "Y", "V", "depth.Z", "Depth.Z", "depth.V", "Depth.V", "R")
_MOST_PIXELS = 2**28
# Largest difference between the colour channels of a grey picture.
_MOST_CHANNEL_DIFFERENCE = 2
# Range of depths in any unit; swapped bytes of a float give values outside.
_PLAUSIBLE_FLOATS = (1e-12, 1e15)


def read_color(path: Path) -> NDArray[np.uint8] | NDArray[np.float32]:
    """Colour picture, rotated by its EXIF orientation.

    * `path`: PNG, JPEG, TIFF, BMP, WebP or PPM, brought to sRGB by its colour profile, over black
      where transparent; or a linear EXR.

    Returns (H, W, 3) uint8 sRGB, or (H, W, 3) float32 linear RGB of an EXR: row 0 on top.

    Raises `FileError`: missing, damaged or of another kind.
    """
    if is_exr(path):
        linear = read_exr(path)
        if not np.isfinite(linear).all():
            raise FileError(f"{path}: has colours that are not finite; save it again")
        return np.broadcast_to(linear, (*linear.shape[:2], 3)) if linear.shape[2] == 1 else linear
    return _decoded_color(path)


def read_srgb(path: Path) -> NDArray[np.uint8]:
    """Colour picture as `read_color` reads it, (H, W, 3) uint8 sRGB; that of an EXR is clipped."""
    from inim.image.color import srgb_from_linear, srgb_to_uint8

    color = read_color(path)
    if color.dtype != np.uint8:
        color = srgb_to_uint8(srgb_from_linear(color))
    return color.astype(np.uint8, copy=False)


def _decoded_color(path: Path) -> NDArray[np.uint8]:
    from PIL import Image, ImageOps

    with open_picture(path, _COLOR_FORMATS, 1, _NO_COLOR) as picture:
        upright = convert_to_srgb(ImageOps.exif_transpose(picture), path)
        if upright.mode.startswith("I"):  # Pillow would clip 16 bits to 255
            grey = np.asarray(upright, np.float32) / _CODES_OF_16_BITS
            codes = np.rint(np.clip(grey, 0, 255)).astype(np.uint8)
            return np.repeat(codes[..., None], 3, axis=-1)
        if "A" not in upright.getbands() and "transparency" not in upright.info:
            return np.asarray(upright.convert("RGB"))
        rgba = upright.convert("RGBA")
        black = Image.new("RGBA", rgba.size, (0, 0, 0, _OPAQUE))
        return np.asarray(Image.alpha_composite(black, rgba).convert("RGB"))


def convert_to_srgb(picture: Any, path: Path) -> Any:
    """Convert a Pillow picture to sRGB; raises `FileError` for a damaged colour profile."""
    from PIL import ImageCms

    profile = picture.info.get("icc_profile")
    if not profile or picture.mode not in _WITH_PROFILE:
        return picture
    try:
        stored = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        if "sRGB" in ImageCms.getProfileDescription(stored):
            return picture
        mode = "RGBA" if picture.mode == "RGBA" else "RGB"
        return ImageCms.profileToProfile(
            picture, stored, ImageCms.createProfile("sRGB"), outputMode=mode
        )
    except (OSError, ValueError, TypeError, ImageCms.PyCMSError) as error:
        cause = str(error).partition("\n")[0]
        raise FileError(
            f"{path}: its colour profile is damaged ({cause}); save the picture as sRGB"
        ) from error


@dataclass(frozen=True)
class DepthFile:
    """Numbers of a depth picture as stored, (H, W) float32, row 0 on top.

    `largest` is the largest number of their integer type; None for floats.
    """

    values: NDArray[np.float32]
    largest: int | None


def read_depth(path: Path, *, swap_bytes: bool = False) -> DepthFile:
    """Read a depth picture.

    * `path`: PNG, PGM, TIFF or JPEG in grey of 8, 16 or 32 bits; EXR (channel Z, Y, V or R of the
      first part); PFM; or NumPy's .npy with a (H, W) array.
    * `swap_bytes`: the two bytes of 16-bit numbers are swapped relative to the format.

    Raises `FileError`: the file is missing, damaged, of another kind, has several numbers per
    pixel, or floats in the wrong byte order.
    """
    readers = {".exr": _read_exr, ".pfm": read_pfm, ".npy": _read_npy}
    suffix = path.suffix.lower()
    if suffix not in readers and suffix not in _PICTURES:
        raise FileError(
            f"{path}: a depth picture is a .png, .pgm, .tif, .exr, .pfm or .npy; save it as one"
        )
    check_file(path)
    if suffix in readers:
        stored = readers[suffix](path)
    else:
        formats = _PICTURES[suffix]
        with open_picture(path, formats, 4) as picture:
            stored = depth_numbers(picture, path, wide=formats == ("TIFF",))
    if stored.ndim == 3 and stored.shape[2] == 1:
        stored = stored[..., 0]
    if stored.ndim != 2 or stored.size == 0:
        raise FileError(
            f"{path}: its array has shape {stored.shape}; depth is one number per pixel, (H, W)"
        )
    if stored.dtype.kind not in "fui" or stored.size > _MOST_PIXELS:
        raise FileError(
            f"{path}: {stored.size} values of type {stored.dtype}; depth is at most {_MOST_PIXELS} "
            "whole numbers or floats"
        )
    if swap_bytes:
        if stored.dtype.itemsize != 2:
            raise FileError(f"{path}: --swap-bytes is for 16-bit depth; this is {stored.dtype}")
        stored = stored.byteswap()
    if stored.dtype.kind == "f":
        _check_floats(path, stored)
    largest = int(np.iinfo(stored.dtype).max) if stored.dtype.kind in "ui" else None
    with np.errstate(over="ignore"):  # infinite values are missing
        return DepthFile(np.ascontiguousarray(stored, np.float32), largest)


def depth_numbers(picture: Any, path: Path, *, wide: bool = False) -> np.ndarray:
    """Numbers of an open depth picture, (H, W); `wide`: it can hold 32 bits.

    Raises `FileError` for a coloured picture or one with a palette.
    """
    if picture.mode == "P":
        raise FileError(f"{path}: has a colour palette instead of depths; save it as grey")
    pixels = np.asarray(picture)
    if pixels.ndim == 3:
        pixels = _grey(path, pixels)
    if pixels.dtype == np.int32 and not wide:
        pixels = pixels.astype(np.uint16)  # Pillow hands out 16 bits as 32 for some files
    return pixels.astype(np.uint8) if pixels.dtype == bool else pixels


def _grey(path: Path, pixels: np.ndarray) -> np.ndarray:
    """The one number per pixel of a grey picture that was saved as colour."""
    color = pixels[..., :3] if pixels.shape[2] >= 3 else pixels[..., :1]
    spread = int((color.max(axis=2) - color.min(axis=2)).max())
    if spread > _MOST_CHANNEL_DIFFERENCE:
        raise FileError(
            f"{path}: is coloured (channels differ by up to {spread}), so it holds no depth that "
            "can be read back; use the grey, EXR or .npy depth it was painted from"
        )
    grey: np.ndarray = color[..., 0]
    return grey


def _read_exr(path: Path) -> np.ndarray:
    channels = read_exr_channels(path)
    for name in _CHANNELS:
        # Red is depth only in a picture with nothing but equal colour channels.
        if name in channels and (name != "R" or set(channels) <= set("RGBA")):
            return channels[name]
    raise FileError(
        f"{path}: no channel {', '.join(_CHANNELS)} in its first part; it has {', '.join(channels)}"
    )


def _read_npy(path: Path) -> np.ndarray:
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(array, np.ndarray):
            raise ValueError("several arrays")
        return np.array(array, array.dtype.newbyteorder("="))
    except Exception as error:  # of any type: NumPy reads the header as Python
        cause = str(error).partition("\n")[0]
        raise FileError(f"{path}: not a readable .npy array ({cause}); save it again") from error


def _check_floats(path: Path, stored: np.ndarray) -> None:
    """Raise `FileError` for floats that are depths in no unit."""
    sizes = np.abs(stored[np.isfinite(stored) & (stored != 0)])
    middle = float(np.median(sizes)) if sizes.size else 1.0
    if not _PLAUSIBLE_FLOATS[0] < middle < _PLAUSIBLE_FLOATS[1]:
        raise FileError(
            f"{path}: half of its values are about {middle:.3g}, as when the bytes of floats are "
            "in the wrong order; save it again (PFM: the sign of its scale)"
        )
