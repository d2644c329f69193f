"""The picture seen from an eye, by its own depth: no display in between."""

from __future__ import annotations

import numpy as np

from inim.backend.kernels import compiled, prange
from inim.display import Display, Viewpoint
from inim.generators.base import HOLE
from inim.generators.raycast.columns import SURFACE, columns_of
from inim.generators.raycast.ray_by_ray import first_hit
from inim.image.rgbd import RGBD

# Rays along each side of a view pixel.
_RAYS = 4


def warped(
    rgbd: RGBD, display: Display, eye: Viewpoint, pixels_per_lens: int
) -> tuple[np.ndarray, np.ndarray]:
    """What an eye sees of a picture through the window of the array.

    Each ray shows the first of the picture's columns that it meets, as thick as the surface that
    each pixel shows: what `template` takes the picture for, from another place.

    Parameters
    ----------
    rgbd : RGBD
        Linear float32.
    display : Display
    eye : Viewpoint
        As a point.
    pixels_per_lens : int
        Of the view, along each side.

    Returns
    -------
    view : (rows, columns, 3) float32, linear RGB
        Black where nothing is met.
    met : (rows, columns) float32
        Share of each pixel's rays that meet something.
    """
    rows, columns = (n * pixels_per_lens for n in (display.lens_rows, display.lens_columns))
    x = _places(columns, display.width_mm)
    y = -_places(rows, display.height_mm)
    slope_x, slope_y = (eye.x_mm - x) / eye.z_mm, (eye.y_mm - y) / eye.z_mm
    columns_met = columns_of(rgbd, SURFACE)
    met_by_rays = (columns_met.fronts(), columns_met.backs(), columns_met.continue_behind)
    view = np.zeros((rows, columns, 3), np.float32)
    met = np.zeros((rows, columns), np.float32)
    # In cells from the picture's left and upper border; rows count downwards.
    across = (x / rgbd.pixel_mm + rgbd.shape[1] / 2, slope_x / rgbd.pixel_mm)
    down = (rgbd.shape[0] / 2 - y / rgbd.pixel_mm, -slope_y / rgbd.pixel_mm)
    _see(*met_by_rays, rgbd.color, *across, *down, *display.depth_range_mm, view, met)
    return view, met


def _places(pixels: int, size_mm: float) -> np.ndarray:
    """Centres of a view's rays across the window, mm from its middle."""
    rays = pixels * _RAYS
    centres: np.ndarray = ((np.arange(rays) + 0.5) / rays - 0.5) * size_mm
    return centres


@compiled(parallel=True)
def _see(fronts, backs, continue_behind, color, u0, du, v0, dv, z_min, z_max, view, met):  # type: ignore[no-untyped-def]
    """Mean colour of what each pixel's rays meet, and how many do."""
    columns = fronts.shape[2]
    share = np.float32(1 / (_RAYS * _RAYS))
    for row in prange(view.shape[0]):
        for column in range(view.shape[1]):
            for i in range(row * _RAYS, (row + 1) * _RAYS):
                for j in range(column * _RAYS, (column + 1) * _RAYS):
                    hit = first_hit(
                        fronts, backs, continue_behind,
                        u0[j], du[j], 1.0, v0[i], dv[i], 1.0, z_min, z_max,
                    )  # fmt: skip
                    if hit != HOLE:
                        met[row, column] += share
                        for c in range(3):
                            view[row, column, c] += share * color[hit // columns, hit % columns, c]
