"""Spot diagrams: what one lens makes of a point, on the axis and off it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from inim.display import Display
from inim.inspect.rays import Landings, array_to_display, land, lens_at
from inim.lens import channel_indices, lens_array, lens_traits
from inim.lens.array import NUMPY_OPS, lens_centre

__all__ = ["COLOURS", "Spot", "field_angles_deg", "spot", "spots"]

#: Names of the panel's colours, in the order of `inim.lens.channel_indices`.
COLOURS = ("red", "green", "blue")
# Rays across the square around a lens.
_RAYS_ACROSS = 32


@dataclass(frozen=True)
class Spot:
    """The image of a point on the panel, through one lens.

    Attributes
    ----------
    field_angle_deg : float
        Between the axis and the line from the lens's centre to the point.
    colour : str
        ``"all"`` where the material bends all alike, or one of `COLOURS`.
    x_um, y_um : (n,) float64
        Where its rays land, from their centre of gravity.
    centre_x_mm, centre_y_mm : float
        The centre of gravity, on the panel, display frame.
    rms_radius_um, rms_radius_px : float
        Root mean square distance from it, weighted by light; in panel pixels.
    lost_share : float
        Of the aperture's rays: blocked, or bent by a neighbour they slipped over to.
    """

    field_angle_deg: float
    colour: str
    x_um: np.ndarray
    y_um: np.ndarray
    centre_x_mm: float
    centre_y_mm: float
    rms_radius_um: float
    rms_radius_px: float
    lost_share: float


def field_angles_deg(display: Display) -> tuple[float, float, float]:
    """The axis, half of the viewing half angle, and its edge."""
    edge = display.viewing_half_angle_deg
    return 0.0, edge / 2, edge


def spots(display: Display, model: str, depth_mm: float) -> tuple[Spot, ...]:
    """A spot for each field angle and, where the lenses' material is dispersive, colour.

    See `spot`.
    """
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
    """Rays of one point that fill the aperture of the lens nearest the array's centre.

    The point lies at the depth z, z tan(angle) to the right of the lens; at an infinite one, in
    that direction. At the central depth plane, where the panel is imaged to, 1/f = 1/D + 1/g makes
    its image a point; what is left are aberrations.

    Parameters
    ----------
    display : Display
        As its array lies.
    model : str
        One of `inim.lens.lens_models` that is no mesh.
    depth_mm : float
        z of the point; may be behind the array, or infinite.
    field_angle_deg : float
    colour, index : str, float, optional
        Refractive index of that colour, where it is not the display's own.
    """
    x, y, lens_x, lens_y = _aperture_points(display)
    tangent = math.tan(math.radians(field_angle_deg))
    if math.isinf(depth_mm):
        slope_x, slope_y = np.full_like(x, -tangent), np.zeros_like(y)
    else:
        centre_x, centre_y = array_to_display(display, lens_x, lens_y)
        slope_x, slope_y = (x - centre_x) / depth_mm - tangent, (y - centre_y) / depth_mm
    landed = land(display, model, x, y, slope_x, slope_y, index)
    return _measured(display, landed, (lens_x, lens_y), field_angle_deg, colour)


def _aperture_points(display: Display) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points that fill a lens's aperture, display frame, and the lens's centre, array frame."""
    array, traits = lens_array(display), lens_traits(display)
    pitch, row = display.pitch_mm, display.row_pitch_mm
    # On the axis or, if that lies between lenses, up and to the right of it.
    aside = np.array([pitch / 4]), np.array([row / 4])
    lens_x, lens_y, _ = lens_centre(array, traits, NUMPY_OPS, *aside)
    height = row if not traits.hexagonal else row + pitch**2 / (4 * row)
    ticks = ((np.arange(_RAYS_ACROSS) + 0.5) / _RAYS_ACROSS - 0.5) * display.fill_factor
    right, up = (grid.ravel() for grid in np.meshgrid(ticks * pitch, ticks * height))
    x, y = array_to_display(display, lens_x + right, lens_y + up)
    over = lens_at(display, x, y)
    same = np.hypot(over.x_mm - lens_x, over.y_mm - lens_y) < display.pitch_mm / 8
    within = over.in_aperture & same
    return x[within], y[within], lens_x, lens_y


def _measured(
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
