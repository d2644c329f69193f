"""The lens array as numbers, and the arithmetic that lens models are written in."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from inim.display import Display

__all__ = ["NUMPY_OPS", "LensArray", "Ops", "lens_array", "lens_centre"]


class Ops(NamedTuple):
    """The functions a lens model may use, so that it runs on NumPy and on Dr.Jit alike."""

    sqrt: Any
    floor: Any
    where: Any
    absolute: Any


NUMPY_OPS = Ops(np.sqrt, np.floor, np.where, np.abs)


class LensArray(NamedTuple):
    """What lens models need of a `Display`; each value may be a float or a Dr.Jit scalar.

    Lengths in millimetres. `half_columns` and `half_rows` are N / 2 and M / 2.
    """

    pitch: Any
    half_columns: Any
    half_rows: Any
    gap: Any
    index: Any
    radius: Any
    thickness: Any
    bulges_to_viewer: Any


def lens_array(display: Display) -> LensArray:
    """The numbers of a display's lens array; radius R = f (n - 1) of a plano-convex lens."""
    thickness = display.lens_thickness_mm
    return LensArray(
        pitch=display.pitch_mm,
        half_columns=display.lens_columns / 2,
        half_rows=display.lens_rows / 2,
        gap=display.gap_mm,
        index=display.refractive_index,
        radius=display.focal_length_mm * (display.refractive_index - 1),
        thickness=display.pitch_mm if thickness is None else thickness,
        bulges_to_viewer=1.0 if display.curved_side == "viewer" else 0.0,
    )


def lens_centre(array: LensArray, ops: Ops, x: Any, y: Any) -> tuple[Any, Any, Any]:
    """Centre of the lens whose cell holds (x, y), and whether the array reaches that far."""
    column = ops.floor(x / array.pitch + array.half_columns)
    row = ops.floor(y / array.pitch + array.half_rows)
    inside = (
        (column >= 0) & (column < 2 * array.half_columns) & (row >= 0) & (row < 2 * array.half_rows)
    )
    centre_x = (column + 0.5 - array.half_columns) * array.pitch
    centre_y = (row + 0.5 - array.half_rows) * array.pitch
    return centre_x, centre_y, inside
