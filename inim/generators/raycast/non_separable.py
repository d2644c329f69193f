"""First hits of rays that share nothing: hexagonal lattices, arrays turned or tilted.

Every ray is walked by itself, by the same rule as in `raycast.traversal`. Its coordinates
are float64 from the pixel's position, no longer whole numbers: a ray that meets a corner of cells,
or the exact height of a column, may fall to either side by rounding.
"""

from __future__ import annotations

from collections.abc import Iterator

import numba
import numpy as np

from inim.display import Display
from inim.display.pixel_rays import pixel_rays, row_blocks
from inim.generators.base import PictureShape, PixelList, SourceGenerator
from inim.generators.raycast.cells import CENTRE, Aside, free_cell_rays
from inim.generators.raycast.traversal import first_hit
from inim.generators.sources import HOLE, Sources
from inim.rgbd import RGBD

__all__ = ["NonSeparable", "ray_blocks"]


class NonSeparable(SourceGenerator):
    """Every ray, or those of a list, by itself; in blocks of panel rows, so that memory is small.

    Parameters
    ----------
    display, shape, pixel_mm :
        See `inim.generators.prepare`.
    aside : (down, right)
        Where in its pixel each ray starts, in pixels from the centre.
    pixels : PixelList, optional
        As for `SourceGenerator`.
    """

    def __init__(
        self,
        display: Display,
        shape: PictureShape,
        pixel_mm: float,
        aside: Aside = CENTRE,
        pixels: PixelList | None = None,
    ) -> None:
        super().__init__(display, shape, pixel_mm, pixels)
        self._aside = float(aside[0]), float(aside[1])

    def find(self, rgbd: RGBD) -> Sources:
        """See `SourceGenerator.find`."""
        # An uncovered cell is a column without height: it never reaches a ray.
        depth = np.where(rgbd.covered, rgbd.depth_mm, np.float32(-np.inf))
        z_min, z_max = self.display.depth_range_mm
        # Above the nearest surface nothing is hit; just above it, a cell left exactly there counts.
        z_max = min(z_max, float(np.nextafter(np.float64(depth.max()), np.inf)))
        found = np.full(self.made_shape, HOLE, np.int32)
        if z_max <= z_min:
            return found
        for lensed, cells, at in ray_blocks(self, self._aside):
            _first_hits(lensed, depth, cells, z_min, z_max, found[at])
        return found


def ray_blocks(
    made: SourceGenerator, aside: tuple[float, float]
) -> Iterator[tuple[np.ndarray, tuple[np.ndarray, ...], tuple[slice, slice]]]:
    """Rays of all that a generator makes, a block of panel rows at a time.

    Yields
    ------
    lensed : (block rows, columns) bool
        Whether they pass a lens.
    cells : four (block rows, columns) float64
        See `free_cell_rays`.
    at : (rows, columns) slices
        Where in what is made they lie; of a list of pixels, a block is one row of those it has.
    """
    for rows in row_blocks(made.display):
        at = (rows, slice(None))
        if made.pixels is None:
            rays = pixel_rays(made.display, rows, aside)
            yield rays.lens >= 0, free_cell_rays(made.shape, made.pixel_mm, rays), at
            continue
        first, end = np.searchsorted(made.pixels.rows, (rows.start, rows.stop))
        if first == end:
            continue
        rays = pixel_rays(made.display, rows, aside)
        few = made.pixels.rows[first:end] - rows.start, made.pixels.columns[first:end]
        cells = free_cell_rays(made.shape, made.pixel_mm, rays)
        picked = tuple(coordinate[few][None] for coordinate in cells)
        yield np.ones((1, end - first), bool), picked, (slice(None), slice(first, end))


@numba.njit(parallel=True, cache=True, nogil=True)
def _first_hits(lensed, depth, rays, z_min, z_max, found):  # type: ignore[no-untyped-def]
    """`first_hit` of the pixels under lenses, into `found`; rays as of `free_cell_rays`."""
    u0, du, v0, dv = rays
    for i in numba.prange(found.shape[0]):
        for j in range(found.shape[1]):
            if lensed[i, j]:
                found[i, j] = first_hit(
                    depth, u0[i, j], du[i, j], 1.0, v0[i, j], dv[i, j], 1.0, z_min, z_max
                )
