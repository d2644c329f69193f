"""`square`: rows and columns of lenses, whose cells are rectangles."""

from typing import Any

import numpy as np

from inim.display.layouts.layout import Layout, Ops


class Square(Layout):
    """Rows and columns of lenses."""

    name = "square"
    has_rows_and_columns = True
    neighbours = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))
    shader = """
vec3 lens_centre(vec2 point) {
  vec2 cell = floor(point / pitch + lenses / 2.0);
  vec2 inside = step(vec2(0.0), cell) * step(cell, lenses - 1.0);
  return vec3((cell + 0.5 - lenses / 2.0) * pitch, inside.x * inside.y);
}
"""

    def find_rays(
        self,
        x: np.ndarray,
        y: np.ndarray,
        offset: tuple[float, float],  # noqa: ARG002
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `Layout.find_rays`."""
        across, down = self._in_cells(x, y)
        return self._through_centres(np.floor(down), np.floor(across))

    @classmethod
    def lens_centre(cls, array: Any, ops: Ops, x: Any, y: Any) -> tuple[Any, Any, Any]:
        """See `Layout.lens_centre`."""
        column = ops.floor(x / array.pitch_x + array.half_columns)
        row = ops.floor(y / array.pitch_y + array.half_rows)
        inside = (column >= 0) & (column < 2 * array.half_columns)
        inside &= (row >= 0) & (row < 2 * array.half_rows)
        centre_x = (column + 0.5 - array.half_columns) * array.pitch_x
        return centre_x, (row + 0.5 - array.half_rows) * array.pitch_y, inside
