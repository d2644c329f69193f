"""How large a point of the picture is, depth by depth."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from inim.display import Display

__all__ = ["VoxelCurve", "aperture_blur_mm", "pixel_footprint_mm", "voxel_curve", "voxel_mm"]

_POINTS = 241


@dataclass(frozen=True)
class VoxelCurve:
    """Voxel size against depth; (n,) float64 each, millimetres.

    Attributes
    ----------
    depth_mm : ndarray
        Along z, wider than the depth range by half of it on either side.
    footprint_mm, blur_mm, width_mm : ndarray
        A pixel's footprint, the aperture's blur, and both together.
    """

    depth_mm: np.ndarray
    footprint_mm: np.ndarray
    blur_mm: np.ndarray
    width_mm: np.ndarray


def pixel_footprint_mm(display: Display, depth_mm: np.ndarray | float) -> np.ndarray:
    """A panel pixel projected through the lens centre onto depth z: |z| P_D / g (from Eq. 1)."""
    depth = np.asarray(depth_mm, float)
    return np.asarray(np.abs(depth) * display.pixel_pitch_mm / display.gap_mm)


def aperture_blur_mm(display: Display, depth_mm: np.ndarray | float) -> np.ndarray:
    """Width at depth z of the beam that a panel point sends through a lens: A |z - D| / |D|.

    A is the aperture's width, the pitch where lenses fill their cells. The beam is as wide as the
    lens at z = 0 and comes to a point at D (similar triangles); a focused display's stays A.
    """
    aperture = display.fill_factor * display.pitch_mm
    depth = np.asarray(depth_mm, float)
    if math.isinf(display.central_depth_mm):
        return np.full_like(depth, aperture)
    centre = display.central_depth_mm
    return np.asarray(aperture * np.abs(depth - centre) / abs(centre))


def voxel_mm(display: Display, depth_mm: np.ndarray | float) -> np.ndarray:
    """Width of one pixel's whole beam at depth z: footprint plus blur.

    Each point of the pixel sends a beam as wide as the blur, and their axes spread over the
    footprint; so the edges lie exactly their sum apart. At D it is P_I = |D| P_D / g (Eq. 3).
    """
    return np.asarray(pixel_footprint_mm(display, depth_mm) + aperture_blur_mm(display, depth_mm))


def voxel_curve(display: Display) -> VoxelCurve:
    """Voxel size over twice the depth range, its middle in the middle."""
    low, high = display.depth_range_mm
    margin = (high - low) / 2
    depth = np.linspace(low - margin, high + margin, _POINTS)
    return VoxelCurve(
        depth,
        pixel_footprint_mm(display, depth),
        aperture_blur_mm(display, depth),
        voxel_mm(display, depth),
    )
