"""RGB-D pictures: what a depth camera in front of the display would hand to a generator."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inim.errors import UsageError

__all__ = ["RGBD"]


@dataclass(frozen=True)
class RGBD:
    """An orthographic colour and depth picture in the display frame, centred on its axis.

    Row 0 is the top. Pixel (r, c) covers x in ``[(c - W/2) p, (c + 1 - W/2) p]`` and y in
    ``[(H/2 - r - 1) p, (H/2 - r) p]``, p being `pixel_mm`.

    Parameters
    ----------
    color : (H, W, 3) float32, or (H, W, 4) uint8
        Linear RGB, for verification; or sRGB with alpha, as a player sends it to the panel.
    depth_mm : (H, W) float32
        z of the front surface in the display frame, towards the viewer; ignored where not covered.
    covered : (H, W) bool
        Whether there is a surface. Background is this flag, never a depth value.
    pixel_mm : float
        Side of a pixel.

    Raises
    ------
    UsageError
        Shapes that differ, an empty picture, or a covered pixel whose depth is not finite.
    """

    color: NDArray[np.float32] | NDArray[np.uint8]
    depth_mm: NDArray[np.float32]
    covered: NDArray[np.bool_]
    pixel_mm: float

    def __post_init__(self) -> None:
        # Copies: a caller's later changes must not slip past these checks.
        as_shown = np.asarray(self.color).dtype == np.uint8
        color = np.array(self.color, np.uint8 if as_shown else np.float32)
        channels = 4 if as_shown else 3
        depth = np.array(self.depth_mm, np.float32)
        covered = np.array(self.covered, bool)
        if color.ndim != 3 or color.shape[2] != channels or color.size == 0:
            raise UsageError(
                f"RGBD: color is {color.dtype} of shape {color.shape}; it must be (H, W, 3) float "
                "or (H, W, 4) uint8"
            )
        if depth.shape != color.shape[:2] or covered.shape != color.shape[:2]:
            raise UsageError(
                f"RGBD: color is {color.shape[:2]}, depth_mm {depth.shape}, covered "
                f"{covered.shape}; all three must have the same rows and columns"
            )
        pixel: Any = self.pixel_mm
        if not (isinstance(pixel, Real) and 0 < float(pixel) < math.inf):
            raise UsageError(f"RGBD: pixel_mm = {self.pixel_mm!r}; it must be a positive length")
        if not np.isfinite(depth[covered]).all():
            bad = int(np.count_nonzero(~np.isfinite(depth[covered])))
            raise UsageError(
                f"RGBD: {bad} covered pixels have no finite depth; clear `covered` there"
            )
        for name, value in (("color", color), ("depth_mm", depth), ("covered", covered)):
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        object.__setattr__(self, "pixel_mm", float(self.pixel_mm))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.depth_mm.shape[0], self.depth_mm.shape[1]

    @property
    def palette(self) -> np.ndarray:
        """The colours that source numbers point into, row by row."""
        return self.color

    @property
    def width_mm(self) -> float:
        """Width of the picture."""
        return self.shape[1] * self.pixel_mm

    @property
    def height_mm(self) -> float:
        """Height of the picture."""
        return self.shape[0] * self.pixel_mm
