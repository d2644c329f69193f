"""`lenticular`: cylinders next to each other, whose axes run up the array.

`Display.rotation_deg` slants them, `Display.shift_x_mm` is their phase; one stands on the array's
centre. They have no power along their axes, do not end with the panel, and each point of a pixel
has a cylinder and a ray of its own. Light spreads along the axis: the ray of a pixel is the one
that meets an eye at the height of the panel's centre, at the distance for which the elemental
images are designed, V = g P / (Q - P).
"""

import math
from collections.abc import Mapping
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np

from inim.display.layouts.layout import Layout, Ops
from inim.display.pixels import exact_ratio, least_gap_mm
from inim.system.errors import DisplayError


class Lenticular(Layout):
    """Slanted cylinders."""

    name = "lenticular"
    of_cylinders = True
    neighbours = ((1, 0), (-1, 0))
    # Views differ from side to side only. At one point, a cylinder shows one colour: a pixel of a
    # view is as wide as a cylinder and mixes them. Panels have millions of pixels, of which such a
    # pixel shows many: few samples of each are enough, and wang2024 would take minutes.
    default_settings: ClassVar[Mapping[str, Any]] = {
        "algorithms": "template",
        "viewpoints": "centre,left,right",
        "view_pixels_per_lens": 1,
        "capture_pixels_per_pitch": 3,
    }
    usual_samples: ClassVar[Mapping[str, int]] = {"capture_spp": 16, "eia_spp": 8, "view_spp": 64}
    # A cylinder is as wide as a pixel of a view: more rays make views no smoother. Those of a
    # sub-pixel on the border of two cylinders would mix opposite views.
    samples = 1
    shader = """
vec3 lens_centre(vec2 point) {
  return vec3(floor(point.x / pitch.x + 0.5) * pitch.x, point.y, 1.0);
}
"""

    def check(self) -> None:
        """See `Layout.check`."""
        display = self.display
        if display.panel_rows is None or display.panel_columns is None:
            raise DisplayError("lattice = 'lenticular': set panel_columns and panel_rows")
        if display.pitch_y_mm is not None or display.lens_rows != 1:
            raise DisplayError(
                "lattice = 'lenticular': cylinders have no rows; set lens_rows = 1, and no "
                "pitch_y_mm"
            )
        if abs(display.rotation_deg) > _STEEPEST_SLANT_DEG:
            raise DisplayError(
                f"rotation_deg = {display.rotation_deg:g}: cylinders are slanted by at most "
                f"{_STEEPEST_SLANT_DEG:g} degrees"
            )

    # -- sizes ---------------------------------------------------------------------------------

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of a view: as many points across as cylinders, at equal distances."""
        display = self.display
        rows, columns = display.eia_shape
        return max(1, round(Fraction(rows, columns) * display.lens_columns)), display.lens_columns

    def lens_counts(self, times: str = "x") -> str:
        """Numbers of lenses across and down as text."""
        return f"{self.display.lens_columns} {times} 1"

    @property
    def directions(self) -> tuple[float, float]:
        """See `Layout.directions`; there is one along the axes."""
        return super().directions[0], 1.0

    @property
    def size(self) -> tuple[Fraction, Fraction]:
        """See `Layout.size`: the panel's, because cylinders do not end with it."""
        display = self.display
        pixel = display.exact_mm(display.pixel_pitch_mm) / display.exact_mm(display.pitch_mm)
        return (display.panel_columns or 1) * pixel, (display.panel_rows or 1) * pixel

    @property
    def view_cell_mm(self) -> tuple[float, float]:
        """See `Layout.view_cell_mm`."""
        rows, columns = self.grid
        return self.display.width_mm / columns, self.display.height_mm / rows

    @property
    def half_extent_mm(self) -> tuple[float, float]:
        """See `Layout.half_extent_mm`."""
        return self.display.width_mm / 2, self.display.height_mm / 2

    # -- rays ----------------------------------------------------------------------------------

    @property
    def design_distance_mm(self) -> float:
        """See `Layout.design_distance_mm`; inf if elemental images are not wider than lenses."""
        display = self.display
        wider = display.elemental_image_pitch_mm - display.pitch_mm
        return display.gap_mm * display.pitch_mm / wider if wider > 0 else math.inf

    def place_in_cell(self, across: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cylinders of panel points, counted from the central one, and places in their images.

        * `across`: distance from the central axis, mm.

        Returns `lens`, float64 of whole numbers; `place`, 0 (left edge) to below 1.
        """
        cells = across / self.display.elemental_image_pitch_mm + 0.5
        lens = np.floor(cells)
        return lens, cells - lens

    def find_rays(
        self, x: np.ndarray, y: np.ndarray, offset: tuple[Any, Any]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `Layout.find_rays`; the point of the array's plane is on the cylinder's axis."""
        display, (c, s) = self.display, self._turn
        x, y = x + offset[0], y + offset[1]
        lens, _ = self.place_in_cell(x)
        x0 = lens * display.pitch_mm
        # Heights in the display's frame, from the eye's: a ray sinks to it over V + g.
        height = s * x + c * y + display.shift_y_mm
        gap: Any = display.gap_mm
        if display.tilt_x_deg or display.tilt_y_deg:
            tilt_x, tilt_y = display.tilt_slopes
            gap = gap + tilt_x * (c * x - s * y + display.shift_x_mm) + tilt_y * height
        rise = -height * (gap / (self.design_distance_mm + gap))
        y0 = y + (rise - s * (x0 - x)) / c
        outermost = exact_ratio(self.outermost_mm[0] / display.elemental_image_pitch_mm)
        first = math.ceil(outermost) + 1
        return (lens + first).astype(np.int64), x0, y0

    @property
    def crossing_steps(self) -> tuple[float, float]:
        """See `Layout.crossing_steps`: along the axis, for the same eye."""
        c, s = self._turn
        up = 1 / (1 + self.display.gap_mm / self.design_distance_mm)
        return -s / c * up, up

    def outward_slopes(self, *, behind: bool = False) -> tuple[float, float]:
        """See `Layout.outward_slopes`."""
        display, (c, s) = self.display, self._turn
        cell, off_axis = display.elemental_image_pitch_mm, self._off_axis(behind=behind)
        across = cell / 2 + off_axis * self.outermost_mm[0]
        height = display.height_mm / 2 + abs(display.shift_y_mm)
        up = height / (self.design_distance_mm + display.gap_mm)
        return (across / least_gap_mm(display) + abs(s) * up) / c, up

    # -- viewing zone --------------------------------------------------------------------------

    @property
    def outermost_mm(self) -> tuple[float, float]:
        """See `Layout.outermost_mm`: of the axes that cross the panel."""
        c, s = self._turn
        half_x, half_y = self.half_extent_mm
        shift = abs(self.display.shift_x_mm) + abs(self.display.shift_y_mm)
        return abs(c) * half_x + abs(s) * half_y + shift, 0.0

    def flip_limit_mm(self, distance_mm: float) -> tuple[float, float]:
        """See `Display.flip_limit_mm`; there is none along the axes."""
        return super().flip_limit_mm(distance_mm)[0], math.inf

    # -- optics --------------------------------------------------------------------------------

    @classmethod
    def lens_centre(cls, array: Any, ops: Ops, x: Any, y: Any) -> tuple[Any, Any, Any]:
        """See `Layout.lens_centre`: the nearest point of an axis, so that heights have no power."""
        return ops.floor(x / array.pitch_x + 0.5) * array.pitch_x, y, ops.absolute(x) >= 0

    @classmethod
    def reach_squared(cls, array: Any, ops: Ops) -> Any:  # noqa: ARG003
        """See `Layout.reach_squared`."""
        return array.pitch_x * array.pitch_x / 4.0


# Real sheets have 6 to 20 degrees; beyond this the vertical place of an eye decides its view.
_STEEPEST_SLANT_DEG = 45.0
