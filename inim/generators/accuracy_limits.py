"""Accuracy limits: tested ranges of parameters; outside, validations warn.

`inim stress` checks them: its relations of growth state the range in which results are exact
enough. `reports/stress` has a full run, and a test compares it with the limits. Inside all limits,
sources of `template` and `layered` are exact on separable displays, in float32 and float64, and
panel points of lens models have an error of at most `LANDING_PIXELS` in float32.
"""

import math
from collections.abc import Iterable

import numpy as np

from inim.display import Display, Viewpoint
from inim.display.lens import lens_model as find_lens_model
from inim.generators.raycast.cells import cell_rays

#: Error of a landing point, in panel pixels, that counts as none: far below what a lens blurs.
LANDING_PIXELS = 0.01
#: Panel pixels along one side: beyond, float32 places are too coarse.
WIDEST_PANEL_PIXELS = 170_000
#: Largest share of a noise picture's pixels that lengths of too many digits changed.
CHANGED_BY_ROUNDING = 0.40
#: The same of hexagonal, turned and tilted arrays, whose rays are float64 and meet corners there.
CHANGED_BY_TIES = 0.44
#: Degrees off every multiple of `_REGULAR_TURN_DEG` from which only rays near the axis meet any.
LEAST_TURN_DEG = 1e-3
# Turns at which rows of pixels and of lenses run along or through each other's corners.
_REGULAR_TURN_DEG = 15.0
# Cells count too: what is exact over this picture is over smaller ones.
_LARGEST_PICTURE = (8192, 8192)
#: Depths a float32 picture must be able to tell within the depth range: those of 8 bits.
FEWEST_DEPTHS = 256


def accuracy_warnings(
    display: Display,
    lens_model: str | None = None,
    *,
    viewpoints: Iterable[Viewpoint] = (),
    slope: float | None = None,
    pixel_mm: float | None = None,
) -> list[str]:
    """One sentence with numbers for each exceeded limit.

    * `lens_model`: lens model of the reconstructed views; None without views.
    * `viewpoints`: viewpoints of the views.
    * `slope`: sideways travel per millimetre of the steepest ray, in addition to those of the
      viewpoints.
    * `pixel_mm`: pixel of the RGB-D picture.
    """
    warnings = _generator_limits(display, pixel_mm)
    if lens_model is not None:
        eyes = [steepest_slope(display, eye) for eye in viewpoints]
        warnings += _lens_limits(display, lens_model, max([*eyes, 0.0 if slope is None else slope]))
    return warnings


def lenses_beside_panel(display: Display) -> list[str]:
    """A sentence where elemental images reach beyond the panel; empty if they fit."""
    wide, high = display.panel_excess_mm
    if max(wide, high) < display.pixel_pitch_mm:
        return []
    high_mm, wide_mm = (n * display.pixel_pitch_mm for n in display.eia_shape)
    rows, columns = display.lenses_on_panel
    return [
        f"the lens array is {wide:.4g} mm wider and {high:.4g} mm higher than the panel, "
        f"{wide_mm:.5g} x {high_mm:.5g} mm: what lies beside it is cut off; "
        f"set lens_columns to {columns} and lens_rows to {rows}"
    ]


def steepest_slope(display: Display, eye: Viewpoint) -> float:
    """Sideways travel per millimetre of the ray from an eye to the array's farthest corner."""
    half = eye.pupil_mm / 2
    x = abs(eye.x_mm) + half + display.width_mm / 2
    y = abs(eye.y_mm) + half + display.height_mm / 2
    return math.hypot(x, y) / eye.z_mm


def _generator_limits(display: Display, pixel_mm: float | None) -> list[str]:
    warnings = []
    if not _is_exact(display, display.pitch_mm if pixel_mm is None else pixel_mm):
        warnings.append(
            "the display's lengths have too many digits to be computed with exactly: a ray that "
            "meets a corner of the picture's pixels may be given to a neighbour (up to "
            f"{CHANGED_BY_ROUNDING:.0%} of the pixels of a noise picture, reports/stress); round "
            "gap_mm, pitch_mm and pixel_pitch_mm to four digits"
        )
    if not display.is_separable and _meets_corners(display):
        warnings.append(
            f"{display.not_separable_by}: rays of this array meet corners of the picture's pixels, "
            f"and rounding decides which neighbour they show (up to {CHANGED_BY_TIES:.0%} of the "
            "pixels of a noise picture, reports/stress); where the very pixel matters, change "
            f"rotation_deg by {LEAST_TURN_DEG:g}"
        )
    low, high = display.depth_range_mm
    farthest = max(abs(low), abs(high))
    with np.errstate(over="ignore"):
        is_finite = bool(np.isfinite(np.float32(farthest)))
        depths = (high - low) / float(np.spacing(np.float32(farthest))) if is_finite else 0.0
    if depths < FEWEST_DEPTHS:
        warnings.append(
            f"the depth range [{low:g}, {high:g}] mm holds {depths:.3g} steps of float32 depth, "
            f"fewer than {FEWEST_DEPTHS}: pictures cannot tell depths apart; widen the range"
        )
    return warnings


def _is_exact(display: Display, pixel_mm: float) -> bool:
    """True if rays over the picture are whole numbers, which proves their exactness.

    Displays that are not separable have no such rays: see `_meets_corners`.
    """
    if not display.is_separable:
        return True
    # Where they cannot be, everything is in cells: a scale of one.
    return all(rays.scale > 1 for rays in cell_rays(_LARGEST_PICTURE, pixel_mm, display))


def _meets_corners(display: Display) -> bool:
    """True if the array's rotation is so close to a regular angle that its rays meet corners."""
    off = math.remainder(display.rotation_deg, _REGULAR_TURN_DEG)
    return abs(off) < LEAST_TURN_DEG * (1 - 1e-9)


def _lens_limits(display: Display, lens_model: str, slope: float) -> list[str]:
    warnings = []
    model = find_lens_model(lens_model)
    limit = model.steepest_slope
    if slope > limit:
        warnings.append(
            f"rays travel {slope:.3g} mm sideways per millimetre, more than the {limit:g} that "
            f"the {lens_model} lens was measured safe for; move the eye back, or use fewer lenses"
        )
    widest = max(display.eia_shape)
    if widest > WIDEST_PANEL_PIXELS:
        warnings.append(
            f"a panel {widest} pixels wide: in float32 its far pixels are placed with an error of "
            f"more than {LANDING_PIXELS:g} pixels beyond {WIDEST_PANEL_PIXELS}; split the display"
        )
    if display.refractive_index < model.least_index:
        warnings.append(
            f"refractive_index = {display.refractive_index:.10g}: below {model.least_index:g} the "
            "power of a lens loses its digits in float32; use an index of a real material"
        )
    return warnings
