"""Film camera: the rays of `inim.render.rays` in a world, as run-time values of a kernel.

The rays come as float64 tables, so the float32 rays carry one rounding and no cancellation. Because
the tables are run-time values, all cameras with separable rays share one kernel, and the path
tracer is compiled once for all.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from inim.render.rays import NonSeparableRays, SeparableRays


def _value(number: float) -> Any:
    return dr.opaque(mi.Float, float(number))


def _table(numbers: np.ndarray) -> Any:
    return mi.Float(np.asarray(numbers, np.float32).reshape(-1))


class FilmCamera:
    """Camera with the rays of a ray family.

    * `world_from_display`, (4, 4) float64: any invertible affine map. It keeps lines and their
      order, so a picture squeezed into the display's depth range is exact geometry, lit in its own
      world.
    """

    def __init__(
        self, rays: SeparableRays | NonSeparableRays, world_from_display: np.ndarray
    ) -> None:
        self.shape = rays.shape
        self.has_pupil = rays.has_pupil
        self._width = dr.opaque(mi.UInt32, rays.shape[1])
        self._start = _value(rays.start_mm)
        self._is_separable = isinstance(rays, SeparableRays)
        if isinstance(rays, NonSeparableRays):
            self._centres = [_table(rays.x0_mm), _table(rays.y0_mm)]
            self._offsets = [_table(rays.offset_x_mm), _table(rays.offset_y_mm)]
            self._gaps = _table(rays.gap_mm)
            self._steps = [_value(rays.step_x_mm), _value(rays.step_y_mm)]
            self._tilts = [_value(rays.tilt_x), _value(rays.tilt_y)]
        else:
            axes = (rays.x, rays.y)
            self._places = [_table(axis.place_mm) for axis in axes]
            self._slopes = [_table(axis.slope) for axis in axes]
            self._place_steps = [_value(axis.place_step_mm) for axis in axes]
            self._slope_steps = [_value(axis.slope_step) for axis in axes]
            self._pupil_place = _value(rays.pupil_place_mm)
            self._pupil_slope = _value(rays.pupil_slope)
        self.place(world_from_display)

    def place(self, world_from_display: np.ndarray) -> None:
        """Move the camera: change the map from the display frame to the world."""
        rows = np.asarray(world_from_display, np.float64)[:3]
        self._linear = [[_value(number) for number in row[:3]] for row in rows]
        self._shift = [_value(row[3]) for row in rows]

    def pixel(self, index: Any) -> Any:
        """Column and row of film pixels, Point2u, from their flat indices."""
        return mi.Point2u(index % self._width, index // self._width)

    def lines(
        self, pixel: Any, within: Any, pupil: Any = None, active: Any = True
    ) -> tuple[list[Any], list[Any]]:
        """Rays through film pixels as [x, y] on the start plane and [x, y] slopes.

        * `pixel`, (n,) Point2u: column and row.
        * `within`, (n,) Point2f: position inside the pixel, 0..1, rightwards and downwards.
        * `pupil`, (n,) Point2f: point of the pupil, in the unit disc; its middle if None.
        """
        if not self._is_separable:
            return self._non_separable_lines(pixel, within, active)
        start, run = [], []
        for axis in (0, 1):
            offset = within[axis] - 0.5
            place = dr.gather(mi.Float, self._places[axis], pixel[axis], active)
            slope = dr.gather(mi.Float, self._slopes[axis], pixel[axis], active)
            place = dr.fma(offset, self._place_steps[axis], place)
            slope = dr.fma(offset, self._slope_steps[axis], slope)
            if pupil is not None:
                place = dr.fma(pupil[axis], self._pupil_place, place)
                slope = dr.fma(pupil[axis], self._pupil_slope, slope)
            start.append(place)
            run.append(slope)
        return start, run

    def _non_separable_lines(
        self, pixel: Any, within: Any, active: Any
    ) -> tuple[list[Any], list[Any]]:
        """Rays as `lines`, with an individual lens, position and gap for each pixel."""
        index = dr.fma(pixel.y, self._width, pixel.x)
        moved = [(within[axis] - 0.5) * self._steps[axis] for axis in (0, 1)]
        gap = dr.gather(mi.Float, self._gaps, index, active)
        gap = dr.fma(moved[0], self._tilts[0], dr.fma(moved[1], self._tilts[1], gap))
        start, run = [], []
        for axis in (0, 1):
            offset = dr.gather(mi.Float, self._offsets[axis], index, active)
            slope = (moved[axis] - offset) / gap  # away from the viewer, to the panel
            centre = dr.gather(mi.Float, self._centres[axis], index, active)
            start.append(dr.fma(-slope, self._start, centre))
            run.append(slope)
        return start, run

    def rays(self, pixel: Any, within: Any, pupil: Any = None, active: Any = True) -> Any:
        """World rays through film pixels; see `lines`."""
        return self.world_rays(*self.lines(pixel, within, pupil, active))[0]

    def centre_rays(self, index: Any = None) -> Any:
        """World rays through the centres of the pixels with flat indices; default: all pixels."""
        if index is None:
            index = dr.arange(mi.UInt32, self.shape[0] * self.shape[1])
        return self.rays(self.pixel(index), mi.Point2f(0.5))

    def sample(self, index: Any, sampler: Any) -> tuple[Any, Any, Any]:
        """Arguments of `lines` and `rays` for random points of pixels and of the pupil."""
        within, pupil = sampler.next_2d(), None
        if self.has_pupil:
            pupil = mi.warp.square_to_uniform_disk_concentric(sampler.next_2d())
        return self.pixel(index), within, pupil

    def world_rays(self, start: list[Any], run: list[Any]) -> tuple[Any, Any]:
        """World rays of `lines`, and their lengths per millimetre of depth."""
        place, towards = [*start, self._start], [*run, -1.0]
        origin = [dr.dot(mi.Vector3f(*row), mi.Vector3f(*place)) for row in self._linear]
        along = mi.Vector3f(
            *(dr.dot(mi.Vector3f(*row), mi.Vector3f(*towards)) for row in self._linear)
        )
        ray = mi.Ray3f(
            mi.Point3f(*(o + s for o, s in zip(origin, self._shift, strict=True))),
            dr.normalize(along),
        )
        return ray, dr.norm(along)
