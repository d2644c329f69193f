"""The closed forms: sizes, depth, voxels, viewing zone, what pixels per lens cost and give.

Formulas are those of Wang et al., Heritage Science 2024, doi 10.1186/s40494-024-01462-4, by
equation number; the rest is plain geometry.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from inim.display import Display
from inim.display.viewpoint import DEFAULT_VIEWPOINTS, Viewpoint, named_viewpoint
from inim.documents.inspect import PixelChoice
from inim.errors import DisplayError

# Panels are driven with 8 bits of red, green and blue.
_BYTES_PER_PIXEL = 3
_OUTLINE_POINTS = 201
_CURVE_POINTS = 241
# Of a quotient of two lengths that are themselves rounded.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class ViewingZone:
    """Where an eye sees no flipped view.

    Attributes
    ----------
    half_angle_deg : float
        Of one lens, atan(Q / 2g).
    nearest_mm : float or None
        Distance from which the axis sees no flips; None if there is none.
    distance_mm : float
        The viewing distance.
    limit_x_mm, limit_y_mm, limit_x_deg, limit_y_deg : float
        How far aside an eye may be there; negative: nowhere.
    viewpoints : tuple of Viewpoint
        The default eye positions.
    """

    half_angle_deg: float
    nearest_mm: float | None
    distance_mm: float
    limit_x_mm: float
    limit_y_mm: float
    limit_x_deg: float
    limit_y_deg: float
    viewpoints: tuple[Viewpoint, ...]

    @property
    def is_empty(self) -> bool:
        """Whether even an eye on the axis sees flips."""
        return min(self.limit_x_mm, self.limit_y_mm) < 0


def mode(display: Display) -> str:
    """``"real"`` (g > f, D in front), ``"virtual"`` (g < f, behind) or ``"focused"`` (g = f)."""
    if display.gap_mm == display.focal_length_mm:
        return "focused"
    return "real" if display.gap_mm > display.focal_length_mm else "virtual"


def has_whole_pixels(display: Display) -> bool:
    """Whether elemental images are a whole number of pixels wide and high."""
    sides = (display.elemental_image_pitch_mm, display.elemental_row_pitch_mm)
    counts = [side / display.pixel_pitch_mm for side in sides]
    return all(abs(n - round(n)) < _ROUNDING * n for n in counts)


def pixel_choice(display: Display, times: float) -> PixelChoice:
    """What this display would be with `times` as many pixels under each lens, all else as it is.

    One pixel's step in direction is atan(P_D / g) at the axis (Eq. 1: slope (x0 - x) / g), and the
    displayable depth 2 |D| P_I / P with P_I = |D| P_D / g (Eq. 3 and the text after Eq. 4) shrinks
    with the pixel.
    """
    pixel_mm = display.pixel_pitch_mm / times
    rows, columns = (math.ceil(n * times) for n in display.eia_shape)
    span = display.depth_span_mm
    return PixelChoice(
        pixels_per_lens=display.pixels_per_lens * times,
        pixel_pitch_mm=pixel_mm,
        views_across=display.elemental_image_pitch_mm / pixel_mm,
        views_down=display.elemental_row_pitch_mm / pixel_mm,
        angular_step_deg=math.degrees(math.atan(pixel_mm / display.gap_mm)),
        depth_span_mm=span / times if math.isfinite(span) else None,
        panel_columns=columns,
        panel_rows=rows,
        frame_mb=rows * columns * _BYTES_PER_PIXEL / 1e6,
    )


def viewing_zone(display: Display, distance_mm: float) -> ViewingZone:
    """The viewing zone and the default eyes at a distance; see `Display.flip_limit_mm`."""
    try:
        nearest: float | None = display.nearest_viewing_distance_mm
    except DisplayError:
        nearest = None
    limit_x, limit_y = display.flip_limit_mm(distance_mm)
    return ViewingZone(
        half_angle_deg=display.viewing_half_angle_deg,
        nearest_mm=nearest,
        distance_mm=distance_mm,
        limit_x_mm=limit_x,
        limit_y_mm=limit_y,
        limit_x_deg=math.degrees(math.atan2(limit_x, distance_mm)),
        limit_y_deg=math.degrees(math.atan2(limit_y, distance_mm)),
        viewpoints=tuple(named_viewpoint(n, display, distance_mm) for n in DEFAULT_VIEWPOINTS),
    )


def zone_outline_mm(display: Display, farthest_mm: float) -> list[tuple[float, float]]:
    """Half widths of the viewing zone seen from above: (distance, farthest offset in x) in mm.

    From where the zone begins to `farthest_mm` or to its end, if the elemental images' pitch makes
    it close again; empty where it does not reach that far.
    """
    steps = [farthest_mm * (n + 1) / _OUTLINE_POINTS for n in range(_OUTLINE_POINTS)]
    limits = [(z, display.flip_limit_mm(z)[0]) for z in steps]
    return [(z, limit) for z, limit in limits if limit >= 0]


@dataclass(frozen=True)
class VoxelCurve:
    """Voxel size against depth; (n,) float64 each, millimetres.

    Attributes
    ----------
    depth_mm : ndarray
        Along z, wider than the depth range by half of it on either side.
    footprint_mm, blur_mm, width_mm : ndarray
        A pixel's footprint, the aperture's blur, and both together.
    """

    depth_mm: np.ndarray
    footprint_mm: np.ndarray
    blur_mm: np.ndarray
    width_mm: np.ndarray


def pixel_footprint_mm(display: Display, depth_mm: np.ndarray | float) -> np.ndarray:
    """A panel pixel projected through the lens centre onto depth z: |z| P_D / g (from Eq. 1)."""
    depth = np.asarray(depth_mm, float)
    return np.asarray(np.abs(depth) * display.pixel_pitch_mm / display.gap_mm)


def aperture_blur_mm(display: Display, depth_mm: np.ndarray | float) -> np.ndarray:
    """Width at depth z of the beam that a panel point sends through a lens: A |z - D| / |D|.

    A is the aperture's width, the pitch where lenses fill their cells. The beam is as wide as the
    lens at z = 0 and comes to a point at D (similar triangles); a focused display's stays A.
    """
    aperture = display.fill_factor * display.pitch_mm
    depth = np.asarray(depth_mm, float)
    if math.isinf(display.central_depth_mm):
        return np.full_like(depth, aperture)
    centre = display.central_depth_mm
    return np.asarray(aperture * np.abs(depth - centre) / abs(centre))


def voxel_mm(display: Display, depth_mm: np.ndarray | float) -> np.ndarray:
    """Width of one pixel's whole beam at depth z: footprint plus blur.

    Each point of the pixel sends a beam as wide as the blur, and their axes spread over the
    footprint; so the edges lie exactly their sum apart. At D it is P_I = |D| P_D / g (Eq. 3).
    """
    return np.asarray(pixel_footprint_mm(display, depth_mm) + aperture_blur_mm(display, depth_mm))


def voxel_curve(display: Display) -> VoxelCurve:
    """Voxel size over twice the depth range, its middle in the middle."""
    low, high = display.depth_range_mm
    margin = (high - low) / 2
    depth = np.linspace(low - margin, high + margin, _CURVE_POINTS)
    return VoxelCurve(
        depth,
        pixel_footprint_mm(display, depth),
        aperture_blur_mm(display, depth),
        voxel_mm(display, depth),
    )
