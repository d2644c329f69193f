"""`pinhole`: the ideal lens of the paper's Eq. 1.

Every ray that enters a lens's cell passes straight through its centre, keeping its direction.
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
    """See `inim.display.lens`: where a viewer's ray meets the panel."""
    del index  # nothing is refracted
    centre_x, centre_y, inside = lens_centre(array, traits, ops, x, y)
    ray = PanelRay(
        centre_x + array.gap * sx, centre_y + array.gap * sy, sx, sy, ops.where(inside, 1.0, 0.0)
    )
    within = in_aperture(array, traits, x - centre_x, y - centre_y)
    return pass_straight(array, traits, ops, ray, within, inside, (x, y, sx, sy), 1.0)


MODEL = LensModel(
    "pinhole",
    summary="straight through the lens's centre (Eq. 1 of Wang et al. 2024)",
    trace=trace,
    refracts=False,
    stand_in="pinhole",
    steepest_slope=1000.0,
)
