"""Sensor plugins: the rays of a depth camera, of a display's pixels, and of an eye.

| plugin         | film plane        | ray of a film point q                                    |
| -------------- | ----------------- | -------------------------------------------------------- |
| `inim_capture` | any plane         | through q, straight back: what the RGB-D camera sees     |
| `inim_pickup`  | panel, z = -gap   | through q and the centre of the pixel's lens (Eq. 1)     |
| `inim_eye`     | lens array, z = 0 | from the eye through q: an off-axis frustum on the array |

All three are one family: separable in x and y and linear inside a pixel. In the display frame a
ray starts on the plane z = `start_mm`, just in front of the picture, at a place that depends on
the film column (row), and runs back at a slope that does too. Both come as float64 tables, so the
float32 rays carry one rounding and no cancellation; and as the tables are run-time values, the
three sensors share one kernel, and the path tracer is compiled once instead of three times.

`to_world` is the display-to-world map, any invertible affine: it keeps lines and their order, so a
picture squeezed into the display's depth range is exact geometry, lit in its own world.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from inim.display import Display
from inim.pixel_axis import PixelAxis

__all__ = [
    "AxisRays",
    "RayFamily",
    "announce",
    "capture_rays",
    "eye_rays",
    "make_sensor",
    "pickup_rays",
]


@dataclass(frozen=True)
class AxisRays:
    """One axis of a ray family: the rays of the pixel centres, and how they change inside a pixel.

    Attributes
    ----------
    place_mm : (n,) float64
        Where the ray of each column (row) crosses the start plane.
    slope : (n,) float64
        Its sideways travel per millimetre away from the viewer.
    place_step_mm, slope_step : float
        Change of both from one side of a pixel to the other, in film order.
    """

    place_mm: np.ndarray
    slope: np.ndarray
    place_step_mm: float
    slope_step: float = 0.0


@dataclass(frozen=True)
class RayFamily:
    """The rays of one sensor, display frame, millimetres; see the module's text."""

    plugin: str
    start_mm: float
    x: AxisRays
    y: AxisRays

    @property
    def columns(self) -> int:
        """Film width."""
        return len(self.x.place_mm)

    @property
    def rows(self) -> int:
        """Film height."""
        return len(self.y.place_mm)


def capture_rays(columns: int, rows: int, pixel_mm: float, start_mm: float) -> RayFamily:
    """Parallel rays straight back: the orthographic RGB-D camera."""

    def axis(count: int, sign: int) -> AxisRays:
        return AxisRays(_centres(count, sign * pixel_mm), np.zeros(count), sign * pixel_mm)

    return RayFamily("inim_capture", start_mm, axis(columns, +1), axis(rows, -1))


def pickup_rays(display: Display, start_mm: float) -> RayFamily:
    """One bundle per panel pixel, over the pixel's area, through its lens centre (Eq. 1)."""

    def axis(pixels: PixelAxis, sign: int) -> AxisRays:
        # A step across the pixel moves the panel end of the ray; the lens centre stays.
        step = sign * display.pixel_pitch_mm / display.gap_mm
        return AxisRays(
            pixels.centre_mm + pixels.slope * start_mm, -pixels.slope, -step * start_mm, step
        )

    return RayFamily("inim_pickup", start_mm, axis(display.columns, +1), axis(display.rows, -1))


def eye_rays(
    display: Display, eye_mm: tuple[float, float, float], pixels_per_lens: int, start_mm: float
) -> RayFamily:
    """From an eye through the lens array, which fills the film: an off-axis frustum."""
    distance = eye_mm[2]
    step = display.pitch_mm / pixels_per_lens

    def axis(lenses: int, eye: float, sign: int) -> AxisRays:
        on_array = _centres(lenses * pixels_per_lens, sign * step)
        slope = (on_array - eye) / distance
        return AxisRays(
            on_array - slope * start_mm,
            slope,
            sign * step * (1 - start_mm / distance),
            sign * step / distance,
        )

    return RayFamily(
        "inim_eye",
        start_mm,
        axis(display.lens_columns, eye_mm[0], +1),
        axis(display.lens_rows, eye_mm[1], -1),
    )


def _centres(count: int, step: float) -> np.ndarray:
    """Centres of `count` pixels about the axis; a negative step runs downwards."""
    return (np.arange(count) - (count - 1) / 2) * step


def make_sensor(rays: RayFamily, world_from_display: np.ndarray) -> Any:
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


def announce() -> None:
    """Register the plugins in every variant that is set from now on."""
    mi.detail.add_variant_callback(_register)
    _register()


def _register(_old: str | None = None, _new: str | None = None) -> None:
    """Define and register the classes anew: plugins belong to the variant they were made in."""
    if mi.variant() is None or mi.variant().startswith("scalar"):
        return

    class LensFrameSensor(mi.Sensor):  # type: ignore[misc]
        """Common part of the three sensors; they differ in their `RayFamily` alone."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.m_needs_sample_2 = True
            self.m_needs_sample_3 = False

        def set_rays(self, rays: RayFamily) -> None:
            """Take the rays as run-time values, not as literals of the kernel."""

            def value(number: float) -> Any:
                return dr.opaque(mi.Float, number)

            def table(numbers: np.ndarray) -> Any:
                return mi.Float(np.asarray(numbers, np.float32))

            axes = (rays.x, rays.y)
            self.size = mi.Vector2u(
                dr.opaque(mi.UInt32, rays.columns), dr.opaque(mi.UInt32, rays.rows)
            )
            self.places = [table(axis.place_mm) for axis in axes]
            self.slopes = [table(axis.slope) for axis in axes]
            self.place_steps = [value(axis.place_step_mm) for axis in axes]
            self.slope_steps = [value(axis.slope_step) for axis in axes]
            self.start = value(rays.start_mm)
            matrix = np.asarray(self.world_transform().matrix, np.float64).reshape(4, 4)
            self.linear = [[value(matrix[i, j]) for j in range(3)] for i in range(3)]
            self.shift = [value(matrix[i, 3]) for i in range(3)]

        def rays_through(self, pixel: Any, within: Any, active: Any = True) -> Any:
            """World rays through film pixels.

            Parameters
            ----------
            pixel : (n,) Point2u
                Column and row.
            within : (n,) Point2f
                Position inside the pixel, 0..1, rightwards and downwards.
            """
            start, run = [], []
            for axis in (0, 1):
                aside = within[axis] - 0.5
                place = dr.gather(mi.Float, self.places[axis], pixel[axis], active)
                slope = dr.gather(mi.Float, self.slopes[axis], pixel[axis], active)
                start.append(dr.fma(aside, self.place_steps[axis], place))
                run.append(dr.fma(aside, self.slope_steps[axis], slope))
            start.append(self.start)
            origin = [dr.dot(mi.Vector3f(*row), mi.Vector3f(*start)) for row in self.linear]
            towards = [dr.dot(mi.Vector3f(*row), mi.Vector3f(*run, -1.0)) for row in self.linear]
            return mi.Ray3f(
                mi.Point3f(*(o + s for o, s in zip(origin, self.shift, strict=True))),
                dr.normalize(mi.Vector3f(*towards)),
            )

        def sample_ray(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any]:
            place = sample2 * mi.Vector2f(self.size)
            pixel = dr.minimum(mi.Point2u(place), mi.Point2u(self.size) - 1)
            ray = self.rays_through(pixel, place - mi.Point2f(pixel), active)
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
