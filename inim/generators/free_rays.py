"""First hits of rays that share nothing: hexagonal lattices, arrays turned or tilted.

Every ray is walked by itself, by the same rule as in `inim.generators.traversal`. Its coordinates
are float64 from the pixel's position, no longer whole numbers: a ray that meets a corner of cells,
or the exact height of a column, may fall to either side by rounding.
"""

from __future__ import annotations

import numba
import numpy as np

from inim.display import Display
from inim.generators.base import PictureShape, SourceGenerator
from inim.generators.cells import CENTRE, Aside, free_cell_rays
from inim.generators.sources import HOLE, NOT_ASKED, Sources
from inim.generators.traversal import first_hit
from inim.pixel_rays import pixel_rays, row_blocks
from inim.rgbd import RGBD

__all__ = ["FreeRays"]


class FreeRays(SourceGenerator):
    """Every ray, or those asked for, by itself; in blocks of panel rows, so that memory is small.

    Parameters
    ----------
    display, shape, pixel_mm :
        See `inim.generators.prepare`.
    aside : (down, right)
        Where in its pixel each ray starts, in pixels from the centre.
    mask : (rows, columns) bool, optional
        Panel pixels asked for.
    """

    def __init__(
        self,
        display: Display,
        shape: PictureShape,
        pixel_mm: float,
        aside: Aside = CENTRE,
        mask: np.ndarray | None = None,
    ) -> None:
        super().__init__(display, shape, pixel_mm)
        self._aside = float(aside[0]), float(aside[1])
        self._mask = np.ones(display.eia_shape, bool) if mask is None else np.asarray(mask, bool)

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        # An uncovered cell is a column without height: it never reaches a ray.
        depth = np.where(rgbd.covered, rgbd.depth_mm, np.float32(-np.inf))
        z_min, z_max = self.display.depth_range_mm
        # Above the nearest surface nothing is hit; just above it, a cell left exactly there counts.
        z_max = min(z_max, float(np.nextafter(np.float64(depth.max()), np.inf)))
        found = np.where(self._mask, np.int32(HOLE), np.int32(NOT_ASKED))
        if z_max <= z_min:
            return found
        for rows in row_blocks(self.display):
            rays = pixel_rays(self.display, rows, self._aside)
            asked = self._mask[rows] & (rays.lens >= 0)
            cells = free_cell_rays(self.shape, self.pixel_mm, rays)
            _first_hits(asked, depth, cells, z_min, z_max, found[rows])
        return found


@numba.njit(parallel=True, cache=True, nogil=True)
def _first_hits(asked, depth, rays, z_min, z_max, found):  # type: ignore[no-untyped-def]
    """`first_hit` of the pixels asked for, into `found`; rays as of `free_cell_rays`."""
    u0, du, v0, dv = rays
    for i in numba.prange(found.shape[0]):
        for j in range(found.shape[1]):
            if asked[i, j]:
                found[i, j] = first_hit(
                    depth, u0[i, j], du[i, j], 1.0, v0[i, j], dv[i, j], 1.0, z_min, z_max
                )
