"""The camera that took the photographs: a pinhole with radial distortion, OpenCV's model.

A camera's frame has x to the right, y down and z away from it. Pixel centres are at half-integers,
as in all of this project: OpenCV's principal point is half a pixel less.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

# Newton's method on a radius; distortions of photographs are small.
_NEWTON_STEPS = 4


class Camera(NamedTuple):
    """Intrinsics, in pixels; radial distortion ``1 + k1 r^2 + k2 r^4`` of the radius r = tan."""

    focal_px: float
    centre_x_px: float
    centre_y_px: float
    k1: float = 0.0
    k2: float = 0.0


class Pose(NamedTuple):
    """Where a camera stands: display frame to camera frame is ``turn @ (point - eye_mm)``.

    Attributes
    ----------
    turn : (3, 3) array
    eye_mm : (3,) array
    """

    turn: np.ndarray
    eye_mm: np.ndarray


def rotation(vector: Any) -> np.ndarray:
    """Rotation matrix of an axis times its angle, radians (Rodrigues)."""
    x, y, z = vector
    angle = float(np.sqrt(x * x + y * y + z * z))
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    half = np.sinc(angle / (2 * np.pi))
    turned: np.ndarray = np.eye(3) + np.sinc(angle / np.pi) * cross + half**2 / 2 * cross @ cross
    return turned


def directions(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Tangents x / z and y / z of the rays of pixels, (..., 2)."""
    distorted = (pixels - [camera.centre_x_px, camera.centre_y_px]) / camera.focal_px
    wanted = np.sqrt((distorted**2).sum(axis=-1))
    radius = wanted
    for _ in range(_NEWTON_STEPS):
        square = radius * radius
        value = radius * (1 + square * (camera.k1 + camera.k2 * square))
        slope = 1 + square * (3 * camera.k1 + 5 * camera.k2 * square)
        radius = radius - (value - wanted) / slope
    scale = np.divide(radius, wanted, out=np.ones_like(wanted), where=wanted > 0)
    tangents: np.ndarray = distorted * scale[..., None]
    return tangents


def project(camera: Camera, pose: Pose, points_mm: np.ndarray) -> np.ndarray:
    """Pixels of points of the display frame, (..., 3) to (..., 2)."""
    seen = (points_mm - pose.eye_mm) @ pose.turn.T
    tangents = seen[..., :2] / seen[..., 2:]
    square = (tangents**2).sum(axis=-1, keepdims=True)
    distorted = tangents * (1 + square * (camera.k1 + camera.k2 * square))
    pixels: np.ndarray = distorted * camera.focal_px + [camera.centre_x_px, camera.centre_y_px]
    return pixels


def rays(camera: Camera, pose: Pose, pixels: np.ndarray) -> np.ndarray:
    """Rays of pixels as the lens models take them: x, y at z = 0 and slopes, (4, ...).

    Slopes are sideways travel per millimetre away from the viewer.
    """
    tangents = directions(camera, pixels)
    along = tangents @ pose.turn[:2] + pose.turn[2]  # display frame
    slope_x, slope_y = along[..., 0] / -along[..., 2], along[..., 1] / -along[..., 2]
    x, y, z = pose.eye_mm
    return np.stack([x + z * slope_x, y + z * slope_y, slope_x, slope_y])
