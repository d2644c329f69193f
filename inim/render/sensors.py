"""Sensor plugins `inim_eye` and `inim_pickup`, and the parameters of a display in a Mitsuba scene.

The sensors have a display's parameters, and make the rays of a `FilmCamera` of them.

A display stands in a scene as a stock `rectangle`, whose square [-1, 1]^2 is the misaligned lens
array. So one `to_world` gives its position, its rotation and the length of a millimetre in the
scene's unit. The emitter `inim_display` and the sensors read it in the same way.
"""

import difflib
from typing import Any

import numpy as np

from inim.display import DISPLAYS, Display
from inim.display.misalignment import misaligned
from inim.display.pixels import exact_ratio
from inim.display.settings import DISPLAY_KEYS, Settings
from inim.display.viewpoint import Viewpoint, default_distance_mm
from inim.render.library import dr, mi
from inim.render.rays import NonSeparableRays, SeparableRays, frustum_rays, pickup_rays
from inim.render.trace import FilmCamera
from inim.system.errors import DisplayError, SceneError, ViewpointError

_EYE = ("x_mm", "y_mm", "z_mm", "pupil_mm", "focus_mm")
_STOCK = ("to_world", "shutter_open", "shutter_close")
# A view without a film of its own.
_PIXELS_PER_PITCH = 4


def _ensure_film(props: Any, rows: int, columns: int) -> tuple[int, int]:
    """Rows and columns of a sensor's film; the sensor is given one where it has none."""
    for name in props:
        if props.type(name) == mi.Properties.Type.Object and isinstance(props[name], mi.Film):
            width, height = props[name].size()
            return int(height), int(width)
    # Its pixels are means over their areas.
    film = {"width": columns, "height": rows, "pixel_format": "rgb", "component_format": "float32"}
    props["film"] = mi.load_dict({"type": "hdrfilm", **film, "rfilter": {"type": "box"}})
    return rows, columns


def _read_eye(values: dict[str, Any], display: Display) -> Viewpoint:
    """The eye that the parameters describe; on the axis, at the usual distance, by default."""
    usual = {"x_mm": 0.0, "y_mm": 0.0, "z_mm": default_distance_mm(display)}
    positions = {name: read_number("inim_eye", values, name) for name in _EYE if name in values}
    try:
        return Viewpoint("eye", **(usual | positions))
    except ViewpointError as error:
        raise SceneError(f"inim_eye: {error}") from None


def register() -> None:
    """Define and register the classes again: plugins belong to the active variant."""
    if not mi.variant().endswith("_ad_rgb"):
        for plugin in ("inim_pickup", "inim_eye"):
            mi.register_sensor(plugin, unsupported_class(plugin, mi.Sensor))
        return

    class DisplaySensor(mi.Sensor):  # type: ignore[misc]
        """Sensor whose rays follow from a display; its `to_world` puts the display into a world.

        The method `rays` of a subclass checks the film, or adds one.
        """

        plugin: str
        own: tuple[str, ...]

        def __init__(self, props: Any) -> None:
            values = read_properties(self.plugin, props, self.own, _STOCK)
            self.display = read_display(self.plugin, values)
            rays = self.rays(values, props)
            super().__init__(props)
            self.camera = FilmCamera(rays, np.eye(4))
            self.m_needs_sample_2 = True
            self.m_needs_sample_3 = self.camera.has_pupil
            # A copy: what the base class hands out would keep the sensor alive for good.
            self.to_world: Any = mi.AffineTransform4f(self.m_to_world)
            self.parameters_changed([])

        def traverse(self, callback: Any) -> None:
            super().traverse(callback)
            callback.put("to_world", self.to_world, mi.ParamFlags.NonDifferentiable)

        def parameters_changed(self, keys: list[str]) -> None:
            super().parameters_changed(keys)
            self.m_to_world = self.to_world
            to_world = np.asarray(self.m_to_world.matrix, np.float64).reshape(4, 4)
            self.camera.place(world_from_display(self.plugin, to_world, self.display))

        def sample_ray(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any]:
            film, camera = self.film(), self.camera
            first, crop = mi.Vector2u(film.crop_offset()), mi.Vector2u(film.crop_size())
            place = sample2 * mi.Vector2f(crop) + mi.Vector2f(first)
            pixel = dr.minimum(mi.Point2u(place), mi.Point2u(first + crop) - 1)
            pupil = mi.warp.square_to_uniform_disk_concentric(sample3) if camera.has_pupil else None
            ray = camera.rays(pixel, place - mi.Point2f(pixel), pupil, active)
            ray.time = time
            return ray, mi.Spectrum(1.0)

        def sample_ray_differential(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any]:
            ray, weight = self.sample_ray(time, sample1, sample2, sample3, active)
            return mi.RayDifferential3f(ray), weight

        def to_string(self) -> str:
            return type(self).__name__

    class PickupSensor(DisplaySensor):
        """`inim_pickup`: each panel pixel's light, through the centre of its lens."""

        plugin, own = "inim_pickup", ("start_mm",)

        def rays(self, values: dict[str, Any], props: Any) -> SeparableRays | NonSeparableRays:
            display = self.display
            if display.subpixels != "none":
                raise SceneError(
                    f"inim_pickup: subpixels = {display.subpixels!r}: each colour has its own "
                    "rays, but a sensor has the same rays for all colours; omit subpixels"
                )
            shape = display.eia_shape
            if _ensure_film(props, *shape) != shape:
                raise SceneError(
                    f"inim_pickup: its film is the panel, {shape[1]} x {shape[0]} pixels; give it "
                    "that width and height, or no film"
                )
            start_mm = display.depth_range_mm[1]
            if "start_mm" in values:
                start_mm = read_number("inim_pickup", values, "start_mm")
            return pickup_rays(display, start_mm)

    class EyeSensor(DisplaySensor):
        """`inim_eye`: a pupil before the array, which fills the film."""

        plugin, own = "inim_eye", _EYE

        def rays(self, values: dict[str, Any], props: Any) -> SeparableRays | NonSeparableRays:
            display = self.display
            half_x, half_y = display.half_extent_mm
            per_mm = _PIXELS_PER_PITCH / display.pitch_mm
            pixels = (exact_ratio(2 * half * per_mm) for half in (half_y, half_x))
            rows, columns = _ensure_film(props, *map(round, pixels))
            if abs(columns * half_y / half_x - rows) >= 1:
                raise SceneError(
                    f"inim_eye: the film's aspect ratio, {columns} x {rows}, does not match the "
                    f"array, {2 * half_x:g} x {2 * half_y:g} mm; use "
                    f"{columns} x {max(1, round(columns * half_y / half_x))}"
                )
            eye = _read_eye(values, display)
            pixel = (2 * half_x / columns, 2 * half_y / rows)
            return frustum_rays((rows, columns), pixel, display, eye, eye.z_mm)

    mi.register_sensor("inim_pickup", PickupSensor)
    mi.register_sensor("inim_eye", EyeSensor)


_DISPLAY = ("preset", *DISPLAY_KEYS, "misalign")
_OBJECTS = (mi.Properties.Type.Object, mi.Properties.Type.ResolvedReference)
# A rectangle's sides may be rounded to three digits; more, and the picture is stretched.
_ASPECT = 1e-3
# Sides that are square to each other in float32, turned and moved.
_SQUARE = 1e-5


def unsupported_class(plugin: str, base: type) -> type:
    """Plugin class for an unsupported variant: it raises a one-line error."""

    def refuse(*_: Any) -> None:
        raise SceneError(
            f"{plugin}: works in the variants llvm_ad_rgb and cuda_ad_rgb, not in {mi.variant()}; "
            "set one of them with mi.set_variant"
        )

    return type("Refusing", (base,), {"__init__": refuse})


def read_properties(
    plugin: str, props: Any, own: tuple[str, ...], stock: tuple[str, ...]
) -> dict[str, Any]:
    """Read the parameters of a plugin: a display's, and its own.

    * `own`: the plugin's own parameters, in addition to a display's.
    * `stock`: parameters of its base class, which also receives all objects that are not the
      plugin's own.

    Raises `SceneError`: an unknown parameter, with the nearest valid name.
    """
    allowed = (*own, *_DISPLAY)
    values = {}
    for name in props:
        if name in stock or (name not in allowed and props.type(name) in _OBJECTS):
            continue
        if name not in allowed:
            near = difflib.get_close_matches(name, allowed, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"use {', '.join(allowed)}"
            raise SceneError(f"{plugin}: unknown parameter {name!r}; {hint}")
        values[name] = props[name]
    return values


def read_number(plugin: str, values: dict[str, Any], name: str) -> float:
    """Number of a parameter of a plugin; raises `SceneError` for another type."""
    value = values[name]
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise SceneError(f"{plugin}: {name} = {value!r}: must be a number")
    return float(value)


def read_display(plugin: str, values: dict[str, Any]) -> Display:
    """Display described by a plugin's parameters, with its misalignment.

    * `values`: `preset` (nominal), `misalign`, and changes to the preset under the names of
      `Display`.

    Raises `InimError`: the parameters describe no possible display.
    """
    preset = values.get("preset", "nominal")
    if preset not in DISPLAYS:
        raise SceneError(f"{plugin}: preset = {preset!r}; use {' or '.join(DISPLAYS)}")
    changes = {name: values[name] for name in DISPLAY_KEYS if name in values}
    display = Settings(display=preset, **changes).make_display(plugin)
    try:
        return misaligned(display, str(values.get("misalign", "")))
    except DisplayError as error:
        raise DisplayError(f"{plugin}: {error}") from None


def world_from_display(plugin: str, to_world: np.ndarray, display: Display) -> np.ndarray:
    """Map from the display frame, in millimetres, to the world.

    * `to_world`, (4, 4) float64: map of the rectangle [-1, 1]^2, which is the misaligned array. Its
      scale along the rectangle's normal does not matter.

    Returns (4, 4) float64: rotation, one scale, translation. Raises `SceneError`: the rectangle is
    skewed or mirrored, or its aspect ratio does not match the array.
    """
    half_x, half_y = display.half_extent_mm
    sides = np.linalg.norm(to_world[:3, :2], axis=0)
    if not (np.isfinite(to_world).all() and sides.min() > 0):
        raise SceneError(f"{plugin}: to_world maps [-1, 1]^2 to no rectangle; use a scale above 0")
    right, up = (to_world[:3, :2] / sides).T
    if abs(right @ up) > _SQUARE:
        raise SceneError(f"{plugin}: to_world skews the display; only move, rotate and scale it")
    front = np.cross(right, up)
    if front @ to_world[:3, 2] < 0:
        raise SceneError(
            f"{plugin}: to_world mirrors the display; use a rotation instead of a negative scale"
        )
    unit = sides / (half_x, half_y)
    if abs(unit[0] / unit[1] - 1) > _ASPECT:
        raise SceneError(
            f"{plugin}: the rectangle's aspect ratio, {2 * sides[0]:.6g} x {2 * sides[1]:.6g}, "
            f"does not match the array, {2 * half_x:.6g} x {2 * half_y:.6g} mm; scale it by "
            f"{half_x:.6g} and {half_y:.6g} times the length of a millimetre"
        )
    place = np.eye(4)
    place[:3, :3] = np.stack([right, up, front], axis=1) * unit.mean()
    place[:3, 3] = to_world[:3, 3]
    return place
