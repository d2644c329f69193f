"""Types of a display's parameters."""

from collections.abc import Sequence
from typing import Any, Literal, TypedDict

CurvedSide = Literal["viewer", "panel"]
Lattice = Literal["square", "hexagonal", "lenticular"]
Aperture = Literal["square", "round"]
BetweenLenses = Literal["dark", "clear"]
Subpixels = Literal["none", "rgb-stripe", "pentile", "cells"]
CellPattern = Literal["single", "checkerboard", "columns", "rows", "rows-of-4", "staggered"]
#: Red's, green's and blue's centre, right and up of the pixel's in pixels, of each kind of pixel.
Cells = tuple[tuple[float, ...], ...]
#: Layers between lenses and panel, from the lenses on: thickness in mm, refractive index.
Layers = tuple[tuple[float, float], ...]


# Text of no rows.
_NO_ROWS = "none"


def parse_rows(value: str | Sequence[Sequence[float]], *, columns: int) -> tuple[Any, ...]:
    """Rows of numbers, as tuples of floats.

    * `value`: rows, or text with a comma between rows; ``"none"`` or empty: no rows.

    Raises `ValueError`: no numbers, or not `columns` of them in each row.
    """
    rows: Any = value
    if isinstance(value, str):
        text = "" if value.strip() == _NO_ROWS else value
        rows = [part.split() for part in text.split(",") if part.strip()]
    try:
        numbers = tuple(tuple(float(number) for number in row) for row in rows)
    except TypeError as error:
        raise ValueError(*error.args) from None
    if any(len(row) != columns for row in numbers):
        raise ValueError(f"not {columns} numbers")
    return numbers


def rows_text(rows: Sequence[Sequence[float]]) -> str:
    """Text of rows of numbers, as `parse_rows` reads it."""
    return ", ".join(" ".join(map(repr, row)) for row in rows) or _NO_ROWS


class DisplayParameters(TypedDict, total=False):
    """Parameters of a display, for type checkers: the fields of `Display`."""

    pitch_mm: float
    focal_length_mm: float
    gap_mm: float
    pixel_pitch_mm: float
    lens_columns: int
    lens_rows: int
    panel_columns: int | None
    panel_rows: int | None
    depth_min_mm: float | None
    depth_max_mm: float | None
    elemental_pitch_mm: float | None
    refractive_index: float
    lens_thickness_mm: float | None
    curved_side: CurvedSide
    conic: float
    asphere_a4: float
    asphere_a6: float
    abbe_number: float | None
    pitch_y_mm: float | None
    lattice: Lattice
    aperture: Aperture
    fill_factor: float
    between_lenses: BetweenLenses
    layers: Layers
    shift_x_mm: float
    shift_y_mm: float
    rotation_deg: float
    tilt_x_deg: float
    tilt_y_deg: float
    subpixels: Subpixels
    subpixel_cells: Cells
    cell_pattern: CellPattern
    pixel_fill: float
    black_level: float
    ambient_reflection: float
    veiling_glare: float
    white_point_k: float | None
    name: str
