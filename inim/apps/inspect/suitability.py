"""Figures to choose a display by: detail, depth, viewing zone, brightness, accuracy."""

import math
from collections.abc import Sequence

import numpy as np

from inim.apps.inspect.document import LightRecord, Suitability
from inim.apps.inspect.geometry import aperture_blur_mm, pixel_footprint_mm
from inim.apps.inspect.spots import Spot
from inim.display import Display
from inim.display.lens import lens_model as find_lens_model
from inim.display.misalignment import one_pixel_errors

# Usual distance between the pupils of two eyes (Dodgson 2004, doi 10.1117/12.529999).
_EYES_APART_MM = 63.0
# Share of a pixel by which an error may shift the observed panel point: errors of 0.09 to 0.38
# pixels lost 0.01 of SSIM.
_KNOWN_TO_PIXELS = 0.1
# Details are still sharp up to this multiple of the finest ones.
_SHARP = 2.0


def suitability(
    display: Display,
    distance_mm: float,
    model: str,
    of_points: Sequence[Spot],
    light: LightRecord,
) -> Suitability:
    """Compute the figures for a viewer on the axis.

    * `model`: one of `inim.display.lens.lens_models` that is not a mesh.
    * `of_points`, `light`: traced spots, and the light on the axis.
    """
    pixels = _spot_pixels(of_points, model)
    low, high = display.depth_range_mm
    # Details grow linearly from the sharpest depth and from the array: an end is the worst.
    detail = float(np.max(_detail_mm(display, np.array([low, high]), pixels)))
    half_x, half_y = display.flip_limit_mm(distance_mm)
    border = _zone_border_mm(display, distance_mm, pixels)
    head = half_x - border - _EYES_APART_MM / 2
    fits = head >= 0 and half_y >= border
    rows, columns = display.layout.grid
    return Suitability(
        lens_columns=columns,
        lens_rows=rows,
        detail_mm=detail,
        details_across=display.width_mm / detail,
        depth_mm=high - low,
        sharp_depth_mm=sharp_depth_mm(display, pixels),
        zone_width_mm=2 * max(half_x, 0.0) if half_y >= 0 else 0.0,
        zone_height_mm=None if math.isinf(half_y) else 2 * max(half_y, 0.0),
        two_eyes_fit=fits,
        head_movement_mm=head if fits else None,
        brightness=light.own_share + light.neighbour_share + light.past_lenses_share,
        accuracy={k: _KNOWN_TO_PIXELS * v for k, v in one_pixel_errors(display).items()},
    )


def _zone_border_mm(display: Display, distance_mm: float, blurred_pixels: float) -> float:
    """Width of the border of the viewing zone, in which lenses show part of a neighbour's picture.

    An eye sees a patch of the panel through a lens of aperture A, A g abs(1 / D - 1 / V) wide, and
    a pixel's width with the lens's spot about it. At the flip limit, half of it is the neighbour's.
    """
    plane, gap = display.central_depth_mm, display.gap_mm
    aperture = display.fill_factor * display.pitch_mm
    patch = aperture * gap * abs((0.0 if math.isinf(plane) else 1 / plane) - 1 / distance_mm)
    pixel = display.pixel_pitch_mm * math.hypot(_pixel_share(display), blurred_pixels)
    return (patch + pixel) / 2 * distance_mm / gap


def _spot_pixels(of_points: Sequence[Spot], model: str) -> float:
    """Width of the largest spot, twice its RMS radius, in panel pixels.

    0 without any spot, and for lens models without refraction, whose spots are no images.
    """
    if not find_lens_model(model).refracts:
        return 0.0
    radii = [s.rms_radius_px for s in of_points if math.isfinite(s.rms_radius_px)]
    return 2 * max(radii, default=0.0)


def _detail_mm(display: Display, depth_mm: np.ndarray, blurred_pixels: float = 0.0) -> np.ndarray:
    """Width of the finest detail at depths: the voxel of a panel pixel blurred by a lens's spot.

    * `blurred_pixels`: width of the spot, panel pixels. Squares of widths add up.

    A slanted lenticular has a direction for each sub-pixel: pixels are a third as wide.
    """
    width = math.hypot(_pixel_share(display), blurred_pixels)
    footprint = pixel_footprint_mm(display, depth_mm) * width
    return np.asarray(footprint + aperture_blur_mm(display, depth_mm))


def _pixel_share(display: Display) -> float:
    return 1 / 3 if display.layout.of_cylinders and display.subpixels != "none" else 1.0


def sharp_depth_mm(display: Display, blurred_pixels: float = 0.0) -> float:
    """Length of the depths whose details are at most twice as wide as the finest ones.

    * `blurred_pixels`: see `_detail_mm`; by default lenses are ideal.

    The width is linear between the array and the central depth plane D, one of which has the finest
    details, and on either side of both.
    """
    centre = display.central_depth_mm
    ends = np.sort([0.0, 0.0 if math.isinf(centre) else centre])
    widths = _detail_mm(display, ends, blurred_pixels)
    growth = float(np.diff(_detail_mm(display, ends[1] + np.array([0.0, 1.0]), blurred_pixels))[0])
    room = _SHARP * widths.min() - widths
    between = float(np.ptp(ends))
    slopes = np.where(room >= 0, growth, np.ptp(widths) / (between or 1.0) or growth)
    return between + float((room / slopes).sum())
