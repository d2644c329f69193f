"""Interface of a layout: the arrangement of a display's lenses, and the rays of its pixels.

All other code asks a display's layout for them. Points are in the *array frame*: the display frame,
moved to the array's centre and rotated with it; rows count from the top, lengths are millimetres.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from inim.display.pixels import SUBPIXELS, farthest_subpixel, least_gap_mm
from inim.system.errors import DisplayError

if TYPE_CHECKING:
    from inim.display.display import Display


class Ops(NamedTuple):
    """Functions for lens models, available in NumPy and in Dr.Jit."""

    sqrt: Any
    floor: Any
    where: Any
    absolute: Any


# Rows of lenses that are farther apart are cylinders in disguise, whose rays along their axes would
# pass through the middle of the array.
_FARTHEST_ROWS = 10.0
NUMPY_OPS = Ops(np.sqrt, np.floor, np.where, np.abs)


@dataclass(frozen=True)
class LensAxis:
    """Lenses and panel pixels of a separable display along one axis, to the right or downwards.

    * `lenses`, `pixels`: their numbers.
    * `pitch`, `cell`: distance of lenses, and of their elemental images.
    * `pixel`: panel pixel.
    * `shift`: shift of the array over the panel.
    """

    lenses: int
    pixels: int
    pitch: Fraction
    cell: Fraction
    pixel: Fraction
    shift: Fraction

    def centres(self) -> list[Fraction]:
        """Centres of the lenses."""
        return [
            Fraction(2 * n - self.lenses + 1, 2) * self.pitch + self.shift
            for n in range(self.lenses)
        ]


@dataclass(frozen=True)
class Layout(ABC):
    """Arrangement of a display's lenses.

    The optics of a lens model are class methods, compiled with the model: `array` has the numbers
    of the display (`inim.display.lens.LensArray`) as floats or Dr.Jit scalars, and `ops` the
    functions.
    """

    display: Display

    #: Value of the display's parameter `lattice`.
    name: ClassVar[str]
    #: A pixel's lens and ray depend on its row and its column separately, under an array that is
    #: neither turned nor tilted.
    has_rows_and_columns: ClassVar[bool] = False
    #: Lenses are cylinders, whose axes run up the array. They do not end with it: every panel pixel
    #: has one.
    of_cylinders: ClassVar[bool] = False
    #: Centres of the neighbours of a lens, in pitches to the right and row pitches up.
    neighbours: ClassVar[tuple[tuple[float, float], ...]]
    #: Settings of `inim.display.settings.Settings` whose defaults differ for the layout.
    default_settings: ClassVar[Mapping[str, Any]] = {}
    #: Samples per pixel of ground truth and capture where neither the user nor scores decide, by
    #: setting.
    usual_samples: ClassVar[Mapping[str, int]] = {"capture_spp": 64, "eia_spp": 32, "view_spp": 64}
    #: Rays per pixel or sub-pixel that generators average by default.
    samples: ClassVar[int] = 4
    #: GLSL of the live display: ``vec3 lens_centre(vec2 point)``, as `lens_centre`.
    shader: ClassVar[str]

    def check(self) -> None:
        """Raise `DisplayError` for parameters of the display that the layout cannot have."""
        display = self.display
        if display.row_pitch_mm > _FARTHEST_ROWS * display.pitch_mm:
            raise DisplayError(
                f"pitch_y_mm = {display.row_pitch_mm:g}: rows of lenses over {_FARTHEST_ROWS:g} "
                f"pitches apart are cylinders; use lattice = 'lenticular'"
            )

    # -- sizes ---------------------------------------------------------------------------------

    @staticmethod
    def usual_row_pitch_mm(pitch_mm: float) -> float:
        """Distance of adjacent rows, unless the display gives it."""
        return pitch_mm

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of lenses."""
        return self.display.lens_rows, self.display.lens_columns

    def lens_counts(self, times: str = "x") -> str:
        """Numbers of lenses across and down as text."""
        rows, columns = self.grid
        return f"{columns} {times} {rows}"

    @property
    def directions(self) -> tuple[float, float]:
        """Directions of light from a lens, across and down: emitting areas of one colour or another
        under it.
        """
        display = self.display
        across, down = display.elemental_image_pitch_mm, display.elemental_row_pitch_mm
        area = display.pixel_pitch_mm * float(SUBPIXELS[display.subpixels][0].width)
        return across / area, down / display.pixel_pitch_mm

    @property
    def size(self) -> tuple[Fraction, Fraction]:
        """Width of the array in pitches, and its height in row pitches."""
        rows, columns = self.grid
        return Fraction(columns), Fraction(rows)

    @property
    def view_cell_mm(self) -> tuple[float, float]:
        """Width and height of the array per column and row of `grid`: a view is `grid` of them."""
        return self.display.pitch_mm, self.display.row_pitch_mm

    @property
    def half_extent_mm(self) -> tuple[float, float]:
        """See `Display.half_extent_mm`."""
        display, (c, s) = self.display, self._rotation_factors
        half_x, half_y = display.width_mm / 2, display.height_mm / 2
        return (
            c * half_x + s * half_y + abs(display.shift_x_mm),
            c * half_y + s * half_x + abs(display.shift_y_mm),
        )

    @property
    def _turn(self) -> tuple[float, float]:
        """Cosine and sine of the array's rotation."""
        angle = math.radians(self.display.rotation_deg)
        return math.cos(angle), math.sin(angle)

    @property
    def _rotation_factors(self) -> tuple[float, float]:
        """Sizes of the cosine and the sine of the array's rotation."""
        angle = math.radians(self.display.rotation_deg)
        return abs(math.cos(angle)), abs(math.sin(angle))

    # -- rays ----------------------------------------------------------------------------------

    @property
    def design_distance_mm(self) -> float | None:
        """Viewing distance that the rays of pixels are made for; None: they suit all."""
        return None

    @abstractmethod
    def find_rays(
        self, x: np.ndarray, y: np.ndarray, offset: tuple[Any, Any]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Lenses of panel pixels, and points of the array's plane that their chief rays cross.

        * `x`, `y`: centres of the pixels. The cells of the elemental images have their own pitch.
        * `offset`: from these to the points of the pixels from which the rays start, one for all
          or an array for each coordinate. Under lenses it changes nothing: a pixel's whole area
          shines through one lens.

        Returns `lens`, int64: ``row * columns + column``, -1 outside the array, where the layout is
        continued, so that every pixel has a ray; `x0`, `y0`, float64.
        """

    def _in_cells(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Panel points in cells of elemental images, from the array's left and upper edge."""
        rows, columns = self.grid
        across = x / self.display.elemental_image_pitch_mm + columns / 2
        return across, rows / 2 - y / self.display.elemental_row_pitch_mm

    def _through_centres(
        self, row: np.ndarray, column: np.ndarray, stagger: np.ndarray | float = 0.0
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rays through the centres of lenses; `stagger` of their rows to the right, in pitches.

        Lens centres have the lens pitch, whatever the pitch of the cells under them.
        """
        rows, columns = self.grid
        x0 = (column + 0.5 - columns / 2 + stagger) * self.display.pitch_mm
        y0 = (rows / 2 - row - 0.5) * self.display.row_pitch_mm
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        return np.where(inside, row * columns + column, -1).astype(np.int64), x0, y0

    def axis(self, sign: int) -> LensAxis:
        """Lenses and pixels from left to right (`sign` +1) or downwards (-1).

        Raises `DisplayError`: the display is not separable.
        """
        display = self.display
        if not display.is_separable:
            raise DisplayError(
                f"display {display.name}: with {display.not_separable_by} a pixel's lens depends "
                "on its row and column together; use a generator that traces every pixel's ray, "
                "such as 'template' or 'gu2020'"
            )
        side = sign > 0
        exact = display.exact_mm
        pitch = exact(display.pitch_mm if side else display.row_pitch_mm)
        of_lenses = exact(display.elemental_image_pitch_mm) / exact(display.pitch_mm)
        return LensAxis(
            lenses=self.grid[side],
            pixels=display.eia_shape[side],
            pitch=pitch,
            cell=pitch * of_lenses,
            pixel=exact(display.pixel_pitch_mm),
            shift=sign * exact(display.shift_x_mm if side else display.shift_y_mm),
        )

    @property
    def cell_size_mm(self) -> tuple[float, float]:
        """Width and height of a rectangle about a lens's centre that holds its elemental image."""
        display = self.display
        width, height = display.elemental_image_pitch_mm, display.elemental_row_pitch_mm
        return width, self.cell_height(width, height)

    @staticmethod
    def cell_height(pitch: float, row_pitch: float) -> float:  # noqa: ARG004
        """Height of a cell of lenses of such pitches."""
        return row_pitch

    @property
    def crossing_steps(self) -> tuple[float, float]:
        """Movement across and up of a ray's crossing of the array, display frame, as its start
        moves up in the pixel, mm per mm; 0 where rays cross in lens centres.
        """
        return 0.0, 0.0

    def outward_slopes(self, *, behind: bool = False) -> tuple[float, float]:
        """Largest slopes of rays away from the array's centre, in x and y, display frame.

        * `behind`: behind the array, where rays that converge before it diverge.
        """
        display, (cell_x, cell_y) = self.display, self.cell_size_mm
        off_axis = self._off_axis(behind=behind)
        cell_x, cell_y = cell_x + off_axis * display.width_mm, cell_y + off_axis * display.height_mm
        c, s = self._rotation_factors
        beside, above = (2 * n * display.pixel_pitch_mm for n in farthest_subpixel(display))
        gap = least_gap_mm(display)
        across, up = c * cell_x + s * cell_y + beside, c * cell_y + s * cell_x + above
        return across / (2 * gap), up / (2 * gap)

    def _off_axis(self, *, behind: bool) -> float:
        """Distance of elemental images from their lenses' axes, towards the array's centre (or, for
        `behind`, away from it), as a share of the lens's distance from the centre.
        """
        apart = self.display.elemental_image_pitch_mm / self.display.pitch_mm - 1
        return max(apart if behind else -apart, 0.0)

    @property
    def steepest_slopes(self) -> tuple[float, float]:
        """See `Display.steepest_slopes`."""
        before, behind = self.outward_slopes(), self.outward_slopes(behind=True)
        return max(before[0], behind[0]), max(before[1], behind[1])

    @property
    def farthest_crossings_mm(self) -> tuple[float, float]:
        """Bounds of the movement of rays across and up, display frame, from their start on a panel
        pixel under a lens to the array.
        """
        largest_gap = 2 * self.display.gap_mm - least_gap_mm(self.display)
        # Points of a pixel and its sub-pixels are less than 1.5 pixels from its centre.
        beside = 1.5 * self.display.pixel_pitch_mm
        across, up = (slope * largest_gap + beside for slope in self.steepest_slopes)
        return across, up

    # -- viewing zone --------------------------------------------------------------------------

    @property
    def outermost_mm(self) -> tuple[float, float]:
        """Distances of the outermost lens centres from the array's centre, across and up."""
        rows, columns = self.grid
        return (columns - 1) / 2 * self.display.pitch_mm, (rows - 1) / 2 * self.display.row_pitch_mm

    def flip_limit_mm(self, distance_mm: float) -> tuple[float, float]:
        """See `Display.flip_limit_mm`."""
        limits, gap = [], self.display.gap_mm
        for outermost, p, q in self._pitches():
            walk = abs(1 + gap / distance_mm - q / p)
            limits.append((q / 2 - outermost * walk) * distance_mm / gap)
        return limits[0], limits[1]

    def eye_offset(self, x: float, y: float) -> tuple[float, float]:
        """Offsets of an eye from the array's centre, along its axes, as of `flip_limit_mm`."""
        c, s = self._turn
        x, y = x - self.display.shift_x_mm, y - self.display.shift_y_mm
        return c * x + s * y, c * y - s * x

    def nearest_viewing_distance_mm(self) -> float:
        """Distance at which an eye on the axis just sees no flipped view; inf if there is none."""
        nearest = self.display.gap_mm
        for outermost, p, q in self._pitches():
            if outermost:
                slack = q / 2 / outermost - (1 - q / p)
                nearest = max(nearest, self.display.gap_mm / slack if slack > 0 else np.inf)
        return nearest

    def _pitches(self) -> Iterator[tuple[float, float, float]]:
        """Outermost lens, distance of lenses and of their elemental images, across and down."""
        display = self.display
        lenses = display.pitch_mm, display.row_pitch_mm
        cells = display.elemental_image_pitch_mm, display.elemental_row_pitch_mm
        return zip(self.outermost_mm, lenses, cells, strict=True)

    # -- optics --------------------------------------------------------------------------------

    @classmethod
    @abstractmethod
    def lens_centre(cls, array: Any, ops: Ops, x: Any, y: Any) -> tuple[Any, Any, Any]:
        """Centre of the lens whose cell holds (x, y), and whether the array reaches that far."""

    @classmethod
    def reach_squared(cls, array: Any, ops: Ops) -> Any:  # noqa: ARG003
        """Square of the distance from a lens's centre to the farthest corner of its cell."""
        p, q = array.pitch_x, array.pitch_y
        return (p * p + q * q) / 4.0
