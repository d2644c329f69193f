"""`inim_display`: the panel behind its lens array, as an area emitter on a rectangle.

Radiance depends on where and in which direction a ray leaves the array, so any stock camera and
integrator sees the display as an eye would. The world of such a scene is the display frame: the
rectangle lies in z = 0, scaled by half the array's size, and faces +z.

The array is one shape and the lens is analytic: thousands of instances hang the renderer, and
its spawned rays would move by most of a display pixel.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from inim.display import Display
from inim.display.pixels import SUBPIXELS, shining
from inim.lens import (
    LensArray,
    LensTraits,
    Ops,
    channel_indices,
    lens_array,
    lens_traits,
    through_array,
)
from inim.lens import lens_model as find_lens_model

__all__ = ["LensedPanel", "display_shape", "register"]


def display_shape(eia: np.ndarray, display: Display, lens_model: str) -> dict[str, Any]:
    """The scene dictionary of a display showing an EIA.

    Parameters
    ----------
    eia : (rows, columns, 3) float32
        Linear RGB, row 0 on top.
    display : Display
    lens_model : str
        One of `inim.lens.lens_models` that is no mesh.
    """
    half_x, half_y = _half_extent_mm(display)
    return {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().scale([half_x, half_y, 1]),
        "emitter": {
            "type": "inim_display",
            "eia": mi.TensorXf(np.ascontiguousarray(eia, np.float32)),
            **_parameters(display, lens_model),
        },
    }


def _parameters(display: Display, lens_model: str) -> dict[str, Any]:
    """The plugin's parameters: numbers, words and flags, as scene files have them."""
    indices = channel_indices(display)
    # What a display does not have is not compiled: one index for all colours means one ray.
    colored = len(set(indices)) > 1 and find_lens_model(lens_model).refracts
    patterned = display.subpixels != "none" or display.pixel_fill < 1
    return {
        "pixel_mm": display.pixel_pitch_mm,
        "pixel_fill": display.pixel_fill,
        "subpixels": display.subpixels if patterned else "",
        "lens_model": lens_model,
        "colored": colored,
        **{f"index_{name}": n for name, n in zip("rgb", indices, strict=True)},
        **{f"array_{name}": value for name, value in lens_array(display)._asdict().items()},
        **{f"trait_{name}": value for name, value in lens_traits(display)._asdict().items()},
    }


def _half_extent_mm(display: Display) -> tuple[float, float]:
    """Half the width and height, about the panel's centre, that hold the array as it lies."""
    array = lens_array(display)
    c, s = abs(array.cosine), abs(array.sine)
    half_x, half_y = display.width_mm / 2, display.height_mm / 2
    return c * half_x + s * half_y + abs(array.shift_x), c * half_y + s * half_x + abs(
        array.shift_y
    )


_OPS = Ops(dr.sqrt, dr.floor, dr.select, dr.abs)


class LensedPanel:
    """A panel behind its lens array: what leaves the array, in Dr.Jit.

    Parameters
    ----------
    eia : (rows, columns, 3) tensor
    parameters : mapping
        The plugin's, as `display_shape` gives them.
    """

    def __init__(self, eia: Any, parameters: Any) -> None:
        self._set_up(eia.shape, parameters)
        self.picture = mi.Float(eia.array)

    def _set_up(self, shape: tuple[int, ...], parameters: Any) -> None:
        self.rows = dr.opaque(mi.Float, shape[0])
        self.columns = dr.opaque(mi.Float, shape[1])
        self.pixel_mm = dr.opaque(mi.Float, parameters["pixel_mm"])
        self.fill = dr.opaque(mi.Float, parameters["pixel_fill"])
        self.subpixels = SUBPIXELS[parameters["subpixels"]] if parameters["subpixels"] else None
        self.trace = find_lens_model(parameters["lens_model"]).function
        # Run-time values: a literal would compile the kernel anew for every display.
        self.indices = [dr.opaque(mi.Float, parameters[f"index_{name}"]) for name in "rgb"]
        if not parameters["colored"]:
            self.indices = self.indices[:1]
        self.array = LensArray(
            *(dr.opaque(mi.Float, parameters[f"array_{name}"]) for name in LensArray._fields)
        )
        self.traits = LensTraits(*(parameters[f"trait_{name}"] for name in LensTraits._fields))

    @classmethod
    def of(cls, eia: np.ndarray, display: Display, lens_model: str) -> LensedPanel:
        """As `display_shape`, without a plugin, a shape or a scene."""
        tensor = mi.TensorXf(np.ascontiguousarray(eia, np.float32))
        return cls(tensor, _parameters(display, lens_model))

    @classmethod
    def dark(cls, display: Display, lens_model: str) -> LensedPanel:
        """A panel without a picture: where light would come from."""
        panel = object.__new__(cls)
        panel._set_up(display.eia_shape, _parameters(display, lens_model))
        return panel

    def leaving(self, x: Any, y: Any, sx: Any, sy: Any, lit: Any = True) -> Any:
        """Radiance along display-frame rays that cross z = 0 at (x, y) with slopes (sx, sy)."""
        landings = self.landings(x, y, sx, sy, lit)
        if len(landings) == 1:
            place, weight, lit = landings[0]
            color = dr.gather(mi.Color3f, self.picture, place, lit)
            return mi.Spectrum(color * weight) & lit
        color = mi.Color3f(0.0)
        for channel, (place, weight, shown) in enumerate(landings):
            value = dr.gather(mi.Float, self.picture, 3 * place + channel, shown)
            color[channel] = dr.select(shown, value * weight, 0.0)
        return mi.Spectrum(color)

    def landings(
        self, x: Any, y: Any, sx: Any, sy: Any, lit: Any = True
    ) -> list[tuple[Any, Any, Any]]:
        """Where rays come from on the panel, as of `pixel`: once, or for red, green and blue."""
        # Red stands for all colours where nothing tells them apart.
        rays = [
            through_array(self.trace, self.array, self.traits, _OPS, x, y, sx, sy, index)
            for index in self.indices
        ]
        if len(rays) == 1 and self.subpixels is None:
            return [self.pixel(*rays[0], lit)]
        return [self.pixel(*rays[c % len(rays)], lit, c) for c in range(3)]

    def pixel(
        self, x: Any, y: Any, weight: Any, lit: Any, channel: int = 0
    ) -> tuple[Any, Any, Any]:
        """Flat index of the pixel under a panel point, the light it sends, whether any."""
        across = x / self.pixel_mm + 0.5 * self.columns
        along = 0.5 * self.rows - y / self.pixel_mm  # row 0 is the top
        column, row = dr.floor(across), dr.floor(along)
        lit = lit & (weight > 0)
        lit &= (column >= 0) & (column < self.columns) & (row >= 0) & (row < self.rows)
        place = mi.UInt32(dr.select(lit, row * self.columns + column, 0.0))
        if self.subpixels is not None:
            turn = mi.UInt32(dr.select(lit, row + column, 0.0)) & 1
            weight = weight * shining(
                self.subpixels[channel], self.fill, dr.select,
                across - column - 0.5, along - row - 0.5, turn,
            )  # fmt: skip
        return place, weight, lit


def register() -> None:
    """Define and register the class anew: plugins belong to the variant they were made in."""

    class DisplayEmitter(mi.Emitter):  # type: ignore[misc]
        """See the module's text."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.panel = LensedPanel(props["eia"], props)
            self.m_needs_sample_2 = True
            self.m_needs_sample_3 = True
            self.m_flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying

        def radiance(self, point: Any, towards_viewer: Any, active: Any) -> Any:
            """Radiance leaving a point of the array in a direction, both in the display frame."""
            steep = towards_viewer.z > 1e-6  # a ray along the array never enters it
            depth = dr.select(steep, towards_viewer.z, 1.0)
            sx, sy = -towards_viewer.x / depth, -towards_viewer.y / depth
            return self.panel.leaving(point.x, point.y, sx, sy, active & steep)

        def eval(self, si: Any, active: Any = True) -> Any:
            return self.radiance(si.p, si.to_world(si.wi), active & (si.wi.z > 0))

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
            ds = self.get_shape().sample_direction(it, sample, active)
            active = active & (dr.dot(ds.d, ds.n) < 0) & (ds.pdf > 0)
            value = self.eval_direction(it, ds, active)
            ds.emitter = mi.EmitterPtr(self)
            return ds, dr.select(active, value / ds.pdf, 0.0)

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            seen = active & (dr.dot(ds.d, ds.n) < 0)
            return dr.select(seen, self.get_shape().pdf_direction(it, ds, seen), 0.0)

        def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return self.radiance(ds.p, -ds.d, active & (dr.dot(ds.d, ds.n) < 0))

        def to_string(self) -> str:
            return "DisplayEmitter"

    mi.register_emitter("inim_display", DisplayEmitter)
