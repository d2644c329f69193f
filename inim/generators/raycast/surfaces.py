"""Columns of a single picture that end: how far back the surface reaches that a pixel shows.

A picture says where its surface is, and not how thick the thing is. Two neighbours of a pixel are
one surface with it if their depths differ by less than `STEEPEST` times their distance. A column
reaches back to the lowest of the eight neighbours that are one surface with it, so that the surface
has no gaps, and by `THICKNESS_PX` picture pixels at least, so that its rim has a side.

The rest is the ray casting of `inim.generators.raycast.solids`: exact in the same sense, with this
back in place of none.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from inim.generators.base import Ray, SourceGenerator, Sources
from inim.rgbd import RGBD, LayeredRGBD

__all__ = ["STEEPEST", "THICKNESS_PX", "Surfaces", "surface_backs", "with_backs"]

#: Millimetres of depth to the millimetre up to which neighbours are one surface.
STEEPEST = 20.0
#: How far back a column reaches at least, in picture pixels.
THICKNESS_PX = 10.0


def surface_backs(depth_mm: np.ndarray, covered: np.ndarray, pixel_mm: float) -> np.ndarray:
    """Where each pixel's column ends.

    Parameters
    ----------
    depth_mm : (H, W) float32
        In the display frame, larger is nearer.
    covered : (H, W) bool
    pixel_mm : float

    Returns
    -------
    (H, W) float32
        0 where nothing is covered.
    """
    steps = np.float32(STEEPEST * pixel_mm), np.float32(STEEPEST * pixel_mm * math.sqrt(2))
    back = np.zeros(depth_mm.shape, np.float32)
    _lowest(depth_mm, covered, *steps, np.float32(THICKNESS_PX * pixel_mm), back)
    return back


def with_backs(rgbd: RGBD) -> LayeredRGBD:
    """A picture, of its front surface alone, as one layer of columns that end."""
    backs = surface_backs(rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm)
    return LayeredRGBD(rgbd.color, rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm, backs)


class Surfaces(SourceGenerator):
    """A generator of solids, given pictures whose columns end by the rule of this module.

    Parameters
    ----------
    solids : SourceGenerator
        Of `inim.generators.raycast.solids`.
    """

    def __init__(self, solids: SourceGenerator) -> None:
        super().__init__(solids.display, solids.shape, solids.pixel_mm, solids.pixels)
        self._solids = solids

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        return self._solids.find(with_backs(rgbd))

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        """See `Generator.generate`."""
        self.check(rgbd)
        return self._solids.generate(with_backs(rgbd), out)

    def rays(self) -> list[Ray]:
        """See `SourceGenerator.rays`."""
        return [ray._replace(generator=Surfaces(ray.generator)) for ray in self._solids.rays()]

    def shows_sources(self, rgbd: RGBD) -> bool:
        """See `SourceGenerator.shows_sources`."""
        return self._solids.shows_sources(rgbd)


@numba.njit(parallel=True, cache=True, nogil=True)
def _lowest(depth, covered, straight, diagonal, thickness, back):  # type: ignore[no-untyped-def]
    """The lowest neighbour that is one surface with each pixel, or the least thickness."""
    rows, columns = depth.shape
    for i in numba.prange(rows):
        for j in range(columns):
            if not covered[i, j]:
                continue
            here = depth[i, j]
            low = here - thickness
            for p in range(max(i - 1, 0), min(i + 2, rows)):
                for q in range(max(j - 1, 0), min(j + 2, columns)):
                    if covered[p, q]:
                        beside = depth[p, q]
                        most = diagonal if p != i and q != j else straight
                        if beside < low and here - beside <= most:
                            low = beside
            back[i, j] = low
