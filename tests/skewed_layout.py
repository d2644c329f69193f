"""An invented layout: each row of lenses is farther to the right than the one below it.

It shows that a layout is one file. The tests of all arrays run with it, too.
"""

from fractions import Fraction
from typing import Any

import numpy as np

from inim.apps.stress.oracles.rays import STAGGERS
from inim.display.layouts import LAYOUTS, Layout, Ops

#: Offset of a row from the next one down, in pitches.
SKEW = Fraction(3, 10)
_S = float(SKEW)


class Skewed(Layout):
    """Rows that lean to the right; a cell has the points nearest to its centre."""

    name = "skewed"
    neighbours = (
        (1, 0), (-1, 0), (_S, 1), (_S - 1, 1), (-_S, -1), (1 - _S, -1), (_S + 1, 1), (-_S - 1, -1),
    )  # fmt: skip
    shader = f"""
vec4 in_row(vec2 point, float row) {{
  float stagger = (row - 0.5 * (lenses.y - 1.0)) * {_S};
  float column = floor(point.x / pitch.x + lenses.x / 2.0 - stagger);
  vec2 centre = (vec2(column + stagger, row) + 0.5 - lenses / 2.0) * pitch;
  bool inside = column >= 0.0 && column < lenses.x && row >= 0.0 && row < lenses.y;
  return vec4(centre, inside ? 1.0 : 0.0, dot(point - centre, point - centre));
}}
vec3 lens_centre(vec2 point) {{
  float lower = floor(point.y / pitch.y + lenses.y / 2.0 - 0.5);
  vec4 below = in_row(point, lower), above = in_row(point, lower + 1.0);
  return above.w < below.w ? above.xyz : below.xyz;
}}
"""

    @property
    def size(self) -> tuple[Fraction, Fraction]:
        rows, columns = self.grid
        return columns + SKEW * (rows - 1), Fraction(rows)

    @property
    def view_cell_mm(self) -> tuple[float, float]:
        return self.display.width_mm / self.grid[1], self.display.row_pitch_mm

    @property
    def outermost_mm(self) -> tuple[float, float]:
        across, up = super().outermost_mm
        return across + _S * (self.grid[0] - 1) / 2 * self.display.pitch_mm, up

    @staticmethod
    def cell_height(pitch: float, row_pitch: float) -> float:
        return row_pitch + _S * (1 - _S) * pitch**2 / row_pitch

    def find_rays(
        self, x: np.ndarray, y: np.ndarray, offset: tuple[float, float]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        pitches = self.display.elemental_image_pitch_mm, self.display.elemental_row_pitch_mm
        across, down = self._in_cells(x, y)
        rows = np.floor(down - 0.5) + np.arange(2)[:, None, None]
        staggers = ((self.grid[0] - 1) / 2 - rows) * _S
        columns = np.floor(across - staggers)
        right, below = across - columns - 0.5 - staggers, down - rows - 0.5
        lower = np.argmin((right * pitches[0]) ** 2 + (below * pitches[1]) ** 2, axis=0)[None]
        return self._through_centres(
            *(np.take_along_axis(v, lower, axis=0)[0] for v in (rows, columns, staggers))
        )

    @classmethod
    def lens_centre(cls, array: Any, ops: Ops, x: Any, y: Any) -> tuple[Any, Any, Any]:
        def nearest_in(row: Any) -> tuple[Any, ...]:
            stagger = (row - array.half_rows + 0.5) * _S
            column = ops.floor(x / array.pitch_x + array.half_columns - stagger)
            centre_x = (column + 0.5 - array.half_columns + stagger) * array.pitch_x
            centre_y = (row + 0.5 - array.half_rows) * array.pitch_y
            inside = (column >= 0) & (column < 2 * array.half_columns)
            inside &= (row >= 0) & (row < 2 * array.half_rows)
            return (x - centre_x) ** 2 + (y - centre_y) ** 2, centre_x, centre_y, inside

        lower = ops.floor(y / array.pitch_y + array.half_rows - 0.5)
        below, above = nearest_in(lower), nearest_in(lower + 1)
        nearer = above[0] < below[0]
        x0, y0, inside = (
            ops.where(nearer, *pair) for pair in zip(above[1:], below[1:], strict=True)
        )
        return x0, y0, inside

    @classmethod
    def reach_squared(cls, array: Any, ops: Ops) -> Any:
        p, half = array.pitch_x, cls.cell_height(array.pitch_x, array.pitch_y) / 2
        return ((1 - 2 * _S) * p / 2) ** 2 + half * half


LAYOUTS[Skewed.name] = Skewed
STAGGERS[Skewed.name] = lambda rows, count: ((count - 1) / 2 - rows) * _S
