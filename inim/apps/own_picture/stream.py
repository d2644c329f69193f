"""`inim.CameraFit`: one fit for all pictures of a depth camera, so that a stream does not jump."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from inim.apps.own_picture.depth_values import DepthConvention, interpret_depth, sample
from inim.apps.own_picture.fit import (
    check_pinhole,
    depth_range,
    fit_picture,
    map_depth,
    parse_intrinsics,
)
from inim.apps.own_picture.missing_depth import fill_missing_depth
from inim.apps.own_picture.options import FillRule
from inim.apps.own_picture.picture_files import DepthFile
from inim.display import Display
from inim.image.rgbd import RGBD
from inim.render.scene_files.file import display_of
from inim.system.errors import UsageError


class CameraFit:
    """Fit of a depth camera's pictures to a display: that of the first one, for all of them.

    Depths are distances from the camera along its axis, in millimetres. They are missing where they
    are 0, negative or not finite. Those from `near_mm` to `far_mm` are mapped linearly onto the
    display's depth range, the nearest to its front; those beyond are moved to its ends.

    Parameters
    ----------
    display : Display, str or Path
        A display, the name of a preset, or a display file.
    depth_mm : (H, W) array
        Depth of the first picture, in integers or floats.
    intrinsics : (fx, fy, cx, cy), optional
        Focal lengths and principal point, in pixels; the centre of the first pixel is at (0, 0).
        With them, each pixel is moved to its position in space, and the whole picture covers the
        lens array at the median depth of the first one. Without them, the picture covers the array
        at every depth.
    near_mm, far_mm : float, optional
        Ends of the depths to show; by default the 0.5 % and 99.5 % quantiles of the first picture.
    missing_depth : {"behind", "nearest", "far", "none"}
        Depth of pixels without one: that of the farther neighbour in their row, of the nearest
        pixel, or of the farthest pixel; or none: they stay holes.
    pixels_per_pitch : float
        Resolution of the fitted pictures, in pixels per lens pitch.

    Raises
    ------
    UsageError
        Depths that contradict the intrinsics or the range.
    FileError
        No pixel has a depth, or the distances are implausible, as in metres.
    """

    def __init__(
        self,
        display: Display | str | Path,
        depth_mm: ArrayLike,
        *,
        intrinsics: Sequence[float] | None = None,
        near_mm: float | None = None,
        far_mm: float | None = None,
        missing_depth: FillRule = "behind",
        pixels_per_pitch: float = 2,
    ) -> None:
        first = np.asarray(depth_mm)
        is_integer = np.issubdtype(first.dtype, np.integer)
        file = DepthFile(
            first.astype(np.float32), int(np.iinfo(first.dtype).max) if is_integer else None
        )
        is_confirmed = near_mm is not None and far_mm is not None
        values = interpret_depth(file, DepthConvention(1.0, has_range=is_confirmed), "depth_mm")
        self._display, self._missing_depth = display_of(display), missing_depth
        self._pixels_per_pitch, self._camera, self._frame_at = pixels_per_pitch, None, None
        if intrinsics is not None:
            self._camera = parse_intrinsics(",".join(map(str, intrinsics)), "intrinsics")
            check_pinhole(self._camera, (first.shape[0], first.shape[1]))
            self._frame_at = float(np.median(sample(values.depth)))
        self._values = values
        ends = depth_range(values, near_mm, far_mm)
        self._depth_map = map_depth("linear", values, ends, self._display)

    def picture(self, color: np.ndarray, depth_mm: ArrayLike) -> RGBD:
        """Fit a picture.

        Parameters
        ----------
        color : (H, W, 3) uint8
            sRGB, red first, of the same pixels as the depth.
        depth_mm : (H, W) array

        Returns
        -------
        RGBD
            8-bit sRGB with alpha; uncovered at holes.

        Raises
        ------
        UsageError
            Another size than the first picture, or no pixel with a depth on the display.
        """
        depth = np.asarray(depth_mm, np.float32)
        shape = self._values.depth.shape
        if color.dtype != np.uint8 or color.shape != (*shape, 3) or depth.shape != shape:
            raise UsageError(
                f"picture: color is {color.dtype} of shape {color.shape}, depth_mm of shape "
                f"{depth.shape}; the first depth picture has shape {shape}, and colours are uint8 "
                f"of shape {(*shape, 3)}"
            )
        depth = np.where((depth > 0) & (depth < np.inf), depth, np.float32(np.nan))
        return fit_picture(
            color,
            replace(self._values, depth=fill_missing_depth(depth, self._missing_depth)),
            self._depth_map,
            self._display,
            camera=self._camera,
            pixels_per_pitch=self._pixels_per_pitch,
            fit="cover",
            frame_at=self._frame_at,
            as_shown=True,
        ).rgbd
