"""Light of the sides of solids (`inim.image.sides`), which a parallel camera sees edge-on.

A piece's colour is the mean over the display rays that reach it: through any point of
the walls between its pixel and the four neighbours, at any slope of the display's pixels,
and unobstructed from the viewer to the centre of the neighbouring pixel, which the
camera saw to be empty. From there a ray meets the side, up to half a pixel in front of
the wall or behind it.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from inim.image.sides import BESIDE, Sides
from inim.render.rays import SeparableRays
from inim.render.scene import FittedScene
from inim.render.trace import Light, first_not_light

# Rays that enter a wall are the more, the more aslant they are; those that graze it start far off.
_LEAST_SHARE = 1e-3


def side_light(fitted: FittedScene, rays: SeparableRays, sides: Sides, seen_only: bool) -> Light:
    """Function that returns the light of samples on the walls of sides, one pixel per wall.

    * `rays`: rays of the depth camera.
    * `seen_only`: return 1 for a sample that reaches its wall unobstructed, instead of its light.
      The others are 0 in both cases. Equal seeds draw equal samples.
    """
    camera = fitted.camera(rays)
    piece, beside = sides.walls.T
    down, right = BESIDE[beside].T
    row, column = sides.row[piece], sides.column[piece]
    pixel_mm = abs(rays.x.place_step_mm)
    slope_x, slope_y = (dr.opaque(mi.Float, slope) for slope in sides.slopes)
    start, half = dr.opaque(mi.Float, rays.start_mm), dr.opaque(mi.Float, pixel_mm / 2)

    def table(values: np.ndarray) -> Any:
        return mi.Float(np.asarray(values, np.float32))

    tables = [
        table(values)
        for values in (
            rays.x.place_mm[column], rays.y.place_mm[row], right, -down,
            sides.low_mm[piece, beside], sides.high_mm[piece, beside],
        )
    ]  # fmt: skip

    def light(index: Any, sampler: Any) -> Any:
        within = sampler.next_2d()
        x, y, across, up, low, high = (dr.gather(mi.Float, t, index) for t in tables)
        along, level = sampler.next_2d()
        # A wall is as wide as a ray's slope towards it lets it appear.
        towards = dr.sqrt(dr.maximum(within.x, _LEAST_SHARE))
        offset = 2 * within.y - 1
        is_left_or_right = across != 0
        run_x = dr.select(is_left_or_right, -across * towards, offset) * slope_x
        run_y = dr.select(is_left_or_right, offset, -up * towards) * slope_y
        # From a point of the wall back to the middle of the pixel beside, and to the viewer.
        place = (2 * along - 1) * half
        x += dr.select(is_left_or_right, across * half, place)
        y += dr.select(is_left_or_right, place, up * half)
        z = dr.lerp(low, high, level)
        before = half / dr.select(is_left_or_right, dr.abs(run_x), dr.abs(run_y))
        depth = start - z
        ray, length = camera.world_rays([x - run_x * depth, y - run_y * depth], [run_x, run_y])
        hit = first_not_light(fitted.scene, ray)
        is_unobstructed = ~hit.is_valid() | (hit.t >= (depth - before) * length)
        if seen_only:
            return mi.Color3f(dr.select(is_unobstructed, mi.Float(1), mi.Float(0)))
        radiance_sample = fitted.integrator.sample(
            fitted.scene, sampler, mi.RayDifferential3f(ray), active=is_unobstructed
        )[0]
        return dr.select(is_unobstructed, radiance_sample, 0)

    return light
