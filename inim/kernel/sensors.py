"""Sensor plugins: the rays of a depth camera, of a display's pixels, and of an eye.

| plugin         | film plane        | ray of a film point q, lens centre c                     |
| -------------- | ----------------- | -------------------------------------------------------- |
| `inim_capture` | any plane         | through q, straight back: what the RGB-D camera sees     |
| `inim_pickup`  | panel, z = -gap   | through q and the centre of the pixel's lens (Eq. 1)     |
| `inim_eye`     | lens array, z = 0 | from the eye through q: an off-axis frustum on the array |

All three are one family. In the display frame a ray starts on the plane z = `start_mm`, just in
front of the picture, at ``a_q q + a_c c + a_0`` and runs back along ``b_q q + b_c c + b_0`` per
millimetre of depth. The coefficients are run-time values, so the three share one compiled kernel,
and the path tracer is compiled once instead of three times.

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

__all__ = ["RayFamily", "announce", "capture_rays", "eye_rays", "make_sensor", "pickup_rays"]


@dataclass(frozen=True)
class RayFamily:
    """Rays of one sensor, display frame, millimetres; see the module's text.

    Attributes
    ----------
    plugin : str
    columns, rows : int
        Film size.
    pixel_mm : float
        Film pixel on the film plane.
    lens_x_mm, lens_y_mm : (columns,), (rows,) float arrays
        Lens centre of each film column and row; zeros where no lens takes part.
    start_mm : float
        Plane on which rays start.
    film_share, lens_share : float
        a_q and a_c.
    offset_mm : (float, float)
        a_0.
    film_slope, lens_slope : float
        b_q and b_c, per millimetre away from the viewer.
    slope : (float, float)
        b_0.
    """

    plugin: str
    columns: int
    rows: int
    pixel_mm: float
    lens_x_mm: np.ndarray
    lens_y_mm: np.ndarray
    start_mm: float
    film_share: float
    lens_share: float = 0.0
    offset_mm: tuple[float, float] = (0.0, 0.0)
    film_slope: float = 0.0
    lens_slope: float = 0.0
    slope: tuple[float, float] = (0.0, 0.0)


def capture_rays(columns: int, rows: int, pixel_mm: float, start_mm: float) -> RayFamily:
    """Parallel rays straight back: the orthographic RGB-D camera."""
    return RayFamily(
        "inim_capture", columns, rows, pixel_mm, *_no_lenses(columns, rows), start_mm, 1.0
    )


def pickup_rays(display: Display, start_mm: float) -> RayFamily:
    """One bundle per panel pixel, over the pixel's area, through its lens centre (Eq. 1)."""
    rows, columns = display.eia_shape
    g = display.gap_mm
    return RayFamily(
        "inim_pickup",
        columns,
        rows,
        display.pixel_pitch_mm,
        display.columns.centre_mm,
        display.rows.centre_mm,
        start_mm,
        film_share=-start_mm / g,
        lens_share=1 + start_mm / g,
        film_slope=1 / g,
        lens_slope=-1 / g,
    )


def eye_rays(
    display: Display, eye_mm: tuple[float, float, float], pixels_per_lens: int, start_mm: float
) -> RayFamily:
    """From an eye through the lens array, which fills the film: an off-axis frustum."""
    columns = display.lens_columns * pixels_per_lens
    rows = display.lens_rows * pixels_per_lens
    x, y, distance = eye_mm
    ahead = start_mm / distance
    return RayFamily(
        "inim_eye",
        columns,
        rows,
        display.pitch_mm / pixels_per_lens,
        *_no_lenses(columns, rows),
        start_mm,
        film_share=1 - ahead,
        offset_mm=(x * ahead, y * ahead),
        film_slope=1 / distance,
        slope=(-x / distance, -y / distance),
    )


def _no_lenses(columns: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    return np.zeros(columns), np.zeros(rows)


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
            "pixel_mm": rays.pixel_mm,
        }
    )
    sensor.set_rays(rays)
    return sensor


def announce() -> None:
    """Register the plugins in every variant that is set from now on."""
    mi.detail.add_variant_callback(_register)


def _register(_old: str | None = None, _new: str | None = None) -> None:
    """Define and register the classes anew: plugins belong to the variant they were made in."""
    if mi.variant() is None or mi.variant().startswith("scalar"):
        return

    class LensFrameSensor(mi.Sensor):  # type: ignore[misc]
        """Common part of the three sensors; they differ in their `RayFamily` alone."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.pixel_mm = props.get("pixel_mm", 1.0)
            self.m_needs_sample_2 = True
            self.m_needs_sample_3 = False

        def set_rays(self, rays: RayFamily) -> None:
            """Take the rays' coefficients as run-time values, not as literals of the kernel."""

            def value(number: float) -> Any:
                return dr.opaque(mi.Float, number)

            def pair(numbers: tuple[float, float]) -> Any:
                return mi.Vector2f(value(numbers[0]), value(numbers[1]))

            self.size = mi.Vector2u(
                dr.opaque(mi.UInt32, rays.columns), dr.opaque(mi.UInt32, rays.rows)
            )
            # The y axis points up, rows go down.
            self.corner = pair((-rays.columns * rays.pixel_mm / 2, rays.rows * rays.pixel_mm / 2))
            self.step = pair((rays.pixel_mm, -rays.pixel_mm))
            self.lens_x = mi.Float(np.asarray(rays.lens_x_mm, np.float32))
            self.lens_y = mi.Float(np.asarray(rays.lens_y_mm, np.float32))
            self.start = value(rays.start_mm)
            self.film_share, self.lens_share = value(rays.film_share), value(rays.lens_share)
            self.film_slope, self.lens_slope = value(rays.film_slope), value(rays.lens_slope)
            self.offset, self.slope = pair(rays.offset_mm), pair(rays.slope)
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
            q = mi.Vector2f(self.corner + self.step * (mi.Vector2f(pixel) + within))
            c = mi.Vector2f(
                dr.gather(mi.Float, self.lens_x, pixel.x, active),
                dr.gather(mi.Float, self.lens_y, pixel.y, active),
            )
            a = self.film_share * q + self.lens_share * c + self.offset
            b = self.film_slope * q + self.lens_slope * c + self.slope
            origin = [
                self.linear[i][0] * a.x
                + self.linear[i][1] * a.y
                + self.linear[i][2] * self.start
                + self.shift[i]
                for i in range(3)
            ]
            towards = [
                self.linear[i][0] * b.x + self.linear[i][1] * b.y - self.linear[i][2]
                for i in range(3)
            ]
            return mi.Ray3f(mi.Point3f(*origin), dr.normalize(mi.Vector3f(*towards)))

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
