"""Patterns that a display shows for calibration, the page that shows them, and photographs of them.

White and black come first. Then follow, for the columns and after that for the rows, Gray codes of
the cell floor(pixel / 8), coarsest bit first, each with its inverse, and a cosine with a period of
16 panel pixels at 0, 90, 180 and 270 degrees. Codes are sRGB, so that linear light is the cosine.
For a panel with another gamma, four steps cancel the second harmonic. The Gray code selects the
period, and the cosine gives the position in it. A cell is half a period, so an error at a cell's
edge does not change the period (Salvi et al., Pattern Recognition 43, 2666, 2010, on such codes in
general).

Photographs stay as the sensor has them: EXIF's rotation, which a phone that looks down may change
from one picture to the next, is not applied, so that all positions share one camera.
"""

from __future__ import annotations

import base64
import html
import math
import re
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import numpy as np

from inim.display import Display
from inim.documents.display import PatternsDocument
from inim.documents.document import encode
from inim.errors import FileError, UsageError
from inim.files.image import encode_image
from inim.files.picture import DIAGONAL_35MM, open_picture, read_exif
from inim.image.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.version import __version__
from inim.worker.output import output_files

#: File name of the page that shows the pictures.
PAGE = "patterns.html"
#: Panel pixels of a period of the cosine, and of a cell of the Gray code.
PERIOD, CELL = 16, 8
_MARKER = "patterns.json"
_WHITE = 255
# Of pictures in today's browsers.
_LONGEST_SIDE_PX = 32767
_SHIFTS_DEG = (0, 90, 180, 270)


class Pattern(NamedTuple):
    """Pattern that varies along one axis of the panel, or is constant."""

    name: str  #: Name of its file without the ending; names sort in display order.
    #: (rows or 1, columns or 1) uint8: sRGB grey; an axis of length 1 is constant.
    codes: np.ndarray


def bit_count(pixels: int) -> int:
    """Bits of the Gray code for all cells of an axis."""
    return max(1, ((pixels - 1) // CELL).bit_length())


def patterns(panel: tuple[int, int]) -> list[Pattern]:
    """All pictures of a panel, in the order of display.

    * `panel`, (rows, columns): a display's `eia_shape`.
    """
    rows, columns = panel
    sequence = [("white", np.full((1, 1), _WHITE)), ("black", np.zeros((1, 1)))]
    for axis, pixel in (("column", np.arange(columns)), ("row", np.arange(rows)[:, None])):
        cell = pixel // CELL
        code = np.atleast_2d(cell ^ (cell >> 1))
        for bit in reversed(range(bit_count(pixel.size))):
            lit = _WHITE * ((code >> bit) & 1)
            sequence += [(f"{axis}-bit-{bit}", lit), (f"{axis}-bit-{bit}-inverse", _WHITE - lit)]
        centre = np.atleast_2d(2 * np.pi * (pixel + 0.5) / PERIOD)
        for shift in _SHIFTS_DEG:
            light = 0.5 + 0.5 * np.cos(centre - np.radians(shift))
            sequence.append((f"{axis}-phase-{shift:03d}", srgb_to_uint8(srgb_from_linear(light))))
    return [
        Pattern(f"{number:02d}-{name}", codes.astype(np.uint8))
        for number, (name, codes) in enumerate(sequence)
    ]


def write_patterns(display: Display, folder: Path) -> Path:
    """Write a display's patterns as PNG, `patterns.json`, and the page that shows them.

    * `folder`: created if missing; files from an earlier call are replaced.

    Returns path of the page.

    Raises `FileError`: the folder cannot be written, or another file is in the way; `UsageError`:
    browsers show no picture of the panel's size.
    """
    rows, columns = display.eia_shape
    if max(rows, columns) > _LONGEST_SIDE_PX:
        raise UsageError(
            f"display {display.name}: has a panel of {columns} x {rows} pixels, but browsers show "
            f"at most {_LONGEST_SIDE_PX} along a side; correct its lens_columns and lens_rows"
        )
    pictures = {}
    for name, codes in patterns((rows, columns)):
        grey = np.broadcast_to(codes, (rows, columns))
        pictures[f"{name}.png"] = encode_image(grey, "PNG", optimize=True)
    about = PatternsDocument(
        inim_version=__version__,
        display=display.name,
        panel_rows=rows,
        panel_columns=columns,
        pixel_pitch_mm=display.pixel_pitch_mm,
        pictures=list(pictures),
    )
    files = {
        _MARKER: encode(about).encode() + b"\n",
        PAGE: _page(display, pictures).encode(),
        **pictures,
    }
    with output_files(folder, list(files)) as staging:
        for name, data in files.items():
            (staging / name).write_bytes(data)
    return folder / PAGE


def _page(display: Display, pictures: dict[str, bytes]) -> str:
    """The page, which needs no other file."""
    rows, columns = display.eia_shape
    sources = {
        Path(name).stem: base64.b64encode(data).decode("ascii") for name, data in pictures.items()
    }
    images = "\n".join(
        f'<img alt="{name}" src="data:image/png;base64,{data}">' for name, data in sources.items()
    )
    words = {
        "DISPLAY": html.escape(display.name),
        "COLUMNS": str(columns),
        "ROWS": str(rows),
        "COUNT": str(len(pictures)),
        "IMAGES": images,
    }
    page = resources.files("inim.calibration").joinpath(PAGE).read_text("utf-8")
    for word, value in words.items():
        page = page.replace(f"@{word}@", value)
    return page


# -- photographs -----------------------------------------------------------------------------

_FORMATS = ("JPEG", "PNG")
_ENDINGS = (".jpg", ".jpeg", ".png")
_NOT_ONE = "not a JPEG or PNG; take it out of the folder, or save it as one"
_NUMBER = re.compile(r"(\d+)")
_CODES = np.arange(256, dtype=np.float32) / 255
_LARGEST_OF_16_BITS = 65535.0


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
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def _size(shape: tuple[int, int]) -> str:
    return f"{shape[1]} x {shape[0]}"


def _header(path: Path) -> tuple[tuple[int, int], float | None]:
    """Rows and columns of a photograph, and its focal length in pixels."""
    with open_picture(path, _FORMATS, 1, _NOT_ONE) as picture:
        shape = (picture.height, picture.width)
        _, millimetres = read_exif(picture)
    is_stated = 0 < millimetres < math.inf
    return shape, millimetres / DIAGONAL_35MM * math.hypot(*shape) if is_stated else None


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
