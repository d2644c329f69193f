"""Emitter plugin `inim_display`: a panel with its lens array, as an area emitter on a rectangle.

Radiance depends on the position and direction in which a ray leaves the array. Any stock camera and
integrator therefore sees the display as an eye would, and it lights the scene. The rectangle is
the aligned array (see `inim.render.sensors`), placed by its `to_world`: a ray's position
is in the rectangle's own coordinates, its slopes are in the rectangle's frame.

The array is one shape with an analytic lens: thousands of instances hang the renderer, and
its spawned rays would move by most of a display pixel.
"""

import gc
import math
import weakref
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from inim.display import Display
from inim.display.cells import CELL_PATTERNS
from inim.display.lens import Ops, channel_indices, lens_array, lens_traits, through_array
from inim.display.lens import lens_model as find_lens_model
from inim.display.panel import emits_as_driven, emitted_light, white_of
from inim.display.pixels import SUBPIXELS, emission_profile
from inim.image.files.eia_file import read_eia
from inim.render.library import dr, mi
from inim.render.sensors import (
    read_display,
    read_number,
    read_properties,
    unsupported_class,
    world_from_display,
)
from inim.render.trace import FilmCamera, Light
from inim.system.errors import SceneError

PLUGIN = "inim_display"
_OWN = ("filename", "bitmap", "eia", "lens_model", "brightness")
_PICTURES = ("filename", "bitmap", "eia")


_OPS = Ops(dr.sqrt, dr.floor, dr.select, dr.abs)
# Displays of all scenes. Python may collect those of abandoned scenes at any time. While a kernel
# is recorded, this makes Dr.Jit 1.5 define a function twice, and abort. They are collected before.
_displays: weakref.WeakSet[Any] = weakref.WeakSet()


class SeenPixel(NamedTuple):
    """Panel pixel that a ray meets."""

    index: Any  #: Flat index of the pixel.
    weight: Any  #: Share of the pixel's light that arrives.
    is_lit: Any  #: False where no light arrives.


class LensedPanel:
    """Panel with its lens array: the emitted light as Dr.Jit code.

    * `picture`: the EIA, row 0 on top. Without it, only `find_pixels` work: where light would come
      from.

    Its attributes:
    * `start_mm`: start plane of the rays of `light`: only the display is there, so nothing is
      intersected.
    """

    start_mm = 0.0

    def __init__(self, display: Display, lens_model: str, picture: Any = None) -> None:
        # Run-time values all: a literal would compile the kernel anew for every display.
        def value(number: float) -> Any:
            return dr.opaque(mi.Float, number)

        model, indices = find_lens_model(lens_model), channel_indices(display)
        # What a display does not have is not compiled: one index for all colours means one ray.
        colored = len(set(indices)) > 1 and model.refracts
        patterned = display.subpixels != "none" or display.pixel_fill < 1
        self.rows, self.columns = map(value, display.eia_shape)
        self.pixel_mm = value(display.pixel_pitch_mm)
        self.fill = value(display.pixel_fill)
        self.emission = None
        if not emits_as_driven(display):
            self.emission = value(display.black_level), [*map(value, white_of(display))]
        self.subpixels = SUBPIXELS[display.subpixels] if patterned else None
        self.cells = None
        if display.subpixels == "cells":
            numbers = np.array(display.subpixel_cells, np.float32)
            self.cells = mi.Float(numbers.ravel()), len(numbers)
            self.cell_pattern = CELL_PATTERNS[display.cell_pattern]
        self.trace = model.traced_without_renderer()
        self.indices = [value(index) for index in (indices if colored else indices[:1])]
        self.array = lens_array(display).convert(value)
        self.traits = lens_traits(display)
        self.picture = picture

    def light(self, camera: FilmCamera) -> Light:
        """Function that returns the light of a camera's rays, which start on the array."""

        def light(index: Any, sampler: Any) -> Any:
            (x, y), (sx, sy) = camera.lines(*camera.sample(index, sampler))
            return self.radiance_along(x, y, sx, sy)

        return light

    def radiance_along(self, x: Any, y: Any, sx: Any, sy: Any, lit: Any = True) -> Any:
        """Radiance along display-frame rays that cross z = 0 at (x, y) with slopes (sx, sy)."""
        pixels = self.find_pixels(x, y, sx, sy, lit)
        if len(pixels) == 1:
            index, weight, lit = pixels[0]
            color = self._emitted(dr.gather(mi.Color3f, self.picture, index, lit), slice(3))
            return mi.Spectrum(color * weight) & lit
        color = mi.Color3f(0.0)
        for channel, (index, weight, is_lit) in enumerate(pixels):
            value = dr.gather(mi.Float, self.picture, 3 * index + channel, is_lit)
            value = self._emitted(value, slice(channel, channel + 1))
            color[channel] = dr.select(is_lit, value * weight, 0.0)
        return mi.Spectrum(color)

    def _emitted(self, light: Any, channels: slice) -> Any:
        """Light that the panel emits when driven with `light`, of all channels or of one."""
        if self.emission is None:
            return light
        black, white = self.emission
        return emitted_light(light, black, type(light)(*white[channels]))

    def find_pixels(
        self, x_mm: Any, y_mm: Any, slope_x: Any, slope_y: Any, is_active: Any = True
    ) -> list[SeenPixel]:
        """Panel pixels of display-frame rays that cross z = 0 at a point.

        One for all colours, or one for each of red, green and blue.
        """
        # Red stands for all colours where nothing tells them apart.
        rays = [
            through_array(
                self.trace, self.array, self.traits, _OPS, x_mm, y_mm, slope_x, slope_y, index
            )
            for index in self.indices
        ]
        if len(rays) == 1 and self.subpixels is None:
            return [self._pixel_at(*rays[0], is_active)]
        return [self._pixel_at(*rays[c % len(rays)], is_active, c) for c in range(3)]

    def _pixel_at(
        self, x_mm: Any, y_mm: Any, weight: Any, is_active: Any, channel: int = 0
    ) -> SeenPixel:
        """Pixel at a point of the panel that a ray of some weight meets."""
        across = x_mm / self.pixel_mm + 0.5 * self.columns
        along = 0.5 * self.rows - y_mm / self.pixel_mm  # row 0 is the top
        column, row = dr.floor(across), dr.floor(along)
        lit = is_active & (weight > 0)
        lit &= (column >= 0) & (column < self.columns) & (row >= 0) & (row < self.rows)
        index = mi.UInt32(dr.select(lit, row * self.columns + column, 0.0))
        if self.subpixels is not None:
            turn = mi.UInt32(dr.select(lit, row + column, 0.0)) & 1
            right, down = across - column - 0.5, along - row - 0.5
            if self.cells is not None:
                numbers, kinds = self.cells
                from_bottom = dr.select(lit, self.rows - 1.0 - row, 0.0)
                kind = self.cell_pattern(
                    mi.UInt32(dr.select(lit, column, 0.0)), mi.UInt32(from_bottom)
                )
                first = kind % kinds * 6 + 2 * channel
                right -= dr.gather(mi.Float, numbers, first, lit)
                down += dr.gather(mi.Float, numbers, first + 1, lit)
            weight = weight * emission_profile(
                self.subpixels[channel], self.fill, dr.select, right, down, turn
            )
        return SeenPixel(index, weight, lit)


def _read_picture(values: dict[str, Any], display: Display) -> np.ndarray:
    """The EIA that the parameters name or hold, (rows, columns, 3) float32."""
    names = [name for name in _PICTURES if name in values]
    if len(names) != 1:
        problem = f"both {' and '.join(names)}" if names else "no EIA"
        raise SceneError(f"{PLUGIN}: has {problem}; give one of {', '.join(_PICTURES)}")
    bitmap = values[names[0]]
    if names[0] == "filename":
        return read_eia(Path(str(mi.file_resolver().resolve(bitmap))), display)[0]
    if names[0] == "bitmap":
        if not isinstance(bitmap, mi.Bitmap):
            raise SceneError(f"{PLUGIN}: bitmap is a {type(bitmap).__name__}; give an mi.Bitmap")
        bitmap = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False)
    picture = np.array(bitmap, np.float32)
    rows, columns = display.eia_shape
    if picture.shape != (rows, columns, 3):
        raise SceneError(
            f"{PLUGIN}: {names[0]} has shape {picture.shape}; the display needs "
            f"{(rows, columns, 3)}"
        )
    return picture


def register() -> None:
    """Define and register the class again: plugins belong to the active variant."""
    if not mi.variant().endswith("_ad_rgb"):
        mi.register_emitter(PLUGIN, unsupported_class(PLUGIN, mi.Emitter))
        return

    class DisplayEmitter(mi.Emitter):  # type: ignore[misc]
        """See the module's text."""

        def __init__(self, props: Any) -> None:
            if "to_world" in props:
                raise SceneError(f"{PLUGIN}: has no to_world of its own; give it to the rectangle")
            values = read_properties(PLUGIN, props, _OWN, ("sampling_weight",))
            display, lens_model = read_display(PLUGIN, values), values.get("lens_model", "thick")
            find_lens_model(lens_model).check(display)
            brightness = read_number(PLUGIN, {"brightness": 1.0} | values, "brightness")
            if not (math.isfinite(brightness) and brightness >= 0):
                raise SceneError(
                    f"{PLUGIN}: brightness = {brightness:g}: must be finite and not negative"
                )
            eia = mi.TensorXf(_read_picture(values, display))
            panel = LensedPanel(display, lens_model, eia.array)
            panel.radiance_along(*(mi.Float(0.0),) * 4)  # another package's model may fail
            if _displays:
                gc.collect()
            # From here on kernels are recorded of it, whatever scene is rendered: nothing may fail.
            super().__init__(props)
            _displays.add(self)
            self.refused = False
            self.display, self.eia, self.panel = display, eia, panel
            self.brightness = dr.opaque(mi.Float, brightness)
            self.half_extent = [dr.opaque(mi.Float, half) for half in display.half_extent_mm]
            self.m_needs_sample_2 = True
            self.m_needs_sample_3 = True
            self.m_flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying

        def traverse(self, callback: Any) -> None:
            super().traverse(callback)
            callback.put("eia", self.eia, mi.ParamFlags.Differentiable)
            callback.put("brightness", self.brightness, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: list[str]) -> None:
            super().parameters_changed(keys)
            self.refused = True
            if self.problem():
                raise SceneError(self.problem())
            self.refused = False

        def problem(self) -> str:
            """Reason why the display cannot be shown, or an empty string."""
            shape = self.get_shape()
            if shape is not None and shape.shape_type() != int(mi.ShapeType.Rectangle):
                return f"{PLUGIN}: stands on a 'rectangle' only; it is the lens array"
            if self.eia.shape != (*self.display.eia_shape, 3):
                return (
                    f"{PLUGIN}: eia has shape {self.eia.shape}; the display needs "
                    f"{(*self.display.eia_shape, 3)}"
                )
            if shape is not None:
                matrix = mi.traverse(shape)["to_world"].matrix
                # Entry by entry: a kernel is being recorded, and nothing may be computed meanwhile.
                entries = [[float(dr.detach(matrix[i, j])[0]) for j in range(4)] for i in range(4)]
                try:
                    world_from_display(PLUGIN, np.array(entries), self.display)
                except SceneError as error:
                    return str(error)
            return ""

        def can_be_shown(self) -> bool:
            """True if the shape is a valid display.

            The shape is unavailable while a scene loads, so it is checked when the display is first
            rendered. The first check raises for an invalid shape; later it stays black, with a
            warning, because kernels are recorded for all emitters, and this one must not break
            other scenes.
            """
            problem = self.problem()
            if problem and not self.refused:
                self.refused = True
                raise SceneError(problem)
            if problem:
                mi.Log(mi.LogLevel.Warn, f"{problem}; it is black")
            return not problem

        def radiance(self, uv: Any, towards_viewer: Any, active: Any) -> Any:
            """Radiance leaving a point of the rectangle in a world direction."""
            shape = self.get_shape()
            if shape is None or not self.can_be_shown():
                return mi.Spectrum(0.0)
            self.panel.picture = self.eia.array  # with its gradients
            place = shape.eval_parameterization(uv, active=active)
            right, up, depth = (
                dr.dot(dr.normalize(axis), towards_viewer)
                for axis in (place.dp_du, place.dp_dv, place.sh_frame.n)
            )
            steep = depth > 1e-6  # a ray along the array never enters it
            depth = dr.select(steep, depth, 1.0)
            x, y = (dr.fma(2.0, c, -1.0) * h for c, h in zip(uv, self.half_extent, strict=True))
            light = self.panel.radiance_along(x, y, -right / depth, -up / depth, active & steep)
            return self.brightness * light

        def eval(self, si: Any, active: Any = True) -> Any:
            return self.radiance(si.uv, si.to_world(si.wi), active & (si.wi.z > 0))

        def sample_direction(
            self, interaction: Any, sample: Any, active: Any = True
        ) -> tuple[Any, Any]:
            if self.get_shape() is None:
                return dr.zeros(mi.DirectionSample3f), mi.Spectrum(0.0)
            ds = self.get_shape().sample_direction(interaction, sample, active)
            active = active & (dr.dot(ds.d, ds.n) < 0) & (ds.pdf > 0)
            value = self.eval_direction(interaction, ds, active)
            ds.emitter = mi.EmitterPtr(self)
            return ds, dr.select(active, value / ds.pdf, 0.0)

        def pdf_direction(self, interaction: Any, ds: Any, active: Any = True) -> Any:
            if self.get_shape() is None:
                return mi.Float(0.0)
            faces_viewer = active & (dr.dot(ds.d, ds.n) < 0)
            return dr.select(
                faces_viewer, self.get_shape().pdf_direction(interaction, ds, faces_viewer), 0.0
            )

        def eval_direction(self, interaction: Any, ds: Any, active: Any = True) -> Any:
            return self.radiance(ds.uv, -ds.d, active & (dr.dot(ds.d, ds.n) < 0))

        def sample_position(self, time: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
            if self.get_shape() is None:
                return dr.zeros(mi.PositionSample3f), mi.Float(0.0)
            ps = self.get_shape().sample_position(time, sample, active)
            return ps, dr.select(active & (ps.pdf > 0), dr.rcp(ps.pdf), 0.0)

        def sample_wavelengths(self, si: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
            return mi.Color0f(), self.radiance(si.uv, si.wi, active)

        def sample_ray(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any]:
            ps, weight = self.sample_position(time, sample2, active)
            # Cosine and density cancel, but for pi.
            along = mi.Frame3f(ps.n).to_world(mi.warp.square_to_cosine_hemisphere(sample3))
            light = self.radiance(ps.uv, along, active)
            ray = mi.SurfaceInteraction3f(ps, mi.Color0f()).spawn_ray(along)
            return ray, light * (weight * dr.pi)

        def bbox(self) -> Any:
            return self.get_shape().bbox()

        def to_string(self) -> str:
            return f"DisplayEmitter[{self.display.name}]"

    mi.register_emitter(PLUGIN, DisplayEmitter)
