"""Sensor plugins: the rays of a depth camera, of a display's pixels, and of an eye.

| plugin         | film plane        | ray of a film point q                                    |
| -------------- | ----------------- | -------------------------------------------------------- |
| `inim_capture` | any plane         | through q, straight back: what the RGB-D camera sees     |
| `inim_pickup`  | panel, z = -gap   | through q and the centre of the pixel's lens (Eq. 1)     |
| `inim_eye`     | lens array, z = 0 | from the eye through q: an off-axis frustum on the array |

An eye may have a pupil, a disc about its centre e in the plane z = V, focused on the plane a
distance F in front of it. The ray of q from the pupil's point e + u meets the ray from e in the
plane of focus: with s the slope of that chief ray, it runs at s - u / F, and crosses z = `start_mm`
at u (1 - (V - start) / F) beside it. Both changes are linear in u and the same for every pixel.

All three are one family: separable in x and y and linear inside a pixel. In the display frame a
ray starts on the plane z = `start_mm`, just in front of the picture, at a place that depends on
the film column (row), and runs back at a slope that does too. Both come as float64 tables, so the
float32 rays carry one rounding and no cancellation; and as the tables are run-time values, the
three sensors share one kernel, and the path tracer is compiled once instead of three times. Only
the pickup of an array that is hexagonal, turned or tilted is not separable: there each pixel has a
bundle of its own (`inim.render.non_separable_bundles`), and a kernel of its own traces them.

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
from inim.display.panel import SUBPIXELS, SubPixel
from inim.display.pixel_axis import PixelAxis
from inim.render.non_separable_bundles import FreeBundles, free_bundles

__all__ = [
    "WHOLE_PIXEL",
    "AxisRays",
    "RayFamily",
    "announce",
    "capture_rays",
    "eye_rays",
    "make_sensor",
    "pickup_rays",
]


#: All of a pixel shines.
WHOLE_PIXEL = SUBPIXELS["none"][0]


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
    """The rays of one sensor, display frame, millimetres; see the module's text.

    `pupil_place_mm` and `pupil_slope` are what place and slope change by from the middle of an
    eye's pupil to its edge; both 0 where there is no pupil.
    """

    plugin: str
    start_mm: float
    x: AxisRays
    y: AxisRays
    pupil_place_mm: float = 0.0
    pupil_slope: float = 0.0

    @property
    def has_pupil(self) -> bool:
        """Whether a pixel's rays come from all over a disc."""
        return self.pupil_slope != 0

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


def pickup_rays(
    display: Display, start_mm: float, subpixel: SubPixel = WHOLE_PIXEL
) -> RayFamily | FreeBundles:
    """One bundle per panel pixel, over what shines of it, through its lens centre (Eq. 1).

    Parameters
    ----------
    display : Display
    start_mm : float
    subpixel : SubPixel
        The part of each pixel that shines in the colour to be picked up, whatever its `turn`.
    """
    right = float(subpixel.right)
    width, height = float(subpixel.width) * display.pixel_fill, display.pixel_fill
    if not display.is_separable:
        return free_bundles(display, start_mm, right, width, height)

    def axis(pixels: PixelAxis, sign: int, aside: float, share: float) -> AxisRays:
        # A step across the pixel moves the panel end of the ray; the lens centre stays.
        step = sign * display.pixel_pitch_mm / display.gap_mm
        slope = pixels.slope - aside * step
        return AxisRays(
            pixels.centre_mm + slope * start_mm, -slope, -step * start_mm * share, step * share
        )

    return RayFamily(
        "inim_pickup",
        start_mm,
        axis(display.columns, +1, right, width),
        axis(display.rows, -1, 0.0, height),
    )


def eye_rays(
    display: Display,
    eye_mm: tuple[float, float, float],
    pixels_per_lens: int,
    start_mm: float,
    pupil_mm: float = 0.0,
    focus_mm: float | None = None,
) -> RayFamily:
    """From an eye through the lens array, which fills the film: an off-axis frustum.

    Parameters
    ----------
    display : Display
    eye_mm : (x, y, z)
        The pupil's centre.
    pixels_per_lens : int
    start_mm : float
    pupil_mm, focus_mm : float
        The pupil's diameter and the distance it is focused at, that of the array if None.
    """
    distance = eye_mm[2]
    focus = distance if focus_mm is None else focus_mm
    # Staggered rows make the array half a pitch wider than its lenses.
    cell_x = display.pitch_mm
    if display.lattice == "hexagonal":
        cell_x = display.width_mm / display.lens_columns

    def axis(lenses: int, cell: float, eye: float, sign: int) -> AxisRays:
        step = cell / pixels_per_lens
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
        axis(display.lens_columns, cell_x, eye_mm[0], +1),
        axis(display.lens_rows, display.row_pitch_mm, eye_mm[1], -1),
        pupil_mm / 2 * (1 - (distance - start_mm) / focus),
        -pupil_mm / 2 / focus,
    )


def _centres(count: int, step: float) -> np.ndarray:
    """Centres of `count` pixels about the axis; a negative step runs downwards."""
    return (np.arange(count) - (count - 1) / 2) * step


def make_sensor(rays: RayFamily | FreeBundles, world_from_display: np.ndarray) -> Any:
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

        def set_rays(self, rays: RayFamily | FreeBundles) -> None:
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
            self.free = isinstance(rays, FreeBundles)
            if isinstance(rays, FreeBundles):
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
            if self.free:
                return self.free_lines_through(pixel, within, active)
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

        def free_lines_through(
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
            start, run = self.lines_through(pixel, within, pupil, active)
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
