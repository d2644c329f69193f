"""Rounding errors of the quantities that decide a generator's sources, in ulps.

Sources are integers, which are right or wrong. Rounding affects the quantities that decide them:
for `template` the depth at which a ray leaves a cell, for `gu2020` and `wang2024` the position of a
ray in the picture, for `li2012` the landing point on the panel. The generators' own functions
compute each quantity in a type, and it is compared with the exact fraction.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from fractions import Fraction

import numpy as np

from inim.display import Display
from inim.display.pixels import exact_length
from inim.generators.li2012 import _position, forward_axes
from inim.generators.oracle import AxisRays, axis_rays
from inim.generators.raycast.cells import (
    CellRays,
    PictureRays,
    cell_rays,
    rounded_up,
)
from inim.generators.raycast.ray_by_ray import leaves
from inim.image.rgbd import RGBD
from reports.stress.study.rays import chosen_pixels, rays_over

# Tested rays of each axis, and points along each ray.
_RAYS, _POINTS = 12, 8
_Pairs = Iterator[tuple[float, Fraction]]


def deciding_ulps(algorithm: str, dtype: type, display: Display, rgbd: RGBD) -> tuple[float, float]:
    """Worst and mean error of the deciding quantity in ulps; (0, 0) if no quantity decides."""
    kind = algorithm.partition(":")[0]
    if not display.is_separable:
        pairs = _nonseparable_coordinates(display, rgbd, dtype)
    elif kind == "li2012":
        pairs = _landing(display, rgbd, dtype)
    elif kind in ("template", "layered"):
        pairs = _exits(display, rgbd, rounded=dtype is np.float32)
    else:
        pairs = _coordinates(display, rgbd, dtype)
    errors = [_ulps(computed, exact, dtype) for computed, exact in pairs]
    return (max(errors), sum(errors) / len(errors)) if errors else (0.0, 0.0)


def _ulps(computed: float, exact: Fraction, dtype: type) -> float:
    spacing = Fraction(float(np.spacing(dtype(abs(float(exact))))))
    return float(abs(Fraction(float(computed)) - exact) / spacing)


def _axes(display: Display, rgbd: RGBD) -> Iterator[tuple[CellRays, AxisRays, np.ndarray]]:
    """Float rays, exact rays and tested indices of the columns and of the rows."""
    exact_rows, exact_columns = axis_rays(display, rgbd)
    columns, rows = cell_rays(rgbd.shape, rgbd.pixel_mm, display)
    for rays, line in ((columns, exact_columns), (rows, exact_rows)):
        count = len(line.start)
        yield rays, line, np.unique(np.linspace(0, count - 1, min(count, _RAYS)).astype(int))


def _exits(display: Display, rgbd: RGBD, rounded: bool) -> _Pairs:
    """Depths at which rays leave cells; `rounded`: rounded up to float32, as in the tables."""
    low, high = map(Fraction, display.depth_range_mm)
    for rays, line, chosen in _axes(display, rgbd):
        for i in chosen:
            start, slope = line.start[i], line.slope[i]
            if slope == 0:
                continue
            first, last = sorted((start + slope * low, start + slope * high))
            borders = range(math.floor(first) + 1, math.ceil(last))
            step = max(1, len(borders) // _POINTS)
            for border in borders[::step]:
                cell = border if slope > 0 else border - 1
                ray = (float(rays.start[i]), float(rays.slope[i]), float(rays.scale))
                z = leaves(cell, *ray)
                depth = float(rounded_up(np.array([z]))[0]) if rounded else z
                yield depth, (border - start) / slope


def _coordinates(display: Display, rgbd: RGBD, dtype: type) -> _Pairs:
    """Picture cells at depths along rays."""
    depths: np.ndarray = np.linspace(*display.depth_range_mm, _POINTS).astype(dtype)
    for rays, line, chosen in _axes(display, rgbd):
        start: np.ndarray = (rays.start / rays.scale).astype(dtype)
        slope: np.ndarray = (rays.slope / rays.scale).astype(dtype)
        for i in chosen:
            for z in depths[np.isfinite(depths)]:
                yield start[i] + slope[i] * z, line.start[i] + line.slope[i] * Fraction(float(z))


def _nonseparable_coordinates(display: Display, rgbd: RGBD, dtype: type) -> _Pairs:
    """Picture cells at depths along rays of a non-separable display, against long doubles."""
    depths: np.ndarray = np.linspace(*display.depth_range_mm, _POINTS).astype(dtype)
    pixels = chosen_pixels(display, _RAYS * 4)
    rays = rays_over(display, rgbd, pixels)
    r, c = pixels.T
    whole_panel = slice(0, display.eia_shape[0])
    cells = PictureRays(display, rgbd.shape, rgbd.pixel_mm).block(whole_panel)[:4]
    with np.errstate(over="ignore"):
        u0, du, v0, dv = (values[r, c].astype(dtype) for values in cells)
    for i in np.flatnonzero(~rays.doubtful)[: _RAYS * 2]:
        exact_v0, exact_dv, exact_u0, exact_du = rays.line(int(i))
        for z in depths[np.isfinite(depths)]:
            for start, slope, exact_start, exact_slope in (
                (u0[i], du[i], exact_u0, exact_du),
                (v0[i], dv[i], exact_v0, exact_dv),
            ):
                with np.errstate(over="ignore", invalid="ignore"):
                    coordinate = start + slope * z
                if np.isfinite(coordinate):
                    yield coordinate, exact_start + exact_slope * Fraction(float(z))


def _landing(display: Display, rgbd: RGBD, dtype: type) -> _Pairs:
    """Panel positions of picture pixels."""
    rows, columns = np.nonzero(rgbd.covered & (rgbd.depth_mm != 0))
    if not len(rows):
        return
    depth = rgbd.depth_mm[rows, columns].astype(float)
    ends = (float(depth.min()), float(depth.max()))
    axis = forward_axes(display, rgbd.shape, rgbd.pixel_mm, ends)[0]
    typed = axis._replace(
        unit=dtype(axis.unit),
        **{name: getattr(axis, name).astype(dtype) for name in ("lens_z", "lens_g", "pixel_g")},
    )
    pixel, gap = exact_length(display.pixel_pitch_mm), exact_length(display.gap_mm)
    lenses = range(0, display.lens_columns, max(1, display.lens_columns // 3))
    for n in lenses:
        x0 = Fraction(2 * n + 1 - display.lens_columns, 2) * exact_length(display.pitch_mm)
        for k in np.linspace(0, len(rows) - 1, _RAYS * 2).astype(int):
            cell, z = int(columns[k]), Fraction(float(depth[k]))
            x = Fraction(2 * cell + 1 - rgbd.shape[1], 2) * exact_length(rgbd.pixel_mm)
            with np.errstate(over="ignore", invalid="ignore"):
                position = _position(typed, n, cell, dtype(depth[k]))
            if np.isfinite(position):
                yield float(position), (x0 + (x0 - x) * gap / z) / pixel
