"""Pictures that a scene names, checked before the renderer's own readers trust them.

Mitsuba goes by the content, whatever a file is called, and allocates what a header declares.
"""

from __future__ import annotations

import warnings
from pathlib import Path

from inim.errors import FileError
from inim.files.image import check_exr, check_unfolding
from inim.files.png import check_png
from inim.files.radiance import check_pfm, check_radiance, is_pfm, is_radiance

__all__ = ["check_picture", "is_exr"]

_EXR_MAGIC = b"\x76\x2f\x31\x01"
_HEAD_BYTES = 16
# Mitsuba's readers of BMP, TGA and PPM trust what they read.
_FORMATS = ("PNG", "JPEG")
# A texture becomes floats.
_SAMPLE_BYTES = 4


def check_picture(path: Path) -> None:
    """Refuse a picture that Mitsuba's textures and environment maps cannot take safely.

    Parameters
    ----------
    path : Path
        EXR, PNG, JPEG, Radiance HDR or PFM.

    Raises
    ------
    FileError
        Missing, damaged, cut short, of another kind, or unfolding to far more than its size.
    """
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
        if is_pfm(head):
            check_pfm(path, path.read_bytes())
        elif is_radiance(head):
            check_radiance(path, path.read_bytes())
    except OSError as error:
        raise FileError(f"{path}: cannot be read ({error.strerror})") from None
    if head.startswith(_EXR_MAGIC):
        check_exr(path)
    elif not is_pfm(head) and not is_radiance(head):
        _decode(path)


def is_exr(path: Path) -> bool:
    """Whether a file opens as an EXR, whatever it is called."""
    with path.open("rb") as file:
        return file.read(len(_EXR_MAGIC)) == _EXR_MAGIC


def _decode(path: Path) -> None:
    from PIL import Image

    check_png(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # on sizes, which are checked below
            with Image.open(path, formats=_FORMATS) as picture:
                samples = picture.width * picture.height * len(picture.getbands())
                check_unfolding(path, _SAMPLE_BYTES * samples)
                picture.load()
    except FileError:
        raise
    except Image.UnidentifiedImageError as error:
        raise FileError(
            f"{path}: not a picture that inim reads (EXR, PNG, JPEG, HDR, PFM); save it as PNG or "
            "EXR"
        ) from error
    except Exception as error:
        cause = getattr(error, "strerror", None) or str(error).partition("\n")[0]
        raise FileError(f"{path}: not a readable picture ({cause}); save it anew") from error
