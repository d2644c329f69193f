"""A camera as a pinhole: its intrinsics, in pixels of the colour picture."""

from __future__ import annotations

import math
from dataclasses import dataclass

from inim.errors import UsageError

__all__ = ["Pinhole", "check_pinhole", "parse_intrinsics"]

# Wider than a fisheye's middle, narrower than a telescope's: a slip, or another picture's numbers.
_WIDEST_DEG = 160.0
_NARROWEST_DEG = 1.0


@dataclass(frozen=True)
class Pinhole:
    """Focal lengths and principal point, pixels.

    The centre of pixel (row i, column j) is at (j, i), as OpenCV and Open3D count: a camera of
    640 x 480 pixels that looks straight ahead has its principal point at (319.5, 239.5).
    """

    fx: float
    fy: float
    cx: float
    cy: float


def parse_intrinsics(text: str) -> Pinhole:
    """``fx,fy,cx,cy`` in pixels.

    Raises
    ------
    UsageError
        Not four finite numbers, or a focal length that is not positive.
    """
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 4 or not all(map(math.isfinite, numbers)) or min(numbers[:2]) <= 0:
        raise UsageError(
            f"--intrinsics {text}: write fx,fy,cx,cy in pixels of the colour picture, such as "
            "525,525,319.5,239.5"
        )
    return Pinhole(*numbers)


def check_pinhole(camera: Pinhole, shape: tuple[int, int]) -> None:
    """Raise `UsageError` for intrinsics that cannot be those of a picture of this shape."""
    rows, columns = shape
    if not (-0.5 <= camera.cx <= columns - 0.5 and -0.5 <= camera.cy <= rows - 0.5):
        raise UsageError(
            f"--intrinsics: principal point ({camera.cx:g}, {camera.cy:g}) lies outside the colour "
            f"picture of {columns} x {rows} pixels; scale fx,fy,cx,cy to that size"
        )
    for name, focal, pixels in (("fx", camera.fx, columns), ("fy", camera.fy, rows)):
        angle = math.degrees(2 * math.atan(pixels / (2 * focal)))
        if not _NARROWEST_DEG <= angle <= _WIDEST_DEG:
            raise UsageError(
                f"--intrinsics: {name} = {focal:g} pixels over {pixels} pixels sees {angle:.3g} "
                "degrees; give fx,fy,cx,cy in pixels of the colour picture, not in millimetres"
            )
