"""Patterns that a display shows for calibration, the page that shows them, and photographs of them.

White comes first. Then follow, for the columns and after that for the rows, a cosine of linear
light at 0, 120 and 240 degrees. Its phase gives the panel point modulo a period. Adjacent lenses
see points a pitch apart, which is 129 degrees of the period: steps of -1, 0 and 1 lens are nearly
as far apart as they can be. At exactly three pitches, the error of a wrong gamma, which has three
periods in one of the cosine, would be the same in all lenses.

Cylinders need not be seen one by one. The cosines are far wider then, because a photograph is
smoothed over the lenses. Three more patterns show a cosine of the view: of each sub-pixel's place
in its elemental image, as the nominal display has it. Where the array differs from that, the
photograph has fringes (the moire of the two), whose phase counts lenses. Fringes along the axes are
added on purpose, so that the phase takes all values in each photograph.

Dark marks in the white pattern number the periods. They are in the middle of some periods, in an
arrangement that does not repeat. The rest of the panel is white.

Photographs stay as the sensor has them: EXIF's rotation, which a phone that looks down may change
from one picture to the next, is not applied, so that all positions share one camera.
"""

from __future__ import annotations

import base64
import html
import math
import re
from dataclasses import dataclass
from fractions import Fraction
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import numpy as np

from inim.calibration.video import ENDINGS, video_shape
from inim.display import Display
from inim.display.pixels import SUBPIXELS, PixelOffset, ray_starts
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
#: Half the width of a mark, in periods: at least one lens looks into each mark.
MARK = 0.27
_MARKER = "patterns.json"
_PERIOD_PITCHES, _PERIOD_CYLINDERS = 2.8, 20.0
# Of the fringes along the axes, in elemental images.
_FRINGE_PITCHES = 30.0
_SHIFTS_DEG = (0, 120, 240)
# Share of the periods with a mark. The steps of their sequence are irrational.
_MARKED_SHARE = 0.15
_MARK_STEPS = (0.7548776662, 0.5698402910, 0.6180339887)
# Where to photograph lenses in rows, and cylinders.
_POSITIONS = (
    "Two positions or more, 15 to 25° off the display's axis: one from the side, one from above or "
    "below.",
    "Three positions: straight on, and 10 to 15° off the display's axis from the left and from the "
    "right. The whole panel is visible from each.",
)
# Of pictures in today's browsers.
_LONGEST_SIDE_PX = 32767


class Pattern(NamedTuple):
    """Pattern on the panel."""

    name: str  #: Name of its file without the ending; names sort in display order.
    #: (rows or 1, columns or 1) uint8: sRGB grey; an axis of length 1 is constant. Of views,
    #: (rows, columns, 3).
    codes: np.ndarray


def periods_px(display: Display) -> np.ndarray:
    """Periods of the cosines of columns and rows, panel pixels."""
    pitches = np.array([display.pitch_mm, display.row_pitch_mm])
    period = _PERIOD_CYLINDERS if display.layout.of_cylinders else _PERIOD_PITCHES
    return np.rint(period * pitches / display.pixel_pitch_mm)


def view_phase(display: Display, x_mm: np.ndarray, y_mm: np.ndarray) -> np.ndarray:
    """Phase of the view patterns at panel points of the display frame, in periods.

    Elemental images from the left edge of the central one, and the fringes.
    """
    angle, pitch = math.radians(display.rotation_deg), display.elemental_image_pitch_mm
    across = math.cos(angle) * (x_mm - display.shift_x_mm) + math.sin(angle) * (
        y_mm - display.shift_y_mm
    )
    phase: np.ndarray = across / pitch + 0.5 + y_mm / (_FRINGE_PITCHES * pitch)
    return phase


def _view_phases(display: Display) -> np.ndarray:
    """`view_phase` of the centres of all sub-pixels, (rows, columns, 3)."""
    rows = slice(0, display.eia_shape[0])
    phases = []
    for colour in SUBPIXELS[display.subpixels]:
        offset = PixelOffset(Fraction(0), colour.right, colour.channel)
        x, y, _, _ = ray_starts(display, rows, offset)
        phases.append(view_phase(display, x, y))
    return np.stack(phases, axis=-1)


def _axes(display: Display) -> int:
    """Number of cosines, each of which is shown in all shifts."""
    return 3 if display.layout.of_cylinders else 2


def marks_begin(display: Display) -> float:
    """Start of the arrangement of the marks; displays with other views have other ones."""
    if not display.layout.of_cylinders:
        return 0.0
    corner = np.array(display.width_mm / 2), np.array(display.height_mm / 2)
    return float(view_phase(display, *corner))


def has_mark(
    column: np.ndarray, row: np.ndarray, periods_px: np.ndarray, begin: float = 0.0
) -> np.ndarray:
    """True for periods with a mark, given by column and row from the panel's centre.

    * `periods_px`, `begin`: each pair of periods, and `marks_begin`, has its own arrangement.
    """
    a, b, c = _MARK_STEPS
    begin = begin + c * (periods_px**2).sum()
    marked: np.ndarray = (begin + a * column**2 + b * row**2 + c * column * row) % 1 < _MARKED_SHARE
    return marked


def patterns(display: Display) -> list[Pattern]:
    """All patterns for a display, in the order of display."""
    rows, columns = display.eia_shape
    periods = periods_px(display)
    # In periods from the panel's centre.
    x, y = (
        (np.arange(size) + 0.5 - size / 2) / period
        for size, period in zip((columns, rows), periods, strict=True)
    )
    x, y = x[None], y[:, None]
    in_mark = (np.abs(x - np.rint(x)) < MARK) & (np.abs(y - np.rint(y)) < MARK)
    is_dark = in_mark & has_mark(np.rint(x), np.rint(y), periods, marks_begin(display))
    sequence = [("white", np.where(is_dark, 0.0, 1.0))]
    positions = {"column": x, "row": y}
    if _axes(display) > len(positions):
        positions["view"] = _view_phases(display)
    for axis, position in positions.items():
        for shift in _SHIFTS_DEG:
            light = 0.5 + 0.5 * np.cos(2 * np.pi * position - np.radians(shift))
            sequence.append((f"{axis}-phase-{shift:03d}", light))
    digits = len(str(len(sequence)))
    return [
        Pattern(f"{number:0{digits}}-{name}", srgb_to_uint8(srgb_from_linear(light)))
        for number, (name, light) in enumerate(sequence, 1)
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
    for name, codes in patterns(display):
        whole = np.broadcast_to(codes, (rows, columns, *codes.shape[2:]))
        pictures[f"{name}.png"] = encode_image(whole, "PNG", optimize=True)
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
        "POSITIONS": _POSITIONS[display.layout.of_cylinders],
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
    """Photographs, or a video, from one camera position."""

    name: str  #: Name of its folder, or of its video without the ending.
    source: Path  #: The folder or the video.
    #: One photograph for each of `patterns`, in that order; None: missing. Of a video, the video.
    photographs: tuple[Path | None, ...]
    shape: tuple[int, int]  #: (rows, columns): size of every photograph.
    #: Focal length from EXIF, computed from the one for 35 mm film (CIPA DCG-001: equal diagonal),
    #: which cameras round to whole millimetres; None without EXIF.
    focal_length_px: float | None
    periods_px: np.ndarray  #: Periods of the cosines of columns and rows, panel pixels.
    #: Pitch of the cylinders, over which photographs are smoothed, panel pixels; None: lenses are
    #: seen one by one.
    cylinder_px: float | None = None


def read_positions(folder: Path, display: Display) -> list[Position]:
    """All camera positions of a folder, by name; within each, names sort in shooting order.

    A position is a folder of photographs, or a video.

    Numbers in names count as numbers: ``9.jpg`` comes before ``10.jpg``. Hidden files are left out.

    * `display`: whose patterns were shown.

    Raises `FileError`: no such folder, or none in it; a file that is no picture; a number of
    pictures that is not that of the patterns; pictures of different sizes. One missing picture is
    recognised by the gap in the names' numbers.
    """
    if not folder.is_dir():
        raise FileError(f"{folder}: no such folder; give a folder with one subfolder per position")
    sources = sorted(
        (p for p in _visible(folder) if p.is_dir() or p.suffix.lower() in ENDINGS),
        key=_natural_sort_key,
    )
    if not sources:
        raise FileError(
            f"{folder}: contains no folders and no videos; put the photographs of each camera "
            "position into a separate subfolder, or a video of each position into this folder"
        )
    positions = [read_position(source, display) for source in sources]
    if len({position.name for position in positions}) < len(positions):
        raise FileError(f"{folder}: contains two positions of one name; rename one of them")
    for other in positions[1:]:
        if other.shape != positions[0].shape:
            raise FileError(
                f"{other.source}: has {_size(other.shape)} pixels, but those of "
                f"{positions[0].name} have {_size(positions[0].shape)}; photograph all positions "
                "with one camera in the same orientation"
            )
    return positions


def read_position(folder: Path, display: Display) -> Position:
    """One camera position, its folder's photographs or its video; see `read_positions`."""
    count = 1 + _axes(display) * len(_SHIFTS_DEG)
    pitch_px = display.pitch_mm / display.pixel_pitch_mm
    scales = periods_px(display), pitch_px if display.layout.of_cylinders else None
    if folder.suffix.lower() in ENDINGS and not folder.is_dir():
        shape = video_shape(folder)
        return Position(folder.stem, folder, (folder,) * count, shape, None, *scales)
    files = sorted(_visible(folder), key=_natural_sort_key)
    for path in files:
        if path.suffix.lower() not in _ENDINGS:
            raise FileError(f"{path}: {_NOT_ONE}")
    paths: list[Path | None] = [*files]
    if len(paths) == count - 1:
        numbers = [int("".join(_NUMBER.findall(path.stem)[-1:]) or 0) for path in files]
        gaps = np.flatnonzero(np.diff(numbers) == 2)
        if len(gaps) == 1 and (np.diff(numbers) > 0).all():
            paths.insert(int(gaps[0]) + 1, None)
    if len(paths) != count:
        raise FileError(
            f"{folder}: {len(paths)} pictures, but there are {count} patterns; photograph each "
            "once. An empty file stands for one missing photograph, such as IMG_0003.jpg between "
            "IMG_0002.jpg and IMG_0004.jpg"
        )
    for path in files:
        if path.stat().st_size:
            return Position(folder.name, folder, tuple(paths), *_header(path), *scales)
    raise FileError(f"{folder}: all pictures are empty; copy the photographs again")


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

    Of a colour photograph, the green channel: it sees the panel's green sub-pixels, whose places
    are known. The luma's place in a pixel depends on the colours of panel and camera.

    Raises `FileError`: the file is missing, damaged or of another kind.
    """
    with open_picture(path, _FORMATS, 1, _NOT_ONE) as picture:
        if picture.mode.startswith("I"):
            return linear_from_srgb(np.asarray(picture, np.float32) / _LARGEST_OF_16_BITS)
        codes = np.asarray(picture.convert("RGB").getchannel("G"))
    light: np.ndarray = linear_from_srgb(_CODES)[codes]
    return light
