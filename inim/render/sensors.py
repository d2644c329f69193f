"""Sensor plugins `inim_capture`, `inim_pickup` and `inim_eye`: the rays of `inim.render.rays`.

The rays come as float64 tables, so the float32 rays carry one rounding and no cancellation; and as
the tables are run-time values, the three sensors share one kernel, and the path tracer is compiled
once instead of three times. Non-separable rays are traced by a kernel of their own.

`to_world` is the display-to-world map, any invertible affine: it keeps lines and their order, so a
picture squeezed into the display's depth range is exact geometry, lit in its own world.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from inim.render.rays import NonSeparableRays, SeparableRays

__all__ = ["make_sensor", "register"]


def make_sensor(rays: SeparableRays | NonSeparableRays, world_from_display: np.ndarray) -> Any:
    """The Mitsuba sensor of a ray family, with a float32 box-filtered film of its size."""
    film = {
        "type": "hdrfilm",
        "width": rays.columns,
        "height": rays.rows,
        "pixel_format": "rgb",
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }
    sensor = mi.load_dict(
        {
            "type": rays.plugin,
            "to_world": mi.ScalarTransform4f(np.asarray(world_from_display, np.float64)),
            "film": film,
        }
    )
    sensor.set_rays(rays)
    return sensor


def register() -> None:
    """Define and register the classes anew: plugins belong to the variant they were made in."""

    class LensFrameSensor(mi.Sensor):  # type: ignore[misc]
        """Common part of the three sensors; they differ in their `SeparableRays` alone."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.m_needs_sample_2 = True
            self.m_needs_sample_3 = False

        def set_rays(self, rays: SeparableRays | NonSeparableRays) -> None:
            """Take the rays as run-time values, not as literals of the kernel."""

            def value(number: float) -> Any:
                return dr.opaque(mi.Float, number)

            def table(numbers: np.ndarray) -> Any:
                return mi.Float(np.asarray(numbers, np.float32).reshape(-1))

            self.size = mi.Vector2u(
                dr.opaque(mi.UInt32, rays.columns), dr.opaque(mi.UInt32, rays.rows)
            )
            self.start = value(rays.start_mm)
            self.has_pupil = rays.has_pupil
            self.m_needs_sample_3 = rays.has_pupil
            self.separable = isinstance(rays, SeparableRays)
            if isinstance(rays, NonSeparableRays):
                self.centres = [table(rays.x0_mm), table(rays.y0_mm)]
                self.asides = [table(rays.aside_x_mm), table(rays.aside_y_mm)]
                self.gaps = table(rays.gap_mm)
                self.steps = [value(rays.step_x_mm), value(rays.step_y_mm)]
                self.tilts = [value(rays.tilt_x), value(rays.tilt_y)]
            else:
                axes = (rays.x, rays.y)
                self.places = [table(axis.place_mm) for axis in axes]
                self.slopes = [table(axis.slope) for axis in axes]
                self.place_steps = [value(axis.place_step_mm) for axis in axes]
                self.slope_steps = [value(axis.slope_step) for axis in axes]
                self.pupil_place = value(rays.pupil_place_mm)
                self.pupil_slope = value(rays.pupil_slope)
            matrix = np.asarray(self.world_transform().matrix, np.float64).reshape(4, 4)
            self.linear = [[value(matrix[i, j]) for j in range(3)] for i in range(3)]
            self.shift = [value(matrix[i, 3]) for i in range(3)]

        def lines_through(
            self, pixel: Any, within: Any, pupil: Any = None, active: Any = True
        ) -> tuple[list[Any], list[Any]]:
            """Rays through film pixels as [x, y] on the start plane and [x, y] slopes.

            Parameters
            ----------
            pixel : (n,) Point2u
                Column and row.
            within : (n,) Point2f
                Position inside the pixel, 0..1, rightwards and downwards.
            pupil : (n,) Point2f, optional
                Point of the pupil, in the unit disc; its middle if None.
            """
            if not self.separable:
                return self.non_separable_lines(pixel, within, active)
            start, run = [], []
            for axis in (0, 1):
                aside = within[axis] - 0.5
                place = dr.gather(mi.Float, self.places[axis], pixel[axis], active)
                slope = dr.gather(mi.Float, self.slopes[axis], pixel[axis], active)
                place = dr.fma(aside, self.place_steps[axis], place)
                slope = dr.fma(aside, self.slope_steps[axis], slope)
                if pupil is not None:
                    place = dr.fma(pupil[axis], self.pupil_place, place)
                    slope = dr.fma(pupil[axis], self.pupil_slope, slope)
                start.append(place)
                run.append(slope)
            return start, run

        def non_separable_lines(
            self, pixel: Any, within: Any, active: Any
        ) -> tuple[list[Any], list[Any]]:
            """`lines_through` where each pixel has a lens, a place and a gap of its own."""
            index = dr.fma(pixel.y, self.size.x, pixel.x)
            moved = [(within[axis] - 0.5) * self.steps[axis] for axis in (0, 1)]
            gap = dr.gather(mi.Float, self.gaps, index, active)
            gap = dr.fma(moved[0], self.tilts[0], dr.fma(moved[1], self.tilts[1], gap))
            start, run = [], []
            for axis in (0, 1):
                aside = dr.gather(mi.Float, self.asides[axis], index, active)
                slope = (moved[axis] - aside) / gap  # away from the viewer, to the panel
                centre = dr.gather(mi.Float, self.centres[axis], index, active)
                start.append(dr.fma(-slope, self.start, centre))
                run.append(slope)
            return start, run

        def rays_through(
            self, pixel: Any, within: Any, pupil: Any = None, active: Any = True
        ) -> Any:
            """World rays through film pixels; see `lines_through`."""
            return self.world_rays(*self.lines_through(pixel, within, pupil, active))[0]

        def world_rays(self, start: list[Any], run: list[Any]) -> tuple[Any, Any]:
            """World rays of `lines_through`, and how long they are for each mm of depth."""
            place, towards = [*start, self.start], [*run, -1.0]
            origin = [dr.dot(mi.Vector3f(*row), mi.Vector3f(*place)) for row in self.linear]
            along = mi.Vector3f(
                *(dr.dot(mi.Vector3f(*row), mi.Vector3f(*towards)) for row in self.linear)
            )
            ray = mi.Ray3f(
                mi.Point3f(*(o + s for o, s in zip(origin, self.shift, strict=True))),
                dr.normalize(along),
            )
            return ray, dr.norm(along)

        def sample_ray(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any]:
            place = sample2 * mi.Vector2f(self.size)
            pixel = dr.minimum(mi.Point2u(place), mi.Point2u(self.size) - 1)
            pupil = mi.warp.square_to_uniform_disk_concentric(sample3) if self.has_pupil else None
            ray = self.rays_through(pixel, place - mi.Point2f(pixel), pupil, active)
            ray.time = time
            return ray, mi.Spectrum(1.0)

        def sample_ray_differential(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any]:
            ray, weight = self.sample_ray(time, sample1, sample2, sample3, active)
            return mi.RayDifferential3f(ray), weight

        def to_string(self) -> str:
            return type(self).__name__

    class CaptureSensor(LensFrameSensor):
        """`inim_capture`."""

    class PickupSensor(LensFrameSensor):
        """`inim_pickup`."""

    class EyeSensor(LensFrameSensor):
        """`inim_eye`."""

    mi.register_sensor("inim_capture", CaptureSensor)
    mi.register_sensor("inim_pickup", PickupSensor)
    mi.register_sensor("inim_eye", EyeSensor)
