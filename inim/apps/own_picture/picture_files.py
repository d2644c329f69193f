"""Reading of a camera's colour and depth picture."""

import io
import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inim.image.color import srgb_from_linear, srgb_to_uint8
from inim.image.files.image import check_unfolding, read_exr_channels, read_exr_color
from inim.image.files.picture import (
    grey_of_16_bits,
    is_exr,
    open_picture,
    png_gamma,
    read_pfm,
)
from inim.system.errors import FileError
from inim.system.files import check_file, open_file

_COLOR_FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "WEBP", "PPM")
_NO_COLOR = "not a colour picture that inim reads; save it as PNG, JPEG or EXR"
# Alpha from which on a pixel shows a surface.
_OPAQUE = 0.5
_WITH_PROFILE = ("RGB", "RGBA", "L", "CMYK")
_WITH_GAMMA = ("L", "LA", "RGB", "RGBA")
_PICTURES = {
    ".png": ("PNG",),
    ".pgm": ("PPM",),
    ".tif": ("TIFF",),
    ".tiff": ("TIFF",),
    ".jpg": ("JPEG",),
    ".jpeg": ("JPEG",),
}
# Last parts of the names of depth channels in renderers and depth estimators; of lone channels.
_DEPTHS, _LONE = ("z", "depth", "t"), ("y", "v", "r", "d")
_MOST_PIXELS = 2**28
# Largest difference between the colour channels of a grey picture, exact or compressed by JPEG.
_MOST_CHANNEL_DIFFERENCE, _MOST_COMPRESSED = 2, 32
# Pixels next to another picture that share its colours in JPEG.
_SEAM_PX = 16
# Rec. 601, which JPEG compresses less than the colours.
_LUMA = (0.299, 0.587, 0.114)
# Range of depths in any unit; swapped bytes of a float give values outside.
_PLAUSIBLE_FLOATS = (1e-12, 1e15)


def read_color(path: Path) -> NDArray[np.uint8] | NDArray[np.float32]:
    """Colour picture, rotated by its EXIF orientation, black where transparent.

    * `path`: PNG, JPEG, TIFF, BMP, WebP or PPM, brought to sRGB by its colour profile; or a linear
      EXR.

    Returns (H, W, 3) uint8 sRGB, or (H, W, 3) float32 linear RGB of an EXR: row 0 on top.

    Raises `FileError`: missing, damaged or of another kind.
    """
    return read_cutout(path)[0]


def read_cutout(
    path: Path,
) -> tuple[NDArray[np.uint8] | NDArray[np.float32], NDArray[np.bool_] | None]:
    """Colour picture as of `read_color`, and the mask of its opaque pixels.

    A pixel is opaque if its alpha is at least a half, and keeps its own colour. The mask is None
    for a picture without transparent pixels.
    """
    if is_exr(path):
        linear, alpha = read_exr_color(path)
        if not np.isfinite(linear).all():
            raise FileError(f"{path}: has colours that are not finite; save it again")
        color = np.broadcast_to(linear, (*linear.shape[:2], 3))
        if alpha is None or bool((alpha >= _OPAQUE).all()):
            return color, None
        opaque = alpha >= _OPAQUE
        with np.errstate(divide="ignore", invalid="ignore"):  # colours are multiplied by alpha
            own = color / np.minimum(alpha, 1)[..., None]
        return np.where(opaque[..., None], own, np.float32(0)), opaque
    return _decoded_color(path)


def read_srgb(path: Path) -> NDArray[np.uint8]:
    """Colour picture as `read_color` reads it, (H, W, 3) uint8 sRGB; that of an EXR is clipped."""
    color = read_color(path)
    if color.dtype != np.uint8:
        color = srgb_to_uint8(srgb_from_linear(color))
    return color.astype(np.uint8, copy=False)


def _decoded_color(path: Path) -> tuple[NDArray[np.uint8], NDArray[np.bool_] | None]:
    from PIL import ImageOps

    with open_picture(path, _COLOR_FORMATS, 1, _NO_COLOR) as picture:
        upright = convert_to_srgb(ImageOps.exif_transpose(picture), path)
        if upright.mode.startswith("I"):
            clear = _transparent(upright)
            return grey_of_16_bits(upright), None if clear is None else ~clear
        if "A" not in upright.getbands() and "transparency" not in upright.info:
            return np.asarray(upright.convert("RGB")), None
        rgba = np.asarray(upright.convert("RGBA"))
    opaque = rgba[..., 3] >= _OPAQUE * 255
    if opaque.all():
        return rgba[..., :3], None
    return np.where(opaque[..., None], rgba[..., :3], np.uint8(0)), opaque


def convert_to_srgb(picture: Any, path: Path) -> Any:
    """Convert a Pillow picture to sRGB; raises `FileError` for a damaged colour profile."""
    from PIL import ImageCms

    profile = picture.info.get("icc_profile")
    gamma = png_gamma(picture)
    if gamma is not None and picture.mode in _WITH_GAMMA:
        light = (np.arange(256) / 255) ** (1 / gamma)
        table = srgb_to_uint8(srgb_from_linear(light.astype(np.float32))).tolist()
        colors = [table] * (len(picture.getbands()) - ("A" in picture.getbands()))
        identity = [list(range(256))] * ("A" in picture.getbands())
        return picture.point([code for own in colors + identity for code in own])
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

    `largest` is the largest number of their integer type; None for floats. `notes` are remarks on
    what was read.
    """

    values: NDArray[np.float32]
    largest: int | None
    notes: tuple[str, ...] = ()


def read_depth(path: Path, *, swap_bytes: bool = False) -> DepthFile:
    """Read a depth picture.

    * `path`: PNG, PGM, TIFF or JPEG in grey of 8, 16 or 32 bits; EXR (of all parts and layers, the
      channel whose name ends with Z or depth, or a lone channel); PFM; or NumPy's .npy or .npz
      with one (H, W) array.
    * `swap_bytes`: the two bytes of 16-bit numbers are swapped relative to the format.

    Raises `FileError`: the file is missing, damaged, of another kind, has several numbers per
    pixel, or floats in the wrong byte order.
    """
    readers = {".pfm": read_pfm, ".npy": _read_npy, ".npz": _read_npy}
    from PIL import ImageOps

    suffix, notes, clear = path.suffix.lower(), list[str](), None
    if suffix not in readers and suffix not in _PICTURES and suffix != ".exr":
        raise FileError(
            f"{path}: a depth picture is a .png, .pgm, .tif, .exr, .pfm, .npy or .npz; save it as "
            "one"
        )
    check_file(path)
    if suffix == ".exr":
        stored = _read_exr(path, notes)
    elif suffix in readers:
        stored = readers[suffix](path)
    else:
        formats = _PICTURES[suffix]
        with open_picture(path, formats, 4) as picture:
            upright = ImageOps.exif_transpose(picture)
            stored = depth_numbers(upright, path, notes, wide=formats == ("TIFF",))
            clear = _transparent(upright)
        if formats == ("PPM",):
            stored = _by_largest(path, stored)
        elif formats == ("PNG",):
            _check_bits(path)
    if stored.ndim > 2:  # one array of a batch, or with one channel
        stored = stored.reshape([n for n in stored.shape if n > 1])
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
        values = np.ascontiguousarray(stored, np.float32)
    if clear is not None:
        values = np.where(clear, np.float32(np.nan), values)
    return DepthFile(values, largest, tuple(notes))


def _transparent(picture: Any) -> np.ndarray | None:
    """Mask of the transparent pixels of a depth picture, or None."""
    if "A" in picture.getbands():
        clear: np.ndarray = np.asarray(picture.getchannel("A")) < _OPAQUE * 255
    elif isinstance(transparency := picture.info.get("transparency"), int):
        clear = np.asarray(picture) == transparency
    else:
        return None
    return clear if clear.any() else None


# A header, with some comments.
_PGM_HEAD_BYTES = 4096


def _by_largest(path: Path, stored: np.ndarray) -> np.ndarray:
    """Numbers of a PGM as stored: Pillow stretches them to all of 8 or 16 bits."""
    with open_file(path) as file:
        head = file.read(_PGM_HEAD_BYTES)
    largest = int(re.sub(rb"#[^\n]*", b"", head).split()[3])
    full = 255 if largest <= 255 else 65535
    return np.rint(stored * (largest / full)).astype(stored.dtype)


def _check_bits(path: Path) -> None:
    """Raise `FileError` for a PNG of 16 bits in several channels, of which Pillow reads 8."""
    with open_file(path) as file:
        head = file.read(26)
    if head[24] == 16 and head[25] in (2, 4, 6):
        raise FileError(
            f"{path}: has 16 bits in several channels, of which only 8 can be read; save it as grey"
        )


def depth_numbers(picture: Any, path: Path, notes: list[str], *, wide: bool = False) -> np.ndarray:
    """Numbers of an open depth picture, (H, W).

    * `notes`: receives remarks on what was read.
    * `wide`: the picture can hold 32 bits.

    Raises `FileError` for a coloured picture or one with a palette.
    """
    if picture.mode == "P":
        raise FileError(f"{path}: has a colour palette instead of depths; save it as grey")
    if picture.mode in ("CMYK", "YCbCr", "LAB", "HSV"):
        picture = picture.convert("RGB")
    pixels = np.asarray(picture)
    if pixels.ndim == 3:
        pixels = grey_numbers(path, pixels, notes)
    if pixels.dtype == np.int32 and not wide:
        pixels = pixels.astype(np.uint16)  # Pillow hands out 16 bits as 32 for some files
    return pixels.astype(np.uint8) if pixels.dtype == bool else pixels


def grey_numbers(
    path: Path, pixels: np.ndarray, notes: list[str], seam: tuple[int, bool] | None = None
) -> np.ndarray:
    """The one number per pixel of a grey picture that was saved as colour, (H, W).

    * `seam`: axis of the border to a coloured picture, and whether it is at its start; JPEG tints
      the pixels there.

    Raises `FileError` for a coloured picture.
    """
    color = pixels[..., :3] if pixels.shape[2] >= 3 else pixels[..., :1]
    spreads = color.max(axis=2).astype(int) - color.min(axis=2)
    if seam is not None:
        axis, is_at_start = seam
        inner = slice(_SEAM_PX, None) if is_at_start else slice(None, -_SEAM_PX)
        spreads = spreads[(inner, slice(None)) if axis == 0 else (slice(None), inner)]
    spread = int(spreads.max(initial=0))
    if spread <= _MOST_CHANNEL_DIFFERENCE:
        grey: np.ndarray = color[..., 0]
        return grey
    if spread > _MOST_COMPRESSED or pixels.dtype != np.uint8:
        raise FileError(
            f"{path}: is coloured (channels differ by up to {spread}), so it holds no depth that "
            "can be read back; use the grey, EXR or .npy depth it was painted from"
        )
    notes.append(
        f"{path}: its channels differ by up to {spread}, as of JPEG; their luma is read, and such "
        "depth is coarse"
    )
    luma: np.ndarray = np.rint(color @ np.array(_LUMA)).astype(np.uint8)
    return luma


def _read_exr(path: Path, notes: list[str]) -> np.ndarray:
    channels = read_exr_channels(path)
    name = _depth_channel(path, channels)
    others = [other for other in channels if _ends_with_depth(other, channels) and other != name]
    if others:
        notes.append(f"{path}: {name} is read; it also has depth in {', '.join(others)}")
    if name.endswith(".T"):
        notes.append(f"{path}: {name} is Mitsuba's distance along the ray, not z")
    return channels[name]


def _depth_channel(path: Path, channels: Mapping[str, np.ndarray]) -> str:
    """Channel of depths: by the last part of its name, or the only one.

    Raises `FileError`: there is none.
    """
    named = [name for name in channels if _ends_with_depth(name, channels)]
    if named:
        return min(named, key=_depth_rank)
    layers = [name for name in channels if "depth" in name.lower().split(".")[:-1]]
    lone = [name for name in layers or channels if name.rpartition(".")[2] != "A"]
    if len(lone) == 1 and lone[0].rpartition(".")[2].lower() in _LONE:
        return lone[0]
    if {name.rpartition(".")[2] for name in lone} == set("RGB"):
        first, *others = (channels[name] for name in lone)
        if all(np.allclose(first, other, rtol=1e-5, atol=0, equal_nan=True) for other in others):
            return lone[0]
        raise FileError(f"{path}: is coloured, so it holds no depth; it has {', '.join(channels)}")
    raise FileError(
        f"{path}: no channel whose name ends with Z or depth; it has {', '.join(channels)}"
    )


# Layers whose last axis, or whose values, are no depth of the picture.
_OTHER_LAYERS = ("mist", "position", "world", "normal", "vector", "motion", "uv", "denoising")


def _depth_rank(name: str) -> tuple[bool, bool]:
    """Order of depth channels: Z alone, then layers called depth, then others."""
    layer = name.rpartition(".")[0].rpartition(".")[2].lower()
    return name.lower() != "z", layer not in ("depth", "")


def _ends_with_depth(name: str, channels: Mapping[str, np.ndarray]) -> bool:
    """True for a depth by its name, but not for the Z of a vector, as of normals."""
    layer, _, last = name.rpartition(".")
    beside = {other.rpartition(".")[2].lower() for other in channels
              if other.rpartition(".")[0] == layer}  # fmt: skip
    is_other = any(word in layer.lower() for word in _OTHER_LAYERS)
    return last.lower() in _DEPTHS and not {"x", "y"} <= beside and not is_other


def _read_npy(path: Path) -> np.ndarray:
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
        if isinstance(array, np.lib.npyio.NpzFile):
            names = [name for name in array.files if name.lower() == "depth"] or array.files
            if len(names) != 1:
                raise ValueError(f"arrays {', '.join(array.files)}, not one, and none named depth")
            with zipfile.ZipFile(path) as archive:
                check_unfolding(path, sum(entry.file_size for entry in archive.infolist()))
            array = array[names[0]]
        return np.array(array, array.dtype.newbyteorder("="))
    except FileError:
        raise
    except Exception as error:  # of any type: NumPy reads the header as Python
        cause = str(error).partition("\n")[0]
        raise FileError(f"{path}: not a readable .npy array ({cause}); save it again") from error


def _check_floats(path: Path, stored: np.ndarray) -> None:
    """Raise `FileError` for floats that are depths in no unit."""
    sizes = np.abs(stored[np.isfinite(stored) & (stored != 0)])
    largest = sizes.max(initial=0)  # may stand for no surface
    sizes = sizes[sizes < largest] if (sizes < largest).any() else sizes
    middle = float(np.median(sizes.astype(np.float64))) if sizes.size else 1.0
    if not _PLAUSIBLE_FLOATS[0] < middle < _PLAUSIBLE_FLOATS[1]:
        raise FileError(
            f"{path}: half of its values are about {middle:.3g}, as when the bytes of floats are "
            "in the wrong order; save it again (PFM: the sign of its scale)"
        )


#: Where the depth is in a picture of colour and depth beside each other.
SIDES = ("right", "left", "top", "bottom")


def read_side_by_side(
    path: Path, side: str
) -> tuple[NDArray[np.uint8], NDArray[np.bool_] | None, DepthFile]:
    """Halves of a picture: colour, the mask of its opaque pixels, and 8-bit depth.

    * `side`: one of `SIDES`, that of the depth.

    Raises `FileError`: as of `read_color` and `read_depth`, or a depth half in colour.
    """
    if is_exr(path):
        raise FileError(f"{path}: is an EXR, which has depth in a channel; give it as --depth")
    picture, opaque = _decoded_color(path)
    axis = 1 if side in ("right", "left") else 0
    if picture.shape[axis] % 2:
        raise FileError(
            f"{path}: {picture.shape[1]} x {picture.shape[0]} pixels have no equal halves for "
            f"--depth {side}; crop it to an even {'height' if axis == 0 else 'width'}"
        )
    is_first = side in ("left", "top")

    def half(values: np.ndarray, first: bool) -> np.ndarray:
        part: np.ndarray = np.split(values, 2, axis=axis)[0 if first else 1]
        return part

    notes: list[str] = []
    grey = grey_numbers(path, half(picture, is_first), notes, seam=(axis, not is_first))
    file = DepthFile(grey.astype(np.float32), 255, tuple(notes))
    return half(picture, not is_first), None if opaque is None else half(opaque, not is_first), file
