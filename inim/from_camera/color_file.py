"""The colour picture of a camera."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inim.errors import FileError
from inim.files.image import check_unfolding, read_exr_texture
from inim.files.picture import is_exr
from inim.files.png import check_png

__all__ = ["read_color"]

_FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "WEBP", "PPM")
_OPAQUE = 255
_CODES_OF_16_BITS = 65535 / 255


def read_color(path: Path) -> NDArray[np.uint8] | NDArray[np.float32]:
    """A colour picture, upright as its camera says (EXIF).

    Parameters
    ----------
    path : Path
        PNG, JPEG, TIFF, BMP, WebP or PPM, taken as sRGB, over black where transparent; or a
        linear EXR.

    Returns
    -------
    (H, W, 3) uint8 sRGB, or (H, W, 3) float32 linear RGB of an EXR
        Row 0 on top.

    Raises
    ------
    FileError
        Missing, damaged or of another kind.
    """
    if not path.is_file():
        raise FileError(f"{path}: no such file")
    if is_exr(path):
        linear = read_exr_texture(path)
        if not np.isfinite(linear).all():
            raise FileError(f"{path}: holds colours that are not finite; save it anew")
        return np.broadcast_to(linear, (*linear.shape[:2], 3)) if linear.shape[2] == 1 else linear
    return _decoded(path)


def _decoded(path: Path) -> NDArray[np.uint8]:
    from PIL import Image, ImageOps

    check_png(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # on sizes, which are checked below
            with Image.open(path, formats=_FORMATS) as picture:
                check_unfolding(path, picture.width * picture.height * len(picture.getbands()))
                upright = ImageOps.exif_transpose(picture)
                if upright.mode.startswith("I"):  # Pillow would cut 16 bits off at 255
                    grey = np.asarray(upright, np.float32) / _CODES_OF_16_BITS
                    codes = np.rint(np.clip(grey, 0, 255)).astype(np.uint8)
                    return np.repeat(codes[..., None], 3, axis=-1)
                if "A" not in upright.getbands() and "transparency" not in upright.info:
                    return np.asarray(upright.convert("RGB"))
                rgba = upright.convert("RGBA")
                black = Image.new("RGBA", rgba.size, (0, 0, 0, _OPAQUE))
                return np.asarray(Image.alpha_composite(black, rgba).convert("RGB"))
    except FileError:
        raise
    except Image.UnidentifiedImageError as error:
        raise FileError(
            f"{path}: not a colour picture that inim reads; save it as PNG, JPEG or EXR"
        ) from error
    except Exception as error:
        cause = getattr(error, "strerror", None) or str(error).partition("\n")[0]
        raise FileError(f"{path}: not a readable picture ({cause}); save it anew") from error
