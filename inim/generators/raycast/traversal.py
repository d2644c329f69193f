"""Walking a ray through a picture's cells, exactly.

The traversal is that of Amanatides and Woo (Eurographics 1987). The depth at which a ray crosses a
border is a quotient of whole numbers (see `raycast.cells`), rounded once and computed
afresh for each border: nothing drifts, and corners are corners.
"""

from __future__ import annotations

import numba
import numpy as np

from inim.generators.sources import HOLE

__all__ = ["entered", "first_hit", "leaves", "walk"]


@numba.njit(cache=True, nogil=True)
def leaves(cell, start, slope, scale):  # type: ignore[no-untyped-def]
    """Depth at which a ray leaves a cell in one axis; never, if it does not move in it."""
    if slope == 0.0:
        return -np.inf
    return ((cell if slope > 0 else cell + 1) * scale - start) / slope


@numba.njit(cache=True, nogil=True)
def entered(start, slope, scale, z_max):  # type: ignore[no-untyped-def]
    """The cell a ray is in just below z_max; on a border, the one it is about to enter."""
    cell = int(np.floor((start + slope * z_max) / scale))
    if slope == 0.0:
        return cell
    step = -1 if slope > 0 else 1
    # The product is rounded, the borders' depths decide: at most one cell either way.
    while leaves(cell, start, slope, scale) >= z_max:
        cell += step
    while leaves(cell - step, start, slope, scale) < z_max:
        cell -= step
    return cell


@numba.njit(cache=True, nogil=True)
def first_hit(depth, u0, du, u1, v0, dv, v1, z_min, z_max):  # type: ignore[no-untyped-def]
    """Walk one ray from z_max down to z_min: ``row * W + column`` of its first hit, or `HOLE`.

    `u` are columns and `v` rows, each as start, slope and scale of `CellRays`; `depth` is (H, W)
    with -inf where nothing is covered.
    """
    rows, columns = depth.shape
    # z falls along the walk, so a ray with du < 0 moves to larger columns.
    step_u = -1 if du > 0 else 1
    step_v = -1 if dv > 0 else 1
    u, v = entered(u0, du, u1, z_max), entered(v0, dv, v1, z_max)
    z_u, z_v = leaves(u, u0, du, u1), leaves(v, v0, dv, v1)
    while True:
        z_exit = max(z_u, z_v, z_min)
        inside = 0 <= u < columns and 0 <= v < rows
        if inside and depth[v, u] >= z_exit:
            return v * columns + u
        if z_exit <= z_min:
            return HOLE
        if z_u >= z_exit:
            u += step_u
            z_u = leaves(u, u0, du, u1)
        if z_v >= z_exit:
            v += step_v
            z_v = leaves(v, v0, dv, v1)


@numba.njit(cache=True, nogil=True)
def walk(u0, du, u1, v0, dv, v1, z_min, z_max, cells, exits):  # type: ignore[no-untyped-def]
    """The cells a ray visits from z_max down to z_min, and the depths at which it leaves them.

    Fills ``cells[:n] = (row, column)`` and ``exits[:n]``; returns n.
    """
    step_u = -1 if du > 0 else 1
    step_v = -1 if dv > 0 else 1
    u, v = entered(u0, du, u1, z_max), entered(v0, dv, v1, z_max)
    z_u, z_v = leaves(u, u0, du, u1), leaves(v, v0, dv, v1)
    n = 0
    while True:
        z_exit = max(z_u, z_v, z_min)
        cells[n, 0], cells[n, 1], exits[n] = v, u, z_exit
        n += 1
        if z_exit <= z_min:
            return n
        if z_u >= z_exit:
            u += step_u
            z_u = leaves(u, u0, du, u1)
        if z_v >= z_exit:
            v += step_v
            z_v = leaves(v, v0, dv, v1)
