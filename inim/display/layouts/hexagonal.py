"""`hexagonal`: every other row, the second from the top first, is half a pitch to the right.

A lens's cell has the points that are nearest to its centre.
"""

import math
from fractions import Fraction
from typing import Any

import numpy as np

from inim.display.layouts.layout import NUMPY_OPS, Layout, Ops


class Hexagonal(Layout):
    """Staggered rows of lenses."""

    name = "hexagonal"
    neighbours = ((1, 0), (-1, 0), (0.5, 1), (-0.5, 1), (0.5, -1), (-0.5, -1))
    shader = """
// The nearest one in a row counted from the bottom; and its distance^2.
vec4 in_row(vec2 point, float row) {
  float from_top = lenses.y - 1.0 - row;
  float odd = from_top - 2.0 * floor(from_top / 2.0);
  float aside = lenses.y > 1.0 ? odd / 2.0 - 0.25 : 0.0;
  float column = floor(point.x / pitch.x + lenses.x / 2.0 - aside);
  vec2 centre = (vec2(column + aside, row) + 0.5 - lenses / 2.0) * pitch;
  bool inside = column >= 0.0 && column < lenses.x && row >= 0.0 && row < lenses.y;
  return vec4(centre, inside ? 1.0 : 0.0, dot(point - centre, point - centre));
}

vec3 lens_centre(vec2 point) {
  float lower = floor(point.y / pitch.y + lenses.y / 2.0 - 0.5);
  vec4 below = in_row(point, lower), above = in_row(point, lower + 1.0);
  return above.w < below.w ? above.xyz : below.xyz;
}
"""

    @staticmethod
    def usual_row_pitch_mm(pitch_mm: float) -> float:
        """See `Layout.usual_row_pitch_mm`."""
        return pitch_mm * (math.sqrt(3) / 2)

    @property
    def size(self) -> tuple[Fraction, Fraction]:
        """See `Layout.size`: staggered rows add half a pitch."""
        rows, columns = self.grid
        return columns + Fraction(rows > 1, 2), Fraction(rows)

    @property
    def view_cell_mm(self) -> tuple[float, float]:
        """See `Layout.view_cell_mm`."""
        return self.display.width_mm / self.grid[1], self.display.row_pitch_mm

    @staticmethod
    def cell_height(pitch: float, row_pitch: float) -> float:
        """See `Layout.cell_height`: to where three cells meet, unless rows are far closer."""
        return min(row_pitch + pitch**2 / (4 * row_pitch), 2 * row_pitch)

    def find_rays(
        self,
        x: np.ndarray,
        y: np.ndarray,
        offset: tuple[float, float],  # noqa: ARG002
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `Layout.find_rays`."""
        across, down = self._in_cells(x, y)
        # A point's nearest centre lies in the row of centres above it or in the one below.
        upper = np.floor(down - 0.5)
        rows = upper, upper + 1
        staggers = [_stagger(NUMPY_OPS, row, self.grid[0]) for row in rows]
        columns = [np.floor(across - stagger) for stagger in staggers]
        squares = [
            ((across - column - 0.5 - stagger) * self.display.elemental_image_pitch_mm) ** 2
            + ((down - row - 0.5) * self.display.elemental_row_pitch_mm) ** 2
            for row, column, stagger in zip(rows, columns, staggers, strict=True)
        ]
        above = squares[0] < squares[1]
        return self._through_centres(
            *(np.where(above, *pair) for pair in (rows, columns, staggers))
        )

    @classmethod
    def lens_centre(cls, array: Any, ops: Ops, x: Any, y: Any) -> tuple[Any, Any, Any]:
        """See `Layout.lens_centre`."""
        lower = ops.floor(y / array.pitch_y + array.half_rows - 0.5)
        below = _nearest_in_row(array, ops, x, y, lower)
        above = _nearest_in_row(array, ops, x, y, lower + 1)
        nearer = above[3] < below[3]
        centre_x, centre_y, inside, _ = (
            ops.where(nearer, a, b) for a, b in zip(above, below, strict=True)
        )
        return centre_x, centre_y, inside

    @classmethod
    def reach_squared(cls, array: Any, ops: Ops) -> Any:
        """See `Layout.reach_squared`."""
        p, q = array.pitch_x, array.pitch_y
        # Circumradius of two neighbours and the lens between them in the next row; where rows are
        # very close, the point of a row that is as far from both.
        corner = (p * p / 4.0 + q * q) / ops.where(2.0 * q > p, 2.0 * q, p)
        return corner * corner


def _stagger(ops: Ops, row: Any, rows: Any) -> Any:
    """Offset of a row to the right, in pitches: a quarter to one side or the other."""
    odd = row - 2 * ops.floor(row / 2)
    return ops.where(rows > 1, odd / 2 - 0.25, 0.0)


def _nearest_in_row(array: Any, ops: Ops, x: Any, y: Any, row: Any) -> tuple[Any, Any, Any, Any]:
    """Nearest centre in a row counted from the bottom, whether it exists, and its distance^2."""
    rows = 2 * array.half_rows
    row_offset = _stagger(ops, rows - 1 - row, rows)
    column = ops.floor(x / array.pitch_x + array.half_columns - row_offset)
    centre_x = (column + 0.5 - array.half_columns + row_offset) * array.pitch_x
    centre_y = (row + 0.5 - array.half_rows) * array.pitch_y
    inside = (column >= 0) & (column < 2 * array.half_columns)
    inside &= (row >= 0) & (row < 2 * array.half_rows)
    return centre_x, centre_y, inside, (x - centre_x) ** 2 + (y - centre_y) ** 2
