"""Depth steps of Eq. 5 for all pixels of a lens, compared with the paper's bounds.

According to the paper, ``Step_z = g P_I / |x0 - x|`` (Eq. 5 as printed, for x only) with P_I of
Eq. 3 is between ``2 g P_I / P`` and ``g P_I``. The upper bound is a length only if ``|x0 - x|`` is
in panel pixels. It is then ``(g / P_D) P_I``, which is |D|.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from inim.display import DISPLAYS, Display
from inim.generators.raycast.cells import cell_rays
from reports.bench.study import square_display

# Relative rounding error of a step at a bound.
_ROUNDING = 1e-9


def depth_steps(displays: Sequence[Display] | None = None) -> list[dict[str, Any]]:
    """Smallest and largest step of each display, the bounds, and the columns beyond them.

    Default: displays with an odd and an even number of pixels per lens, and `phone`.
    """
    displays = displays or (square_display(3), square_display(3, 16), DISPLAYS["phone"])
    return [_steps_of(display) for display in displays]


def _steps_of(display: Display) -> dict[str, Any]:
    p_i, gap, pixel = display.scene_pixel_mm, display.gap_mm, display.pixel_pitch_mm
    rays, _ = cell_rays((1, 1), p_i, display)  # slopes: sideways travel in P_I per mm of depth
    travel = np.abs(rays.slope / rays.scale)[display.columns.lens >= 0]
    # Pixels under the lens centre have no step; their travel is a rounding error.
    endless = travel < _ROUNDING * travel.max()
    steps = 1 / travel[~endless]
    lower, upper = 2 * gap * p_i / display.pitch_mm, gap * p_i / pixel
    return {
        "display": f"{display.pixels_per_lens:.4g} pixels per lens",
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
