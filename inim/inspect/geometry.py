"""The closed forms: sizes, depth, viewing zone, and what pixels per lens cost and give.

Formulas are those of Wang et al., Heritage Science 2024, doi 10.1186/s40494-024-01462-4, by
equation number; the rest is plain geometry.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from inim.display import Display
from inim.display.viewpoint import DEFAULT_VIEWPOINTS, Viewpoint, named_viewpoint
from inim.errors import DisplayError

__all__ = [
    "PixelChoice",
    "ViewingZone",
    "flip_limit_deg",
    "has_whole_pixels",
    "mode",
    "nearest_distance_mm",
    "pixel_choice",
    "viewing_zone",
    "zone_outline_mm",
]

# Panels are driven with 8 bits of red, green and blue.
_BYTES_PER_PIXEL = 3
_OUTLINE_POINTS = 201
# Of a quotient of two lengths that are themselves rounded.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class PixelChoice:
    """What one number of pixels per lens gives, and costs.

    Attributes
    ----------
    pixels_per_lens : float
        Along one axis.
    pixel_pitch_mm : float
    views_across, views_down : float
        Directions each lens can show.
    angular_step_deg : float
        Between two of them, at the axis.
    depth_span_mm : float
        Displayable depth by the formula; infinite if focused.
    panel_columns, panel_rows : int
    frame_mb : float
        Of one picture for the panel, 3 bytes per pixel, 10^6 bytes.
    """

    pixels_per_lens: float
    pixel_pitch_mm: float
    views_across: float
    views_down: float
    angular_step_deg: float
    depth_span_mm: float
    panel_columns: int
    panel_rows: int
    frame_mb: float


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
        The distance looked at.
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
    return PixelChoice(
        pixels_per_lens=display.pixels_per_lens * times,
        pixel_pitch_mm=pixel_mm,
        views_across=display.elemental_image_pitch_mm / pixel_mm,
        views_down=display.elemental_row_pitch_mm / pixel_mm,
        angular_step_deg=math.degrees(math.atan(pixel_mm / display.gap_mm)),
        depth_span_mm=display.depth_span_mm / times,
        panel_columns=columns,
        panel_rows=rows,
        frame_mb=rows * columns * _BYTES_PER_PIXEL / 1e6,
    )


def viewing_zone(display: Display, distance_mm: float) -> ViewingZone:
    """The viewing zone and the default eyes at a distance; see `Display.flip_limit_mm`."""
    limit_x, limit_y = display.flip_limit_mm(distance_mm)
    return ViewingZone(
        half_angle_deg=display.viewing_half_angle_deg,
        nearest_mm=nearest_distance_mm(display),
        distance_mm=distance_mm,
        limit_x_mm=limit_x,
        limit_y_mm=limit_y,
        limit_x_deg=flip_limit_deg(limit_x, distance_mm),
        limit_y_deg=flip_limit_deg(limit_y, distance_mm),
        viewpoints=tuple(named_viewpoint(n, display, distance_mm) for n in DEFAULT_VIEWPOINTS),
    )


def flip_limit_deg(limit_mm: float, distance_mm: float) -> float:
    """The limit as an angle at the display's centre, atan(limit / V)."""
    return math.degrees(math.atan2(limit_mm, distance_mm))


def nearest_distance_mm(display: Display) -> float | None:
    """Distance from which an eye on the axis sees no flips; None if none will do."""
    try:
        return display.nearest_viewing_distance_mm
    except DisplayError:
        return None


def zone_outline_mm(display: Display, farthest_mm: float) -> list[tuple[float, float]]:
    """Half widths of the viewing zone seen from above: (distance, farthest offset in x) in mm.

    From where the zone begins to `farthest_mm` or to its end, if the elemental images' pitch makes
    it close again; empty where it does not reach that far.
    """
    steps = [farthest_mm * (n + 1) / _OUTLINE_POINTS for n in range(_OUTLINE_POINTS)]
    limits = [(z, display.flip_limit_mm(z)[0]) for z in steps]
    return [(z, limit) for z, limit in limits if limit >= 0]
