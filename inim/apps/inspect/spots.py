"""Tracing of rays to the panel, assignment to lenses, and spot diagrams.

A spot is the image of a point through one lens, on or off the axis.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from inim.apps.inspect.document import SpotFigures
from inim.display import Display
from inim.display.layouts import Square
from inim.display.lens import channel_indices, lens_array, lens_model, lens_traits, trace_to_panel
from inim.display.lens.array import (
    NUMPY_OPS,
    LensArray,
    LensTraits,
    in_aperture,
    lens_centre,
    to_array,
    to_panel,
)

# A lens alone has a cell so many pitches wide: no ray near it leaves that.
_ROOM = 3
# Two traces of one ray through one lens differ by rounding; through two lenses, by optics.
_SAME_PLACE_MM = 1e-6


class Landings(NamedTuple):
    """Panel points of rays."""

    #: (n,) float64: on the panel, display frame.
    x_mm: np.ndarray
    y_mm: np.ndarray
    weight: np.ndarray  #: (n,) float64: share of a ray's light that gets there.
    #: (n,) float64: centre of the lens that bent the ray, array frame; NaN where none did.
    lens_x_mm: np.ndarray
    lens_y_mm: np.ndarray


def land(
    display: Display,
    model: str,
    x_mm: np.ndarray,
    y_mm: np.ndarray,
    slope_x: np.ndarray,
    slope_y: np.ndarray,
    index: float | None = None,
) -> Landings:
    """Trace rays that cross the array plane to the panel, and find the lens each went through.

    A thick lens bulges, so an oblique ray may cross z = 0 over one lens and meet the next one's
    surface. Such a ray belongs to the lens it met: the one that alone, without neighbours, bends it
    to the same place.

    * `model`: one of `inim.display.lens.lens_models` that is no mesh.
    * `x_mm`, `y_mm`, `slope_x`, `slope_y`, (n,) arrays: as `inim.display.lens.trace_to_panel` takes
      them.
    * `index`: refractive index, where it is not the display's own.
    """
    rays = tuple(np.asarray(v, float) for v in (x_mm, y_mm, slope_x, slope_y))
    x, y, weight = trace_to_panel(display, model, *rays, index=index)
    array, traits = lens_array(display), lens_traits(display)
    ax, ay, _, _ = to_array(array, traits, *rays)
    own_x, own_y, _ = _lens_centre(array, traits, ax, ay)
    found_x, found_y = np.full(x.shape, np.nan), np.full(x.shape, np.nan)
    for right, up in ((0, 0), *traits.layout.neighbours):
        open_ = (weight > 0) & np.isnan(found_x)
        if not open_.any():
            break
        centre_x = own_x[open_] + right * array.pitch_x
        centre_y = own_y[open_] + up * array.pitch_y
        alone_x, alone_y = _through_one_lens(
            display, model, tuple(v[open_] for v in rays), centre_x, centre_y, index
        )
        same = np.hypot(alone_x - x[open_], alone_y - y[open_]) < _SAME_PLACE_MM
        found_x[open_] = np.where(same, centre_x, np.nan)
        found_y[open_] = np.where(same, centre_y, np.nan)
    return Landings(x, y, weight, found_x, found_y)


def _through_one_lens(
    display: Display,
    model: str,
    rays: tuple[np.ndarray, ...],
    centre_x: np.ndarray,
    centre_y: np.ndarray,
    index: float | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Panel points of rays that each meet one lens without neighbours, its centre given."""
    array, traits = lens_array(display), lens_traits(display)
    x, y, sx, sy = to_array(array, traits, *rays)
    room = _ROOM * max(array.pitch_x, array.pitch_y)
    single = array._replace(
        pitch_x=room, pitch_y=room, half_columns=0.5, half_rows=0.5, half_aperture=room
    )
    layout = traits.layout if traits.layout.of_cylinders else Square
    kind = traits._replace(layout=layout, round_aperture=False, full_aperture=False)
    trace = lens_model(model).traced_without_renderer()
    n = display.refractive_index if index is None else index
    with np.errstate(invalid="ignore", divide="ignore"):  # rays that miss this lens
        ray = trace(single, kind, NUMPY_OPS, x - centre_x, y - centre_y, sx, sy, n)
        moved = ray._replace(x=ray.x + centre_x, y=ray.y + centre_y)
        panel_x, panel_y, _ = to_panel(array, traits, moved)
    return panel_x, panel_y


def array_to_display(
    display: Display, x_mm: np.ndarray, y_mm: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Points of the array frame in the display frame: turned, then moved."""
    a = lens_array(display)
    x, y = a.cosine * x_mm - a.sine * y_mm, a.cosine * y_mm + a.sine * x_mm
    return x + a.shift_x, y + a.shift_y


def cell_of(
    display: Display, x_mm: np.ndarray, y_mm: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lens whose elemental image contains a panel point, with a flag whether there is one.

    The elemental images form the layout of the lenses at their own pitch Q: the array frame scaled
    by Q / P.

    * `display`: design of the panel's EIA.
    * `x_mm`, `y_mm`, (n,) float64: panel points, display frame.

    Returns `lens_x_mm`, `lens_y_mm`, (n,) float64: the lens's centre, array frame; `is_lit`, (n,)
    bool: False outside the panel and outside all elemental images.
    """
    array, traits = lens_array(display), lens_traits(display)
    rows, columns = display.eia_shape
    lit = np.abs(x_mm) <= columns * display.pixel_pitch_mm / 2
    lit &= np.abs(y_mm) <= rows * display.pixel_pitch_mm / 2
    x, y = _in_array_frame(display, x_mm, y_mm)
    scale = display.pitch_mm / display.elemental_image_pitch_mm
    lens_x, lens_y, inside = _lens_centre(array, traits, x * scale, y * scale)
    return lens_x, lens_y, lit & inside


class Lens(NamedTuple):
    """Lens whose cell contains a point of the array plane, for (n,) points."""

    #: (n,) float64: its centre, array frame.
    x_mm: np.ndarray
    y_mm: np.ndarray
    exists: np.ndarray  #: (n,) bool: True if the point is on the array.
    in_aperture: np.ndarray  #: (n,) bool


def lens_at(display: Display, x_mm: np.ndarray, y_mm: np.ndarray) -> Lens:
    """The lenses over points of the array plane, display frame, (n,) each."""
    array, traits = lens_array(display), lens_traits(display)
    x, y = _in_array_frame(display, x_mm, y_mm)
    centre_x, centre_y, exists = _lens_centre(array, traits, x, y)
    within = in_aperture(array, traits, x - centre_x, y - centre_y)
    return Lens(centre_x, centre_y, exists, within)


def _lens_centre(
    array: LensArray, traits: LensTraits, x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres of lenses, as `lens_centre` returns them; of a cylinder, the middle of its axis."""
    centre_x, centre_y, exists = lens_centre(array, traits, NUMPY_OPS, x, y)
    return centre_x, centre_y * (not traits.layout.of_cylinders), exists


def _in_array_frame(
    display: Display, x_mm: np.ndarray, y_mm: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    still = np.zeros_like(x_mm)
    array, traits = lens_array(display), lens_traits(display)
    x, y, _, _ = to_array(array, traits, x_mm, y_mm, still, still)
    return x, y


#: Names of the panel's colours, in the order of `inim.display.lens.channel_indices`.
COLOURS = ("red", "green", "blue")
# Rays across the square around a lens.
_RAYS_ACROSS = 32


@dataclass(frozen=True)
class Spot:
    """Image of a point on the panel, through one lens."""

    #: Angle between the axis and the line from the lens's centre to the point.
    field_angle_deg: float
    colour: str  #: ``"all"`` without dispersion, or one of `COLOURS`.
    #: (n,) float64: panel points of its rays, relative to their centre of gravity.
    x_um: np.ndarray
    y_um: np.ndarray
    #: Centre of gravity on the panel, display frame.
    centre_x_mm: float
    centre_y_mm: float
    #: Root mean square distance from it, weighted by light; in µm and in panel pixels.
    rms_radius_um: float
    rms_radius_px: float
    #: Share of the aperture's rays that are blocked or refracted by a neighbouring lens.
    lost_share: float

    def figures(self) -> SpotFigures:
        """The spot without its points; None where no ray lands."""
        values = {name: getattr(self, name) for name in SpotFigures.__struct_fields__}
        lengths = {name: finite_or_none(v) for name, v in values.items() if name != "colour"}
        return SpotFigures(**{**values, **lengths})


def finite_or_none(value: float) -> float | None:
    """A float for JSON: None if it is infinite or NaN."""
    return float(value) if math.isfinite(value) else None


def field_angles_deg(display: Display) -> tuple[float, float, float]:
    """The axis, half of the viewing half angle, and its edge."""
    edge = display.viewing_half_angle_deg
    return 0.0, edge / 2, edge


def spots(display: Display, model: str, depth_mm: float) -> tuple[Spot, ...]:
    """A `spot` for each field angle and, where the lenses' material is dispersive, colour."""
    colours: tuple[tuple[str, float | None], ...] = (("all", None),)
    if display.abbe_number is not None:
        colours = tuple(zip(COLOURS, channel_indices(display), strict=True))
    return tuple(
        spot(display, model, depth_mm, angle, colour, index)
        for angle in field_angles_deg(display)
        for colour, index in colours
    )


def spot(
    display: Display,
    model: str,
    depth_mm: float,
    field_angle_deg: float,
    colour: str = "all",
    index: float | None = None,
) -> Spot:
    """Spot of one point through the full aperture of the lens nearest to the array's centre.

    The point is at the depth z and z tan(angle) to the right of the lens, or in that direction at
    infinite depth. At the central depth plane, 1/f = 1/D + 1/g gives a point image; the spot then
    shows the aberrations only.

    * `display`: display with its misaligned array.
    * `model`: one of `inim.display.lens.lens_models` that is not a mesh.
    * `depth_mm`: z of the point, possibly behind the array or infinite.
    * `colour`, `index`: refractive index of that colour; default: the display's.
    """
    x, y, lens_x, lens_y = _aperture_points(display)
    tangent = math.tan(math.radians(field_angle_deg))
    if math.isinf(depth_mm):
        slope_x, slope_y = np.full_like(x, -tangent), np.zeros_like(y)
    else:
        centre_x, centre_y = array_to_display(display, lens_x, lens_y)
        slope_x, slope_y = (x - centre_x) / depth_mm - tangent, (y - centre_y) / depth_mm
    landed = land(display, model, x, y, slope_x, slope_y, index)
    return _measure_spot(display, landed, (lens_x, lens_y), field_angle_deg, colour)


def _aperture_points(display: Display) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points that fill a lens's aperture, display frame, and the lens's centre, array frame."""
    array, traits = lens_array(display), lens_traits(display)
    pitch, row = display.pitch_mm, display.row_pitch_mm
    # On the axis or, if that lies between lenses, up and to the right of it.
    offset = np.array([pitch / 4]), np.array([row / 4])
    lens_x, lens_y, _ = _lens_centre(array, traits, *offset)
    # Cylinders form lines of light: the rays are those of one plane across the axis.
    height = 0.0 if traits.layout.of_cylinders else traits.layout.cell_height(pitch, row)
    ticks = ((np.arange(_RAYS_ACROSS) + 0.5) / _RAYS_ACROSS - 0.5) * display.fill_factor
    right, up = (grid.ravel() for grid in np.meshgrid(ticks * pitch, ticks * height))
    x, y = array_to_display(display, lens_x + right, lens_y + up)
    over = lens_at(display, x, y)
    same = np.hypot(over.x_mm - lens_x, over.y_mm - lens_y) < display.pitch_mm / 8
    within = over.in_aperture & same
    return x[within], y[within], lens_x, lens_y


def _measure_spot(
    display: Display,
    landed: Landings,
    lens: tuple[np.ndarray, np.ndarray],
    field_angle_deg: float,
    colour: str,
) -> Spot:
    """Centre and size of where the lens's own rays landed."""
    off = np.hypot(landed.lens_x_mm - lens[0], landed.lens_y_mm - lens[1])
    own = (landed.weight > 0) & (off < display.pitch_mm / 8)
    x, y, light = landed.x_mm[own], landed.y_mm[own], landed.weight[own]
    if not own.any():
        empty = np.empty(0)
        return Spot(field_angle_deg, colour, empty, empty, *(math.nan,) * 4, 1.0)
    centre_x, centre_y = (float(np.average(v, weights=light)) for v in (x, y))
    square = (x - centre_x) ** 2 + (y - centre_y) ** 2
    radius = math.sqrt(np.average(square, weights=light))
    return Spot(
        field_angle_deg,
        colour,
        1e3 * (x - centre_x),
        1e3 * (y - centre_y),
        centre_x,
        centre_y,
        1e3 * radius,
        radius / display.pixel_pitch_mm,
        1 - float(own.mean()),
    )
