"""`pinhole`: the ideal lens of the paper's Eq. 1.

Every ray that enters a lens's cell passes straight through its centre, keeping its direction.
"""

from __future__ import annotations

from typing import Any

from inim.lens.array import LensArray, Ops, lens_centre

__all__ = ["trace"]


def trace(array: LensArray, ops: Ops, x: Any, y: Any, sx: Any, sy: Any) -> tuple[Any, Any, Any]:
    """See `inim.lens`: (panel_x, panel_y, weight) of a viewer's ray."""
    centre_x, centre_y, inside = lens_centre(array, ops, x, y)
    weight = ops.where(inside, 1.0, 0.0)
    return centre_x + array.gap * sx, centre_y + array.gap * sy, weight
