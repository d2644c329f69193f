"""The depth steps of Eq. 5 for all pixels of a lens, against the bounds that the paper states.

``Step_z = g P_I / |x0 - x|`` (Eq. 5, as it is printed, for x alone) with P_I of Eq. 3 lies between
``2 g P_I / P`` and ``g P_I``, says the paper. The second is a length where ``|x0 - x|`` is counted
in panel pixels: ``(g / P_D) P_I``, which is |D|.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from inim.display import DISPLAYS, Display
from inim.generators.raycast.cells import cell_rays
from reports.bench.study import square_display

# Steps this much beyond a bound are on it, but for rounding.
_ROUNDING = 1e-9


def depth_steps(displays: Sequence[Display] | None = None) -> list[dict[str, Any]]:
    """Least and largest step of each display, the bounds, and how many columns are beyond.

    Parameters
    ----------
    displays : sequence of Display, optional
        An odd and an even number of pixels to the lens, and the preset `phone`, if not given.
    """
    chosen = displays or (square_display(3), square_display(3, 16), DISPLAYS["phone"])
    return [_steps_of(display) for display in chosen]


def _steps_of(display: Display) -> dict[str, Any]:
    p_i, gap, pixel = display.scene_pixel_mm, display.gap_mm, display.pixel_pitch_mm
    rays, _ = cell_rays((1, 1), p_i, display)  # slopes in P_I sideways for a millimetre of depth
    travel = np.abs(rays.slope / rays.scale)[display.columns.lens >= 0]
    # Without a step: pixels under the centre, but for the rounding of positions.
    endless = travel < _ROUNDING * travel.max()
    steps = 1 / travel[~endless]
    lower, upper = 2 * gap * p_i / display.pitch_mm, gap * p_i / pixel
    return {
        "display": f"{display.pixels_per_lens:.4g} pixels to the lens",
        "scene_pixel_mm": p_i,
        "columns": len(travel),
        "endless": int(endless.sum()),
        "least_mm": float(steps.min()),
        "most_mm": float(steps.max()),
        "lower_mm": lower,
        "upper_mm": upper,
        "upper_in_mm": gap * p_i,
        "beyond": int(endless.sum() + (steps > upper * (1 + _ROUNDING)).sum()),
    }
