"""`thin`: the paraxial lens, with its aperture.

A ray at height h from the lens's axis leaves it with its slope lessened by h / f: all rays of one
direction meet in one point of the plane f behind the lens, and all rays from a point at the
central depth plane in one point of the panel.
"""

from typing import Any

from inim.display.lens.array import (
    LensArray,
    LensTraits,
    Ops,
    PanelRay,
    in_aperture,
    lens_centre,
    pass_straight,
)
from inim.display.lens.model import LensModel


def trace(
    array: LensArray, traits: LensTraits, ops: Ops, x: Any, y: Any, sx: Any, sy: Any, index: Any
) -> PanelRay:
    """See `inim.display.lens`: where a viewer's ray meets the panel.

    A material's dispersion changes the power with the index: 1 / f grows with n - 1.
    """
    centre_x, centre_y, inside = lens_centre(array, traits, ops, x, y)
    dx, dy = x - centre_x, y - centre_y
    power = (index - 1.0) / array.radius
    qx, qy = sx - dx * power, sy - dy * power
    ray = PanelRay(x + array.gap * qx, y + array.gap * qy, qx, qy, ops.where(inside, 1.0, 0.0))
    within = in_aperture(array, traits, dx, dy)
    return pass_straight(array, traits, ops, ray, within, inside, (x, y, sx, sy), 1.0)


MODEL = LensModel(
    "thin",
    summary="paraxial: a slope s at height h goes on as s - h / f",
    trace=trace,
    stand_in="thin",
    steepest_slope=1000.0,
    least_index=1.01,  # nearer to 1, n - 1 has few digits
)
