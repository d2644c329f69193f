"""Sub-pixels whose places differ between pixels: `Display.subpixel_cells`."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from inim.display.declaration import parse_rows, rows_text
from inim.display.parameters import Cells
from inim.system.errors import DisplayError

if TYPE_CHECKING:
    from inim.display.display import Display

#: Kind of a pixel, by its column from the left and its row from the bottom of the panel.
CELL_PATTERNS: dict[str, Callable[[Any, Any], Any]] = {
    "single": lambda column, row: 0 * (column + row),
    "checkerboard": lambda column, row: (column + row) % 2,
    "columns": lambda column, row: column % 2 + 0 * row,
    "rows": lambda column, row: row % 2 + 0 * column,
    "rows-of-4": lambda column, row: row % 4 + 0 * column,
    "staggered": lambda column, row: (row + 2 * (column % 2)) % 4,
}
# Of all patterns, across and up.
_PERIOD = 4
# Of red, green and blue, right and up.
_NUMBERS = 6
# More is no place in a pixel, or next to it.
_FARTHEST = 1.0


def parse_cells(cells: str | Sequence[Sequence[float]]) -> Cells:
    """Kinds of pixels, six numbers each.

    * `cells`: rows of numbers, or text with a comma between kinds; ``"none"`` or empty: no kinds.

    Raises `ValueError`: not six numbers, or centres outside a pixel and its neighbours.
    """
    try:
        numbers: Cells = parse_rows(cells, columns=_NUMBERS)
    except ValueError:
        numbers = ((math.nan,),)
    # Not a number is not within the bounds either.
    if not all(abs(number) <= _FARTHEST for row in numbers for number in row):
        raise ValueError(
            f"write six numbers of at most {_FARTHEST:g} for each kind of pixel: red, green and "
            "blue, each right and up of its centre"
        )
    return numbers


def check_cells(display: Display) -> None:
    """Raise `DisplayError` unless a display has kinds of pixels exactly where it uses them."""
    if (display.subpixels == "cells") != bool(display.subpixel_cells):
        raise DisplayError(
            f"subpixels = {display.subpixels!r}, subpixel_cells = "
            f"{rows_text(display.subpixel_cells)!r}: 'cells' needs subpixel_cells, and no other "
            "subpixels have them"
        )


def cell_centres(
    display: Display, rows: slice, columns: slice, channel: int
) -> tuple[np.ndarray, np.ndarray]:
    """Centres of a colour's sub-pixels, right and up of the pixels' centres, in pixels.

    (rows, columns) float64 each, of a block of panel rows.
    """
    panel_rows, panel_columns = display.eia_shape
    from_bottom = panel_rows - 1 - np.arange(rows.start, rows.stop)[:, None]
    return cell_offsets(display, np.arange(panel_columns)[None, columns], from_bottom, channel)


def cell_offsets(
    display: Display, column: np.ndarray, from_bottom: np.ndarray, channel: int
) -> tuple[np.ndarray, np.ndarray]:
    """Centres of a colour's sub-pixels as `cell_centres`, of some pixels.

    * `column`, `from_bottom`, arrays of int: columns from the left, and rows from the bottom.
    """
    kinds = CELL_PATTERNS[display.cell_pattern](column, from_bottom)
    table = np.array(display.subpixel_cells)
    kinds = kinds % len(table)
    return table[kinds, 2 * channel], table[kinds, 2 * channel + 1]


def kinds_of_pixels(display: Display) -> list[int]:
    """Kinds of 4 x 4 pixels, which repeat over the panel: by column, in rows upwards."""
    column, from_bottom = np.arange(_PERIOD), np.arange(_PERIOD)[:, None]
    kinds = CELL_PATTERNS[display.cell_pattern](column, from_bottom)
    return [int(kind) for kind in (kinds % max(1, len(display.subpixel_cells))).ravel()]


def farthest_cell(display: Display) -> tuple[float, float]:
    """Largest distances of a sub-pixel's centre from its pixel's, across and up, in pixels."""
    across, up = (
        max((abs(number) for row in display.subpixel_cells for number in row[axis::2]), default=0.0)
        for axis in (0, 1)
    )
    return across, up
