"""Photographs of a display that shows the patterns: a folder of folders, one a camera position.

Pictures stay as the sensor has them: EXIF's rotation, which a phone that looks down may change from
one picture to the next, is not applied, so that all positions share one camera.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from inim.calibration.patterns import patterns
from inim.display import Display
from inim.errors import FileError
from inim.files.picture import open_picture
from inim.image.color import linear_from_srgb

_FORMATS = ("JPEG", "PNG")
_ENDINGS = (".jpg", ".jpeg", ".png")
_NOT_ONE = "not a JPEG or PNG; take it out of the folder, or save it as one"
_NUMBER = re.compile(r"(\d+)")
_CODES = np.arange(256, dtype=np.float32) / 255
_LARGEST_OF_16_BITS = 65535.0
# EXIF: where the tags are, and which say the focal length.
_EXIF_IFD = 0x8769
_FOCAL_LENGTH_35MM = 41989
_DIAGONAL_35MM = math.hypot(36, 24)


@dataclass(frozen=True)
class Position:
    """Photographs from one camera position."""

    name: str  #: Name of its folder.
    #: One photograph for each of `inim.calibration.patterns.patterns`, in that order.
    photographs: tuple[Path, ...]
    shape: tuple[int, int]  #: (rows, columns): size of every photograph.
    panel: tuple[int, int]  #: (rows, columns): size of the panel that showed the patterns.
    #: Focal length from EXIF, computed from the one for 35 mm film (CIPA DCG-001: equal diagonal),
    #: which cameras round to whole millimetres; None without EXIF.
    focal_length_px: float | None


def read_positions(folder: Path, display: Display) -> list[Position]:
    """All camera positions of a folder, by name; within each, names sort in shooting order.

    Numbers in names count as numbers: ``9.jpg`` comes before ``10.jpg``. Hidden files are left out.

    * `display`: whose patterns were shown.

    Raises `FileError`: no such folder, or none in it; a file that is no picture; a number of
    pictures that is not that of the patterns; pictures of different sizes, within a position or
    between them.
    """
    if not folder.is_dir():
        raise FileError(f"{folder}: no such folder; give a folder with one subfolder per position")
    folders = sorted((p for p in _visible(folder) if p.is_dir()), key=_natural_sort_key)
    if not folders:
        raise FileError(
            f"{folder}: contains no folders; put the photographs of each camera position into a "
            "separate subfolder"
        )
    positions = [read_position(position, display) for position in folders]
    for other in positions[1:]:
        if other.shape != positions[0].shape:
            raise FileError(
                f"{other.photographs[0]}: has {_size(other.shape)} pixels, but those of "
                f"{positions[0].name} have {_size(positions[0].shape)}; photograph all positions "
                "with one camera in the same orientation"
            )
    return positions


def read_position(folder: Path, display: Display) -> Position:
    """One camera position, its folder's photographs; see `read_positions`."""
    paths = tuple(sorted(_visible(folder), key=_natural_sort_key))
    for path in paths:
        if path.suffix.lower() not in _ENDINGS:
            raise FileError(f"{path}: {_NOT_ONE}")
    pattern_count = len(patterns(display.eia_shape))
    if len(paths) != pattern_count:
        raise FileError(
            f"{folder}: {len(paths)} pictures, but display {display.name} has {pattern_count} "
            "patterns; photograph each once, or give the display whose patterns were shown"
        )
    shape, focal_length = _header(paths[0])
    for path in paths[1:]:
        if (other := _header(path)[0]) != shape:
            raise FileError(
                f"{path}: has {_size(other)} pixels, but {paths[0].name} has {_size(shape)}; "
                "photograph all patterns of a position with one camera"
            )
    return Position(folder.name, paths, shape, display.eia_shape, focal_length)


def _visible(folder: Path) -> list[Path]:
    try:
        return [path for path in folder.iterdir() if not path.name.startswith(".")]
    except OSError as error:
        raise FileError(f"{folder}: cannot be read ({error.strerror})") from None


def _natural_sort_key(path: Path) -> list[tuple[int, str]]:
    """A key by which names sort, numbers in them as numbers."""
    parts = _NUMBER.split(path.name.lower())
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]


def _size(shape: tuple[int, int]) -> str:
    return f"{shape[1]} x {shape[0]}"


def _header(path: Path) -> tuple[tuple[int, int], float | None]:
    """Rows and columns of a photograph, and its focal length in pixels."""
    with open_picture(path, _FORMATS, 1, _NOT_ONE) as picture:
        shape = (picture.height, picture.width)
        stated = picture.getexif().get_ifd(_EXIF_IFD).get(_FOCAL_LENGTH_35MM)
    try:
        millimetres = float(stated)
    except (TypeError, ValueError, ZeroDivisionError):
        return shape, None
    if not (math.isfinite(millimetres) and millimetres > 0):
        return shape, None
    return shape, millimetres / _DIAGONAL_35MM * math.hypot(*shape)


def read_colors(path: Path) -> np.ndarray:
    """The linear colours of a photograph, (rows, columns, 3) float32; as `read_photograph`."""
    with open_picture(path, _FORMATS, 1, _NOT_ONE) as picture:
        codes = np.asarray(picture.convert("RGB"))
    light: np.ndarray = linear_from_srgb(_CODES)[codes]
    return light


def read_photograph(path: Path) -> np.ndarray:
    """Linear light of a photograph, (rows, columns) float32; 1 is its brightest code.

    A colour photograph is converted to the luma of its codes. For a panel's greys of any tint, a
    power of the light remains a power of the luma.

    Raises `FileError`: the file is missing, damaged or of another kind.
    """
    with open_picture(path, _FORMATS, 1, _NOT_ONE) as picture:
        if picture.mode.startswith("I"):
            return linear_from_srgb(np.asarray(picture, np.float32) / _LARGEST_OF_16_BITS)
        picture.draft("L", picture.size)  # a JPEG's luma alone is decoded
        codes = np.asarray(picture.convert("L"))
    light: np.ndarray = linear_from_srgb(_CODES)[codes]
    return light
