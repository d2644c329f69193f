"""How far rays go through a picture: refused where for ever, and laid out as tables where short."""

from __future__ import annotations

from inim.display import Display
from inim.errors import UsageError
from inim.generators.base import PictureShape
from inim.generators.raycast.cells import cell_rays
from inim.generators.raycast.direction_lists import cells_per_pitch
from inim.generators.raycast.simd import LANES

__all__ = ["check_ray_length", "fits_tables"]

# Picture pixels on one ray: ten thousand times those of usual displays.
_MOST_CELLS = 1_000_000
# Slots for depths and payloads, 8 bytes each, below which nobody asks how many are needed.
_MOST_SLOTS = 2**25


def check_ray_length(name: str, display: Display, shape: PictureShape, pixel_mm: float) -> None:
    """Raise `UsageError` for rays that the generator `name` would walk for ever."""
    depths = display.depth_range_mm
    if display.is_separable:
        rays = cell_rays(shape, pixel_mm, display)
        longest = float(max(axis.most_cells(depths) for axis in rays))
    else:
        longest = max(display.steepest_slopes) * (depths[1] - depths[0]) / pixel_mm
    if longest > _MOST_CELLS:
        raise UsageError(
            f"{name}: a ray crosses {longest:.3g} picture pixels within the depth range; at most "
            f"{_MOST_CELLS} make sense; state a shorter depth_min_mm to depth_max_mm, or "
            "larger picture pixels"
        )


def fits_tables(display: Display, shape: PictureShape, pixel_mm: float, layers: int = 1) -> bool:
    """Whether pictures laid out by phases, with all that rays reach around, take little memory.

    Where they do not, rays are walked one by one: the same bits.
    """
    per_pitch = cells_per_pitch(display, pixel_mm)
    if not per_pitch:
        return False
    columns, rows = (
        2 + axis.most_cells(display.depth_range_mm) // per_pitch
        for axis in cell_rays(shape, pixel_mm, display)
    )
    across = max(display.lens_columns, LANES) + columns
    cells = (display.lens_rows + rows) * across * per_pitch * per_pitch * layers
    panel = display.eia_shape[0] * display.eia_shape[1]
    return cells <= max(_MOST_SLOTS, 4 * (panel + shape[0] * shape[1]))
