"""`template`: the exact first hit of every panel pixel's ray in the picture's columns.

Definition. A depth image is a set of columns, one per covered pixel, solid from far up to its
depth. A panel pixel's ray X(z) = x0 + (x0 - x) z / g (the paper's Eq. 1) is followed from z_max
towards z_min, cell by cell; the first covered cell whose depth is at least the ray's z where it
leaves that cell (or z_min, where the ray ends) gives the source. No such cell: a hole.

A ray that runs exactly along a border between cells belongs to the cell of the larger row or
column; one that crosses exactly at a corner passes to the diagonal neighbour.

The traversal is that of Amanatides and Woo (Eurographics 1987). The depth at which a ray crosses a
border is a quotient of whole numbers (see `inim.generators.cells`), rounded once and computed
afresh for each border: nothing drifts, and corners are corners.
"""

from __future__ import annotations

import numba
import numpy as np

from inim.display import Display
from inim.generators.base import PictureShape, SourceGenerator
from inim.generators.cells import cell_rays
from inim.generators.sources import HOLE, Sources
from inim.rgbd import RGBD

__all__ = ["prepare"]


def prepare(display: Display, shape: PictureShape, pixel_mm: float) -> SourceGenerator:
    """A generator of exact first hits; see the module's text."""
    return _Template(display, shape, pixel_mm)


class _Template(SourceGenerator):
    def find(self, rgbd: RGBD) -> Sources:
        column_rays, row_rays = cell_rays(self.shape, self.pixel_mm, self.display)
        z_min, z_max = self.display.depth_range_mm
        # An uncovered cell is a column without height: it never reaches a ray.
        depth = np.where(rgbd.covered, rgbd.depth_mm, np.float32(-np.inf))
        found = np.empty(self.display.eia_shape, np.int32)
        _traverse_all(
            depth,
            column_rays.start,
            column_rays.slope,
            column_rays.scale,
            row_rays.start,
            row_rays.slope,
            row_rays.scale,
            z_min,
            z_max,
            found,
        )
        return found


@numba.njit(parallel=True, cache=True, nogil=True)
def _traverse_all(depth, u0, du, u1, v0, dv, v1, z_min, z_max, found):  # type: ignore[no-untyped-def]
    """Follow the ray of every panel pixel; u and v are columns and rows, see `CellRays`."""
    for row in numba.prange(found.shape[0]):
        for column in range(found.shape[1]):
            found[row, column] = _first_hit(
                depth, u0[column], du[column], u1, v0[row], dv[row], v1, z_min, z_max
            )


@numba.njit(cache=True, nogil=True)
def _first_hit(depth, u0, du, u1, v0, dv, v1, z_min, z_max):  # type: ignore[no-untyped-def]
    """Walk one ray from z_max down to z_min."""
    rows, columns = depth.shape
    # z falls along the walk, so a ray with du < 0 moves to larger columns.
    step_u = -1 if du > 0 else 1
    step_v = -1 if dv > 0 else 1
    u, v = _entered(u0, du, u1, z_max), _entered(v0, dv, v1, z_max)
    z_u, z_v = _leaves(u, u0, du, u1), _leaves(v, v0, dv, v1)
    while True:
        z_exit = max(z_u, z_v, z_min)
        inside = 0 <= u < columns and 0 <= v < rows
        if inside and depth[v, u] >= z_exit:
            return v * columns + u
        if z_exit <= z_min:
            return HOLE
        if z_u >= z_exit:
            u += step_u
            z_u = _leaves(u, u0, du, u1)
        if z_v >= z_exit:
            v += step_v
            z_v = _leaves(v, v0, dv, v1)


@numba.njit(cache=True, nogil=True)
def _entered(start, slope, scale, z_max):  # type: ignore[no-untyped-def]
    """The cell a ray is in just below z_max; on a border, the one it is about to enter."""
    cell = int(np.floor((start + slope * z_max) / scale))
    if slope == 0.0:
        return cell
    step = -1 if slope > 0 else 1
    # The product is rounded, the borders' depths decide: at most one cell either way.
    while _leaves(cell, start, slope, scale) >= z_max:
        cell += step
    while _leaves(cell - step, start, slope, scale) < z_max:
        cell -= step
    return cell


@numba.njit(cache=True, nogil=True)
def _leaves(cell, start, slope, scale):  # type: ignore[no-untyped-def]
    """Depth at which a ray leaves a cell in one axis; never, if it does not move in it."""
    if slope == 0.0:
        return -np.inf
    return ((cell if slope > 0 else cell + 1) * scale - start) / slope
