"""EIAs of a 4D light field: of its centre view and disparity, or of all its views.

The views are laid over the lens array, and the outermost directions of a lens's field become the
outermost views. A point of disparity d is then at ``z = k (d + shift)``, with k from
`inim.image.files.light_field.disparity_step_mm`; the shift takes the middle of the disparities to
the central depth plane. Views from `inim export` are not shifted, and yield the same EIA again.
Depth is not fitted to the display's range: so the EIA of the centre view can be compared, pixel by
pixel, with that of the true views.
"""

import numpy as np

from inim.apps.own_picture.depth_values import DepthValues
from inim.apps.own_picture.fit import depth_range, fit_picture, map_depth
from inim.display import Display
from inim.image.color import linear_from_srgb
from inim.image.files.light_field import LightField, disparity_step_mm, eia_from_views
from inim.image.rgbd import RGBD
from inim.system.errors import FileError


def centre_view_picture(
    field: LightField, display: Display, pixels_per_pitch: float = 5, name: str = "light field"
) -> tuple[RGBD, float]:
    """Picture of the centre view and its disparity in the display frame, and the clipped share.

    Raises `FileError` if there is no disparity, or no view in the middle.
    """
    down, across = field.views.shape[:2]
    if field.disparity is None:
        raise FileError(
            f"{name}: no gt_disp_lowres.pfm, the disparity of the centre view; use --all-views"
        )
    if not (down % 2 and across % 2):
        raise FileError(f"{name}: {across} x {down} views have none in the middle; use --all-views")
    if not np.isfinite(field.disparity).any():
        raise FileError(
            f"{name}: no pixel of the disparity is finite; write it again, or use --all-views"
        )
    step = step_mm(field, display)
    shift = shift_px(field, display)
    disparity = np.where(np.isfinite(field.disparity), field.disparity, np.float32(np.nan))
    values = DepthValues(disparity, True, False, 0.0, ())
    low, high = display.depth_range_mm
    depth_map = map_depth("linear", values, (high / step - shift, low / step - shift), display)
    fitted = fit_picture(
        field.views[down // 2, across // 2],
        values,
        depth_map,
        display,
        camera=None,
        pixels_per_pitch=pixels_per_pitch,
    )
    return fitted.rgbd, fitted.clipped


def eia_of_all_views(field: LightField, display: Display) -> tuple[np.ndarray, np.ndarray]:
    """EIA of all views, (rows, columns, 3) float32 linear RGB, and the mask of its views."""
    opaque = np.full((*field.views.shape[:4], 1), 255, np.uint8)
    codes = eia_from_views(
        _squared(np.concatenate([field.views, opaque], axis=-1)),
        display,
        shift_px(field, display),
        _pixel_mm(field, display),
    )
    return linear_from_srgb(np.arange(256) / 255)[codes[..., :3]], codes[..., 3] > 0


def _squared(views: np.ndarray) -> np.ndarray:
    """Pad a light field with empty views to a square grid.

    From view to view the eye moves as far down as across, so a lens's field, as high as it is wide,
    has room for more rows than a wide grid has.
    """
    down, across = views.shape[:2]
    if (across - down) % 2:  # else the middle would move by half a view
        views = views[:-1] if down > across else views[:, :-1]
        down, across = views.shape[:2]
    sides = [((max(down, across) - n) // 2,) * 2 for n in (down, across)]
    return np.pad(views, [*sides, (0, 0), (0, 0), (0, 0)])


def _pixel_mm(field: LightField, display: Display) -> float:
    """Pixel size of a view that fits the array."""
    height, width = field.views.shape[2:4]
    return min(display.width_mm / int(width), display.height_mm / int(height))


def step_mm(field: LightField, display: Display) -> float:
    """Depth [mm] of one pixel of disparity."""
    down, across = field.views.shape[:2]
    even = (down - across) % 2  # one row or column is left out
    return disparity_step_mm(display, max(down, across) - even, _pixel_mm(field, display))


def shift_px(field: LightField, display: Display) -> float:
    """Disparity that moves the middle to the central depth plane; 0 for views of an EIA."""
    if field.of_display:
        return 0.0
    low, high = display.depth_range_mm
    centre = display.central_depth_mm
    target = centre if low <= centre <= high else (low + high) / 2
    step = step_mm(field, display)
    if field.disparity is None or not np.isfinite(field.disparity).any():
        return target / step
    near, far = depth_range(DepthValues(field.disparity, True, False, 0.0, ()))
    return target / step - (near + far) / 2
