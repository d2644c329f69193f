"""Pickup rays of an array that lies freely: hexagonal, turned or tilted."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from inim.display import Display
from inim.display.pixel_rays import PixelRays, pixel_rays, row_blocks

__all__ = ["FreeBundles", "free_bundles"]


@dataclass(frozen=True)
class FreeBundles:
    """Rays of a panel whose array lies freely: a lens, a place and a gap for every pixel.

    The pickup of displays that are not separable. A ray joins a point of its pixel and the centre
    of the pixel's lens; display frame, millimetres. Tables are (rows, columns) float32: differences
    are taken in float64 before, so nothing cancels.

    Attributes
    ----------
    plugin : str
    start_mm : float
        Plane that the rays start from.
    x0_mm, y0_mm :
        The lens's centre.
    aside_x_mm, aside_y_mm :
        From the middle of the pixel's bundle to there.
    gap_mm :
        Under the middle of the bundle.
    step_x_mm, step_y_mm : float
        Across the bundle's base on the panel, in film order.
    tilt_x, tilt_y : float
        Growth of the gap per millimetre.
    """

    plugin: str
    start_mm: float
    x0_mm: np.ndarray
    y0_mm: np.ndarray
    aside_x_mm: np.ndarray
    aside_y_mm: np.ndarray
    gap_mm: np.ndarray
    step_x_mm: float
    step_y_mm: float
    tilt_x: float
    tilt_y: float

    @property
    def has_pupil(self) -> bool:
        """Whether a pixel's rays come from all over a disc: they never do."""
        return False

    @property
    def columns(self) -> int:
        """Film width."""
        return int(self.x0_mm.shape[1])

    @property
    def rows(self) -> int:
        """Film height."""
        return int(self.x0_mm.shape[0])


def free_bundles(
    display: Display, start_mm: float, right: float, width: float, height: float
) -> FreeBundles:
    """The bundles of a display, from what shines of its pixels.

    Parameters
    ----------
    display : Display
    start_mm : float
        Plane that the rays start from.
    right, width, height : float
        Of what shines: its centre, to the right of the pixel's, and its size, in pixels.
    """
    pixel = display.pixel_pitch_mm
    blocks = [pixel_rays(display, rows, (0.0, right)) for rows in row_blocks(display)]

    def table(of: Callable[[PixelRays], np.ndarray]) -> np.ndarray:
        return np.concatenate([of(rays).astype(np.float32) for rays in blocks])

    return FreeBundles(
        "inim_pickup",
        start_mm,
        table(lambda rays: rays.x0),
        table(lambda rays: rays.y0),
        table(lambda rays: rays.slope_x * rays.gap_mm),
        table(lambda rays: rays.slope_y * rays.gap_mm),
        table(lambda rays: rays.gap_mm),
        width * pixel,
        -height * pixel,
        math.tan(math.radians(display.tilt_x_deg)),
        math.tan(math.radians(display.tilt_y_deg)),
    )
