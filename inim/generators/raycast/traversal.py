"""Walking a ray through a picture's cells, exactly.

The traversal is that of Amanatides and Woo (Eurographics 1987). The depth at which a ray crosses a
border is a quotient of whole numbers (see `raycast.cells`), rounded once and computed
afresh for each border: nothing drifts, and corners are corners.
"""

from __future__ import annotations

import numba
import numpy as np

from inim.generators.sources import HOLE

__all__ = ["first_hit", "first_hits", "first_hits_at", "starts", "walk"]


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


@numba.njit(parallel=True, cache=True, nogil=True)
def first_hits(depth, rays, lens_u, lens_v, start, z_min, found):  # type: ignore[no-untyped-def]
    """`first_hit` of every panel pixel, into `found` (rows, columns) int32.

    `rays` are ``(u0, du, u1, v0, dv, v1)``, one u per panel column and one v per row; `lens_u` and
    `lens_v` name the lens over them, and `start` (lens rows, lens columns) the depth from which its
    rays need following: see `starts`.
    """
    u0, du, u1, v0, dv, v1 = rays
    for row in numba.prange(found.shape[0]):
        for column in range(found.shape[1]):
            z_max = start[lens_v[row], lens_u[column]]
            if z_max > z_min:
                found[row, column] = first_hit(
                    depth, u0[column], du[column], u1, v0[row], dv[row], v1, z_min, z_max
                )
            else:
                found[row, column] = HOLE


@numba.njit(parallel=True, cache=True, nogil=True)
def first_hits_at(rows, columns, depth, rays, z_min, z_max, found):  # type: ignore[no-untyped-def]
    """`first_hit` of the panel pixels in some rows and columns, (n,) each, into `found` (n,)."""
    u0, du, u1, v0, dv, v1 = rays
    for i in numba.prange(len(rows)):
        row, column = rows[i], columns[i]
        found[i] = first_hit(depth, u0[column], du[column], u1, v0[row], dv[row], v1, z_min, z_max)


@numba.njit(parallel=True, cache=True, nogil=True)
def starts(depth, left, right, top, bottom, z_max):  # type: ignore[no-untyped-def]
    """Depth from which the rays of each lens need following, (lens rows, lens columns) float64.

    A cell can be hit only if its ray leaves it no nearer than the nearest surface within the
    lens's reach, cells ``[left, right) x [top, bottom)``; where nothing is covered there, -inf.
    """
    rows, columns = depth.shape
    highest = np.empty((rows, len(left)), np.float32)
    for row in numba.prange(rows):
        for n in range(len(left)):
            most = np.float32(-np.inf)
            for column in range(max(left[n], 0), min(right[n], columns)):
                most = max(most, depth[row, column])
            highest[row, n] = most
    start = np.empty((len(top), len(left)))
    for m in numba.prange(len(top)):
        for n in range(len(left)):
            most = np.float32(-np.inf)
            for row in range(max(top[m], 0), min(bottom[m], rows)):
                most = max(most, highest[row, n])
            # Just above it: a cell left at exactly that depth still counts.
            start[m, n] = min(z_max, np.nextafter(np.float64(most), np.inf))
    return start


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
