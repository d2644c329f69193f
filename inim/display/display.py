"""Integral-imaging display: a pixel panel under a microlens array, and its derived quantities.

Frame (used by the whole program): origin at the centre of the lens-array plane, +x right and
+y up as the viewer sees it, +z towards the viewer, millimetres. The panel is the plane z = -gap.

Formulas are those of Wang et al., Heritage Science 2024, doi 10.1186/s40494-024-01462-4, "the
paper" from here on, by equation number.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from inim.display.cells import check_cells, parse_cells
from inim.display.declaration import Values, declared, meanings, stated_repr
from inim.display.layers import parse_layers
from inim.display.layouts import LAYOUTS, Layout
from inim.display.panel import COLDEST_K, HOTTEST_K
from inim.display.parameters import (
    Aperture,
    BetweenLenses,
    CellPattern,
    Cells,
    CurvedSide,
    Lattice,
    Layers,
    Subpixels,
)
from inim.display.pixels import (
    PixelAxis,
    exact_length,
    exact_multiple,
    exact_ratio,
    pixel_axis,
    pixel_rays,
    row_blocks,
)
from inim.system.errors import DisplayError, suggest_words

# Pictures hold depths as float32, which end at 3.4e38; products of two lengths are floats still.
_LONGEST_MM = 1e38
# Below an atom's size; quotients of lengths are floats still.
_SHORTEST_MM = 1e-9
# Far above what a sheet glued by hand misses, and far below where a tilted panel meets its array.
_STEEPEST_TILT_DEG = 10.0
# What does not change the ray through a lens's centre: the rest of the lens, and the panel's light.
_LENS_ONLY = (
    "refractive_index",
    "lens_thickness_mm",
    "curved_side",
    "conic",
    "asphere_a4",
    "asphere_a6",
    "abbe_number",
    "aperture",
    "fill_factor",
    "between_lenses",
    "layers",
    "black_level",
    "ambient_reflection",
    "veiling_glare",
    "white_point_k",
)


Length = Annotated[float, Values(above=0, requirement="must be a positive length")]
Count = Annotated[int, Values(low=1, requirement="must be a whole number of at least 1")]
Index = Annotated[float, Values(above=1, requirement="a lens needs an index above 1")]
Tilt = Annotated[float, Values(low=-_STEEPEST_TILT_DEG, high=_STEEPEST_TILT_DEG)]
Share = Annotated[float, Values(low=0, below=1, requirement="must be a share from 0 to below 1")]


def _call(module: str, function: str, *arguments: Any) -> Any:
    """Call a function of a package above this one: files and drawings of a display."""
    return getattr(import_module(module), function)(*arguments)


@dataclass(frozen=True, repr=False)
class Display:
    """An integral-imaging display.

    Parameters
    ----------
    pitch_mm : float
        Lens pitch P: distance between adjacent lenses in a row.
    focal_length_mm, gap_mm : float
        Focal length f and gap g between lens array and panel. g > f gives real images in front of
        the array, g < f virtual images behind it; g = f (focused) needs a depth range. g is
        air-equivalent: a layer of thickness t and index n counts as t / n (see `layers`).
    pixel_pitch_mm : float
        Panel pixel P_D. P / P_D need not be an integer.
    lens_columns, lens_rows : int
        Number of lenses horizontally and vertically, N and M.
    panel_columns, panel_rows : int, optional
        Panel size in pixels, centred under the array; by default just enough to cover it.
    depth_min_mm, depth_max_mm : float, optional
        Depth range instead of the one in the text of Eq. 4; both or neither.
    elemental_pitch_mm : float, optional
        Pitch of the elemental images on the panel; default: the lens pitch
        (``P (V + g) / V`` aims all lenses at a viewer at distance V).
    refractive_index, lens_thickness_mm, curved_side :
        The plano-convex lens of the ``thick`` model: index (PMMA by default), centre thickness (one
        pitch by default), and direction of the curved face, ``"viewer"`` or ``"panel"``.
    conic, asphere_a4, asphere_a6 : float
        Deviation of its curved face from a sphere: conic constant k, and even terms ``a4 r^4 + a6
        r^6`` of the sag, mm^-3 and mm^-5; positive values increase the sag.
    abbe_number : float, optional
        V of the lens's material; without it, all colours have the same refractive index.
    pitch_y_mm : float, optional
        Distance between adjacent lens rows: P by default, ``P sqrt(3) / 2`` on a hexagonal lattice.
    lattice : {"square", "hexagonal", "lenticular"}
        Hexagonal: every other row, the second from the top first, is half a pitch to the right.
        Lenticular: cylinders, slanted by `rotation_deg`; see `inim.display.layouts.lenticular`.
    aperture : {"square", "round"}
    fill_factor : float
        Width of a lens's aperture in pitches, 0..1.
    between_lenses : {"dark", "clear"}
        Area outside the apertures: paint, or the sheet's bare flat surface.
    layers : sequence of (thickness_mm, refractive_index), or str
        Layers between lenses and panel, from the lenses on, such as cover glass; as text,
        ``"0.5 1.52, 0.1 1.47"``. They are parts of the gap; the rest is air, next to the lenses.
        The ``thick`` model refracts at each of them, ``thin`` and ``pinhole`` use g alone.
    shift_x_mm, shift_y_mm, rotation_deg : float
        Shift of the array over the panel, right and up, followed by a rotation about its own
        centre, counter-clockwise as the viewer sees it. Panel, eye and picture keep their
        positions.
    tilt_x_deg, tilt_y_deg : float
        Tilt of the panel against the array: the gap grows to the right, and upwards.
    subpixels : {"none", "rgb-stripe", "pentile", "cells"}
        Areas of a pixel's colours: the whole pixel for all; red, green and blue thirds from left to
        right; or green right halves, and left halves alternately red and blue (red at the top left,
        like a chessboard); or as `subpixel_cells` states.
    subpixel_cells : sequence of six floats, or str
        Centres of red, green and blue, right and up of the pixel's in pixels, of each kind of
        pixel; as text, ``"-0.3 0.25 0.3 0.25 0 -0.25, ..."``.
    cell_pattern : str
        Kinds of pixels by column and row: see `inim.display.cells.CELL_PATTERNS`.
    pixel_fill : float
        Width and height of the emitting area, in pixels or sub-pixels, 0..1; the rest is black.
    black_level : float
        Luminance of the panel's black as a share of its white, 0..1: 0.001 for a contrast of
        1000:1.
    ambient_reflection : float
        Room light that the display reflects to the viewer, as a share of the panel's white.
    veiling_glare : float
        Share of a view's light that spreads evenly over the view, 0..1.
    white_point_k : float, optional
        Colour temperature of the panel's white on the daylight locus, kelvin; default: D65.
    name : str
        Name of the display in reports.

    Raises
    ------
    DisplayError
        A value describes no possible display; the message names it.
    """

    pitch_mm: Length  #: lens pitch P
    focal_length_mm: Length  #: lens focal length f
    gap_mm: Length  #: gap g between lens array and panel, air-equivalent: a layer counts as t / n
    pixel_pitch_mm: Length  #: panel pixel P_D
    lens_columns: Count  #: lenses across
    lens_rows: Count  #: lenses down
    panel_columns: Count | None = None  #: panel pixels across
    panel_rows: Count | None = None  #: panel pixels down
    depth_min_mm: float | None = None  #: far end of the depth range (both or neither)
    depth_max_mm: float | None = None  #: near end of the depth range
    elemental_pitch_mm: Length | None = None  #: pitch of the elemental images, if it differs from P
    refractive_index: Index = 1.4917  #: refractive index of the thick lens ({}, PMMA)
    lens_thickness_mm: Length | None = None  #: centre thickness of the thick lens (P)
    curved_side: CurvedSide = "viewer"  #: curved side of the thick lens: viewer or panel
    conic: float = 0.0  #: conic constant of the curved face ({})
    asphere_a4: float = 0.0  #: sag term in r^4 of the curved face, mm^-3 ({})
    asphere_a6: float = 0.0  #: sag term in r^6 of the curved face, mm^-5 ({})
    #: Abbe number of the lens material; none: no dispersion
    abbe_number: Annotated[float, Values(above=0)] | None = None
    #: pitch of the lens rows (P, or that of the hexagonal lattice)
    pitch_y_mm: Length | None = None
    #: lens lattice: square, hexagonal, or lenticular for slanted cylinders ({})
    lattice: Annotated[Lattice, Values(words=LAYOUTS)] = "square"
    aperture: Aperture = "square"  #: shape of a lens's aperture: square or round ({})
    #: width of a lens's aperture, in pitches ({})
    fill_factor: Annotated[float, Values(above=0, high=1)] = 1.0
    between_lenses: BetweenLenses = "dark"  #: sheet between the apertures: dark or clear ({})
    #: layers in the gap, from the lenses on, thickness in mm and index: '0.5 1.52, 0.1 1.47' ({})
    layers: Annotated[Layers, Values(rows=parse_layers)] = ()
    shift_x_mm: float = 0.0  #: shift of the array to the right ({})
    shift_y_mm: float = 0.0  #: shift of the array upwards ({})
    rotation_deg: float = 0.0  #: counter-clockwise rotation of the array, seen by the viewer ({})
    tilt_x_deg: Tilt = 0.0  #: tilt of the panel: the gap grows to the right ({})
    tilt_y_deg: Tilt = 0.0  #: tilt of the panel: the gap grows upwards ({})
    subpixels: Subpixels = "none"  #: areas of colours: none, rgb-stripe, pentile or cells ({})
    #: centres of red, green and blue for `cells`, right and up in pixels, of each kind of pixel:
    #: '-0.3 0.25 0.3 0.25 0 -0.25, ...' ({})
    subpixel_cells: Annotated[Cells, Values(rows=parse_cells)] = ()
    #: kinds of pixels for `cells`: single, checkerboard, columns, rows, rows-of-4 or staggered
    #: ({})
    cell_pattern: CellPattern = "single"
    #: width of the light-emitting area of a (sub-)pixel, in its pitches ({})
    pixel_fill: Annotated[float, Values(above=0, high=1)] = 1.0
    black_level: Share = 0.0  #: luminance of the panel's black over white ({})
    #: room light that the display reflects, as a share of white ({})
    ambient_reflection: Share = 0.0
    veiling_glare: Share = 0.0  #: share of a view's light that spreads evenly over it ({})
    #: colour temperature of the panel's white, kelvin (D65)
    white_point_k: Annotated[float, Values(low=COLDEST_K, high=HOTTEST_K)] | None = None
    name: str = "custom"  #: its name

    @classmethod
    def field_meanings(cls) -> dict[str, str]:
        """Meanings of the parameters, by name."""
        return meanings(Display)

    def __post_init__(self) -> None:
        # msgspec leaves absent fields to the class, and omits them when it encodes the display.
        self.__dict__.update(self.parameters())
        for name, field in declared(Display).items():
            value = getattr(self, name)
            try:
                object.__setattr__(self, name, field.check(value))
            except ValueError as error:
                raise DisplayError(f"{name} = {value!r}: {error}") from None
            if name.endswith("_mm"):
                self._check_magnitude(name)
        for name in ("pitch_mm", "elemental_image_pitch_mm"):
            if self.pixel_pitch_mm > getattr(self, name):
                raise DisplayError(
                    f"pixel_pitch_mm = {self.pixel_pitch_mm} exceeds {name} = "
                    f"{getattr(self, name)}: a lens must cover at least one pixel"
                )
        check_cells(self)
        self.layout.check()
        self._check_depth_range()

    __repr__ = stated_repr

    def _check_magnitude(self, name: str) -> None:
        size = abs(getattr(self, name) or 0.0)
        if size > _LONGEST_MM:
            raise DisplayError(
                f"{name} = {getattr(self, name):g}: at most {_LONGEST_MM:g} mm are allowed"
            )
        if declared(Display)[name].values.above == 0 and 0 < size < _SHORTEST_MM:
            raise DisplayError(f"{name} = {size:g}: at least {_SHORTEST_MM:g} mm are needed")

    def _check_depth_range(self) -> None:
        limits = (self.depth_min_mm, self.depth_max_mm)
        if (limits[0] is None) != (limits[1] is None):
            raise DisplayError(
                f"depth_min_mm = {limits[0]}, depth_max_mm = {limits[1]}: give both or neither"
            )
        if limits[0] is None and math.isinf(self.central_depth_mm):
            raise DisplayError(
                f"gap_mm = focal_length_mm = {self.gap_mm}: a focused display has no depth range "
                "of its own; set depth_min_mm and depth_max_mm"
            )
        low, high = self.depth_range_mm
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise DisplayError(
                f"depth range [{low:g}, {high:g}] mm is empty or not finite: "
                "depth_min_mm must be less than depth_max_mm"
            )

    # -- sizes ---------------------------------------------------------------------------------

    @cached_property
    def layout(self) -> Layout:
        """Arrangement of the lenses, and the rays of the pixels; all that depends on `lattice`."""
        return LAYOUTS[self.lattice](self)

    @property
    def width_mm(self) -> float:
        """Width of the lens array: N P, plus half a pitch if rows are staggered."""
        return float(self.layout.size[0]) * self.pitch_mm

    @property
    def height_mm(self) -> float:
        """Height of the lens array: number of rows times row pitch."""
        return float(self.layout.size[1]) * self.row_pitch_mm

    @property
    def row_pitch_mm(self) -> float:
        """Distance between adjacent lens rows."""
        if self.pitch_y_mm is not None:
            return self.pitch_y_mm
        return self.layout.usual_row_pitch_mm(self.pitch_mm)

    @property
    def elemental_row_pitch_mm(self) -> float:
        """Distance between adjacent rows of elemental images, in proportion to the lenses'."""
        if self.elemental_pitch_mm is None:
            return self.row_pitch_mm
        return self.row_pitch_mm * (self.elemental_pitch_mm / self.pitch_mm)

    @property
    def is_separable(self) -> bool:
        """True if a panel pixel's lens and ray depend on its row and its column separately."""
        return not self.not_separable_by

    @property
    def elemental_image_pitch_mm(self) -> float:
        """Pitch of the elemental images on the panel; the lens pitch unless given."""
        return self.pitch_mm if self.elemental_pitch_mm is None else self.elemental_pitch_mm

    @property
    def pixels_per_lens(self) -> float:
        """Panel pixels per elemental image along one axis; rarely a whole number in hardware."""
        return float(self.exact_pixels_per_lens[1])

    @property
    def has_integer_ratio(self) -> bool:
        """True if all elemental images are squares of the same whole number of pixels."""
        down, across = self.exact_pixels_per_lens
        covered = tuple(lenses * int(across) for lenses in self.layout.grid)
        return (
            self.is_separable
            and not (self.shift_x_mm or self.shift_y_mm)
            and down == across == round(across)
            and self.eia_shape == covered
        )

    @cached_property
    def eia_shape(self) -> tuple[int, int]:
        """Rows and columns of the elemental image array, the panel's pixels.

        By default those that cover the array where it is designed to be, not moved nor turned.
        """
        (down, across), (wide, high) = self.exact_pixels_per_lens, self.layout.size
        rows, columns = math.ceil(high * down), math.ceil(wide * across)
        return self.panel_rows or rows, self.panel_columns or columns

    def exact_mm(self, length_mm: float) -> Fraction:
        """A length of the display, or of its picture: see `exact_multiple`.

        The units are the lens pitch and the panel pixel.
        """
        return exact_multiple(length_mm, self.pitch_mm, self.pixel_pitch_mm)

    @cached_property
    def exact_pixels_per_lens(self) -> tuple[Fraction, Fraction]:
        """Panel pixels per elemental image, down and across."""
        pixel, pitch = self.exact_mm(self.pixel_pitch_mm), self.exact_mm(self.pitch_mm)
        across = self.exact_mm(self.elemental_image_pitch_mm)
        down = self.exact_mm(self.row_pitch_mm) * across / pitch
        return exact_ratio(down / pixel), exact_ratio(across / pixel)

    # -- depth ---------------------------------------------------------------------------------

    @property
    def central_depth_mm(self) -> float:
        """Central depth plane D = f g / (g - f), text after Eq. 3; infinite when g = f."""
        return math.inf if self._is_focused else float(self._exact_central_depth)

    @property
    def scene_pixel_mm(self) -> float:
        """Width of a panel pixel's image at the central depth plane, abs(D) P_D / g (Eq. 3)."""
        return math.inf if self._is_focused else float(self._exact_scene_pixel)

    @property
    def depth_span_mm(self) -> float:
        """Displayable depth 2 abs(D) P_I / P (text after Eq. 4); infinite when g = f."""
        return math.inf if self._is_focused else float(2 * self._exact_half_span)

    @property
    def _is_focused(self) -> bool:
        return self.exact_mm(self.gap_mm) == self.exact_mm(self.focal_length_mm)

    @property
    def _exact_central_depth(self) -> Fraction:
        f, g = self.exact_mm(self.focal_length_mm), self.exact_mm(self.gap_mm)
        return f * g / (g - f)

    @property
    def _exact_scene_pixel(self) -> Fraction:
        pixel, gap = self.exact_mm(self.pixel_pitch_mm), self.exact_mm(self.gap_mm)
        return abs(self._exact_central_depth) * pixel / gap

    @property
    def _exact_half_span(self) -> Fraction:
        pitch = self.exact_mm(self.pitch_mm)
        return abs(self._exact_central_depth) * self._exact_scene_pixel / pitch

    @cached_property
    def depth_range_mm(self) -> tuple[float, float]:
        """Depth range (z_min, z_max) that pictures are fitted into; each end is rounded once.

        ``D -+ span / 2``, cut one pitch from the array where the formula would cross it
        (`depth_range_is_cut`), or the range given by the user.
        """
        low, high = self.exact_depth_range
        return float(low), float(high)

    @property
    def traced_range_mm(self) -> tuple[float, float]:
        """Depths through which rays are traced: the depth range, its end rounded down to float32.

        A picture's depths are float32. One at the far end of the range may be rounded to a number
        beyond it, and is still part of the picture.
        """
        low, high = self.depth_range_mm
        return min(low, float(np.float32(low))), high

    @property
    def exact_depth_range(self) -> tuple[Fraction, Fraction]:
        """Depth range before its ends are rounded."""
        if self.depth_min_mm is not None and self.depth_max_mm is not None:
            return self.exact_mm(self.depth_min_mm), self.exact_mm(self.depth_max_mm)
        centre, half = self._exact_central_depth, self._exact_half_span
        low, high = centre - half, centre + half
        if centre > 0:
            return max(low, self._clearance), high
        return low, min(high, -self._clearance)

    @property
    def _clearance(self) -> Fraction:
        """Minimum distance of a depth range from the array."""
        return min(self.exact_mm(self.pitch_mm), abs(self._exact_central_depth) / 2)

    @property
    def depth_range_is_cut(self) -> bool:
        """True if the depth formula crossed the array and the range was cut."""
        if self.depth_min_mm is not None:
            return False
        centre, half = self._exact_central_depth, self._exact_half_span
        return abs(centre) - half < self._clearance

    # -- viewing -------------------------------------------------------------------------------

    @property
    def viewing_half_angle_deg(self) -> float:
        """Half of the angle inside which no view repeats, atan(Q / 2g) for elemental pitch Q."""
        return math.degrees(math.atan(self.elemental_image_pitch_mm / (2 * self.gap_mm)))

    def flip_limit_mm(self, distance_mm: float) -> tuple[float, float]:
        """Farthest eye offset in x and y, at a distance, at which no lens shows a flipped view.

        A lens at x0 shows its own elemental image while the ray from the eye lands inside it;
        for elemental pitch P that is ``|e - x0| <= V P / 2g``. Negative: too close even on axis.
        Offsets count from the array's own centre and along its own axes.
        """
        return self.layout.flip_limit_mm(distance_mm)

    @property
    def nearest_viewing_distance_mm(self) -> float:
        """Distance at which an eye on the axis just sees no flipped view.

        Raises
        ------
        DisplayError
            When the elemental-image pitch is so far off that no distance works.
        """
        nearest = self.layout.nearest_viewing_distance_mm()
        if math.isinf(nearest):
            raise DisplayError(
                f"elemental_pitch_mm = {self.elemental_image_pitch_mm:g} against pitch_mm = "
                f"{self.pitch_mm:g}: every viewing distance shows flipped views; bring the two "
                "closer"
            )
        return nearest

    # -- pixels and rays -----------------------------------------------------------------------

    @cached_property
    def columns(self) -> PixelAxis:
        """The panel's columns, left to right, of a display that `is_separable`.

        Raises
        ------
        DisplayError
            Of any other: its pixels' rays are those of `inim.display.pixels`.
        """
        return pixel_axis(self, +1)

    @cached_property
    def rows(self) -> PixelAxis:
        """The panel's rows, top to bottom: positions descend, row 0 has the largest y.

        See `columns`.
        """
        return pixel_axis(self, -1)

    @property
    def not_separable_by(self) -> str:
        """The settings that couple rows and columns, for messages; empty where `is_separable`."""
        reasons = [] if self.layout.has_rows_and_columns else [f"lattice = {self.lattice!r}"]
        if self.subpixels == "cells":
            reasons.append("subpixels = 'cells'")
        for name in ("rotation_deg", "tilt_x_deg", "tilt_y_deg"):
            if getattr(self, name):
                reasons.append(f"{name} = {getattr(self, name):g}")
        return ", ".join(reasons)

    @cached_property
    def lensed(self) -> np.ndarray:
        """Panel pixels that lie under a lens, (rows, columns) bool.

        Raises
        ------
        DisplayError
            When none does.
        """
        if self.is_separable:
            under: np.ndarray = (self.rows.lens >= 0)[:, None] & (self.columns.lens >= 0)[None, :]
            return under
        if self.layout.of_cylinders:
            return np.ones(self.eia_shape, bool)
        under = np.concatenate([pixel_rays(self, rows).lens >= 0 for rows in row_blocks(self)])
        if not under.any():
            raise DisplayError(
                f"shift_x_mm = {self.shift_x_mm:g}, shift_y_mm = {self.shift_y_mm:g}: the array "
                "is completely outside its panel; shift it less"
            )
        return under

    def view_shape(self, pixels_per_lens: int | tuple[float, float]) -> tuple[int, int]:
        """Rows and columns of a view of the lens array; see `inim.render.rays.eye_rays`."""
        down, across = np.broadcast_to(pixels_per_lens, 2)
        rows, columns = self.layout.grid
        return round(rows * down), round(columns * across)

    def capture_shape(self, pixels_per_pitch: float) -> tuple[int, int]:
        """Rows and columns of an RGB-D picture that covers the reach of oblique pixel rays.

        The size is the nominal array plus, on either side, its overhang after shift and rotation
        and the sideways travel of the outermost rays, Q z / 2g where elemental images are centred
        on lenses. It is in whole pixels, so that pixel borders are equal in every lens if a pitch
        is a whole number of pixels.
        """
        count = exact_length(pixels_per_pitch)
        far, near = self.depth_range_mm
        slopes = self.layout.outward_slopes(), self.layout.outward_slopes(behind=True)
        wide, high = self.layout.size
        down = exact_ratio(self.exact_mm(self.row_pitch_mm) / self.exact_mm(self.pitch_mm))
        columns, rows = exact_ratio(wide * count), exact_ratio(high * down * count)
        reach = [
            max(before * max(abs(far), abs(near)), -behind * far) + extent
            for before, behind, extent in zip(*slopes, self.half_extent_mm, strict=True)
        ]
        pads = [
            max(math.ceil(exact_ratio(mm / self.pitch_mm * pixels_per_pitch) - size / 2), 0)
            for mm, size in zip(reach, (columns, rows), strict=True)
        ]
        return math.ceil(rows) + 2 * pads[1], math.ceil(columns) + 2 * pads[0]

    @property
    def lenses_on_panel(self) -> tuple[int, int]:
        """Rows and columns of lenses whose elemental images lie wholly on the panel."""
        down, across = (
            int(n // p) for n, p in zip(self.eia_shape, self.exact_pixels_per_lens, strict=True)
        )
        return down, across

    @property
    def panel_excess_mm(self) -> tuple[float, float]:
        """Excess width and height of the elemental images over the panel; 0 if they fit."""
        if self.layout.of_cylinders:
            return 0.0, 0.0
        (rows, columns), (down, across) = self.eia_shape, self.layout.grid
        wide = across * self.elemental_image_pitch_mm - columns * self.pixel_pitch_mm
        high = down * self.elemental_row_pitch_mm - rows * self.pixel_pitch_mm
        return max(wide, 0.0), max(high, 0.0)

    def capture_pixel_mm(self, pixels_per_pitch: float) -> float:
        """Side of a pixel of such a picture: the float nearest to the true quotient.

        A quotient of floats may be its neighbour, which no rational ray casting takes for the
        length that was meant (1.7 / 5 is not 0.34).
        """
        return float(self.exact_mm(self.pitch_mm) / exact_length(pixels_per_pitch))

    @property
    def steepest_slopes(self) -> tuple[float, float]:
        """Largest slopes of pixel rays in x and y: millimetres sideways per millimetre of depth."""
        return self.layout.steepest_slopes

    @property
    def half_extent_mm(self) -> tuple[float, float]:
        """Half the width and height, about the panel's centre, that contain the array."""
        return self.layout.half_extent_mm

    @property
    def tilt_slopes(self) -> tuple[float, float]:
        """Growth of the gap per millimetre to the right and up."""
        return math.tan(math.radians(self.tilt_x_deg)), math.tan(math.radians(self.tilt_y_deg))

    # -- plain data ----------------------------------------------------------------------------

    def parameters(self) -> dict[str, Any]:
        """The parameters, by name: `Display(**d.parameters()) == d`."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def derived_quantities(self) -> dict[str, Any]:
        """Derived quantities for reports; infinite values become None, because JSON has none."""
        low, high = self.depth_range_mm
        values: dict[str, Any] = {
            "central_depth_mm": self.central_depth_mm,
            "scene_pixel_mm": self.scene_pixel_mm,
            "depth_span_mm": self.depth_span_mm,
            "depth_min_mm": low,
            "depth_max_mm": high,
            "depth_range_is_cut": self.depth_range_is_cut,
            "width_mm": self.width_mm,
            "height_mm": self.height_mm,
            "eia_rows": self.eia_shape[0],
            "eia_columns": self.eia_shape[1],
            "pixels_per_lens": self.pixels_per_lens,
            "viewing_half_angle_deg": self.viewing_half_angle_deg,
        }
        try:
            values["nearest_viewing_distance_mm"] = self.nearest_viewing_distance_mm
        except DisplayError:
            values["nearest_viewing_distance_mm"] = None
        return {k: None if isinstance(v, float) and math.isinf(v) else v for k, v in values.items()}

    def replace(self, **changes: Any) -> Display:
        """Copy with some parameters changed and checked.

        Raises
        ------
        DisplayError
            An unknown parameter, or values that describe no possible display.
        """
        names = [field.name for field in fields(self)]
        for name in changes:
            if name not in names:
                raise DisplayError(
                    f"Display.replace: {name!r} is no parameter of a display; "
                    f"{suggest_words(name, names)}"
                )
        return replace(self, **changes)

    def save(self, path: Path | str) -> None:
        """Write a display file (.xml) that every command and function accepts as a display.

        The file has no name: reports name the display after the nearest preset. A slanted
        lenticular can also be written as the calibration file of a Looking Glass (.json).

        Raises
        ------
        UsageError
            The name does not end in .xml or .json.
        FileError
            The file cannot be written.
        """
        _call("inim.display.settings", "save_display", self, Path(path))

    def _repr_svg_(self) -> str:
        """Plan view, for notebooks."""
        svg: bytes = _call("inim.report.diagram", "plan_view", self, ())
        return svg.decode()

    @property
    def differs_on_its_side(self) -> bool:
        """True for cylinders, staggered rows, sub-pixels, or an array that is not aligned."""
        aligned = not (self.shift_x_mm or self.shift_y_mm) and self.is_separable
        return not aligned or self.subpixels != "none" or self.row_pitch_mm != self.pitch_mm

    def turned(self) -> Display:
        """The display on its side: a landscape panel becomes an upright one, and vice versa.

        Raises
        ------
        DisplayError
            It `differs_on_its_side`.
        """
        if self.differs_on_its_side:
            raise DisplayError(
                f"display {self.name}: differs on its side; turn the picture instead"
            )
        return self.replace(
            lens_columns=self.lens_rows,
            lens_rows=self.lens_columns,
            panel_columns=self.panel_rows,
            panel_rows=self.panel_columns,
            name=f"{self.name}, turned",
        )

    def with_fixed_panel(self) -> Display:
        """A copy that states its panel and depth range: no change of a length moves them."""
        rows, columns = self.eia_shape
        low, high = self.depth_range_mm
        return self.replace(
            panel_rows=rows, panel_columns=columns, depth_min_mm=low, depth_max_mm=high
        )

    def through_pinholes(self) -> Display:
        """Copy with pinholes and an ideal panel, without a name.

        The parameters of lenses, layers and the panel's light have their defaults. The ground truth
        is traced through lens centres, so displays that differ only in these share it.
        """
        defaults: dict[str, Any] = {
            field.name: field.default for field in fields(self) if field.name in _LENS_ONLY
        }
        return self.replace(name="", **defaults)
