"""A picture seen from a viewpoint through the window of the lens array."""

import numpy as np

from inim.display import Display
from inim.display.viewpoint import Viewpoint
from inim.generators.base import HOLE
from inim.generators.raycast.columns import SURFACE, columns_of
from inim.generators.raycast.ray_by_ray import TracedSurfaces, first_hit
from inim.image.rgbd import RGBD
from inim.system.backend.kernels import compiled, share_rows

# Rays along each side of a view pixel.
_RAYS = 4


def trace_view(
    rgbd: RGBD, display: Display, eye: Viewpoint, pixels_per_lens: int
) -> tuple[np.ndarray, np.ndarray]:
    """Follow the rays of a view through the picture's columns; see `warp_to_viewpoint`."""
    rows, columns = (n * pixels_per_lens for n in display.layout.grid)
    x = _ray_positions(columns, display.width_mm)
    y = -_ray_positions(rows, display.height_mm)
    slope_x, slope_y = (eye.x_mm - x) / eye.z_mm, (eye.y_mm - y) / eye.z_mm
    surfaces = TracedSurfaces.of(columns_of(rgbd, SURFACE))
    view = np.zeros((rows, columns, 3), np.float32)
    share = np.zeros((rows, columns), np.float32)
    # In cells from the picture's left and upper border; rows count downwards.
    horizontal = (x / rgbd.pixel_mm + rgbd.shape[1] / 2, slope_x / rgbd.pixel_mm)
    vertical = (rgbd.shape[0] / 2 - y / rgbd.pixel_mm, -slope_y / rgbd.pixel_mm)
    z_range = display.traced_range_mm
    share_rows(
        _trace_view, len(view), surfaces, rgbd.color, *horizontal, *vertical, *z_range, view, share
    )
    return view, share


def _ray_positions(pixels: int, size_mm: float) -> np.ndarray:
    """Positions of a view's rays across the window, mm from its centre."""
    rays = pixels * _RAYS
    centres: np.ndarray = ((np.arange(rays) + 0.5) / rays - 0.5) * size_mm
    return centres


@compiled
def _trace_view(  # type: ignore[no-untyped-def]
    begin, end, surfaces, color, u0, du, v0, dv, z_min, z_max, view, share
):
    """Mean colour over the rays of each pixel, and the share of its rays that hit."""
    columns = surfaces.fronts.shape[2]
    weight = np.float32(1 / (_RAYS * _RAYS))
    for row in range(begin, end):
        for column in range(view.shape[1]):
            for i in range(row * _RAYS, (row + 1) * _RAYS):
                for j in range(column * _RAYS, (column + 1) * _RAYS):
                    hit = first_hit(surfaces, u0[j], du[j], 1.0, v0[i], dv[i], 1.0, z_min, z_max)
                    if hit != HOLE:
                        share[row, column] += weight
                        for c in range(3):
                            view[row, column, c] += weight * color[hit // columns, hit % columns, c]
