"""Patterns that a display shows for calibration, and the page that shows them.

White and black come first. Then follow, for the columns and after that for the rows, Gray codes of
the cell floor(pixel / 8), coarsest bit first, each with its inverse, and a cosine with a period of
16 panel pixels at 0, 90, 180 and 270 degrees. Codes are sRGB, so that linear light is the cosine.
For a panel with another gamma, four steps cancel the second harmonic. The Gray code selects the
period, and the cosine gives the position in it. A cell is half a period, so an error at a cell's
edge does not change the period (Salvi et al., Pattern Recognition 43, 2666, 2010, on such codes in
general).
"""

from __future__ import annotations

import base64
import html
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import numpy as np

from inim.display import Display
from inim.documents.display import PatternsDocument
from inim.documents.document import encode
from inim.files.image import encode_image
from inim.image.color import srgb_from_linear, srgb_to_uint8
from inim.version import __version__
from inim.worker.output import output_files

#: File name of the page that shows the pictures.
PAGE = "patterns.html"
#: Panel pixels of a period of the cosine, and of a cell of the Gray code.
PERIOD, CELL = 16, 8
_MARKER = "patterns.json"
_WHITE = 255
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

    Raises `FileError`: the folder cannot be written, or another file is in the way.
    """
    rows, columns = display.eia_shape
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
