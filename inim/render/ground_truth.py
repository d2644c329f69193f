"""What the renderer knows for certain: the RGB-D picture, the true EIA and the true views."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from inim.display import Display
from inim.display.panel import SUBPIXELS
from inim.display.viewpoint import Viewpoint
from inim.half_buffers import HalfBuffers
from inim.observer import Observer
from inim.render.depth_peeling import Peeled, layer_colours
from inim.render.rays import (
    NonSeparableRays,
    SeparableRays,
    capture_rays,
    eye_rays,
    pickup_rays,
)
from inim.render.scene import FittedScene
from inim.render.sensors import make_sensor
from inim.render.trace import Tracer, mean_light, scene_light, surface
from inim.rgbd import RGBD, Layer, LayeredRGBD

__all__ = ["capture", "capture_halves", "capture_layers", "pickup", "true_view"]


def capture(
    fitted: FittedScene,
    display: Display,
    *,
    pixels_per_pitch: int,
    spp: int,
    seed: int,
    observer: Observer | None = None,
) -> RGBD:
    """Colour by path tracing, depth and coverage by rays at pixel centres; depth never filtered."""
    camera = _Camera.of(fitted, display, pixels_per_pitch)
    tracer = _tracer(fitted, camera.sensor, seed, observer)
    return camera.picture(fitted, mean_light(tracer, spp), observer)


def capture_halves(
    fitted: FittedScene,
    display: Display,
    *,
    pixels_per_pitch: int,
    spp: int,
    seed: int,
    skip: bool = True,
    observer: Observer | None = None,
) -> tuple[RGBD, RGBD]:
    """As `capture`, by two independent halves of the samples; depth is the same in both.

    `skip`: see `pickup`.
    """
    camera = _Camera.of(fitted, display, pixels_per_pitch)
    halves = _half_buffers(fitted, camera.rays, camera.sensor, spp, seed, skip, observer)
    first = camera.picture(fitted, halves.first, observer)
    return first, replace(first, color=halves.second)


@dataclass(frozen=True)
class _Camera:
    """The depth camera: parallel rays straight back."""

    rays: SeparableRays
    sensor: Any
    pixel_mm: float

    @classmethod
    def of(cls, fitted: FittedScene, display: Display, pixels_per_pitch: int) -> _Camera:
        rows, columns = display.capture_shape(pixels_per_pitch)
        pixel_mm = display.pitch_mm / pixels_per_pitch
        rays = capture_rays(columns, rows, pixel_mm, fitted.start_mm)
        return cls(rays, make_sensor(rays, fitted.fit.world_from_display), pixel_mm)

    def picture(self, fitted: FittedScene, color: np.ndarray, observer: Observer | None) -> RGBD:
        """Colour with depth and coverage."""
        found = surface(fitted.scene, self.sensor, observer)
        forward = fitted.fit.display_from_world
        with np.errstate(invalid="ignore"):  # rays that meet nothing end at infinity
            depth = found.point @ forward[2, :3] + forward[2, 3]
        depth = np.where(found.covered, depth, 0.0).astype(np.float32)
        return RGBD(color, depth, found.covered, self.pixel_mm)


def capture_layers(
    fitted: FittedScene,
    peeled: Peeled,
    *,
    spp: int,
    seed: int,
    observer: Observer | None = None,
) -> LayeredRGBD:
    """All layers of a peeled scene (`inim.render.depth_peeling`), coloured at `spp` samples each.

    Depth and coverage of the front are those of `capture`; its colour is not mixed with what lies
    beside it.
    """
    color = layer_colours(fitted, peeled, spp=spp, seed=seed, observer=observer)
    covered = peeled.covered
    front = np.where(covered, peeled.front_mm, np.float32(0))
    back = np.where(covered, peeled.back_mm, np.float32(0))
    deeper = [Layer(color[k], front[k], back[k], covered[k]) for k in range(1, len(covered))]
    return LayeredRGBD(color[0], front[0], covered[0], peeled.pixel_mm, back[0], tuple(deeper))


def pickup(
    fitted: FittedScene,
    display: Display,
    *,
    spp: int,
    seed: int,
    skip: bool = True,
    mask: np.ndarray | None = None,
    observer: Observer | None = None,
) -> HalfBuffers:
    """The ground-truth EIA: every panel pixel path traced through its lens centre (Eq. 1).

    Over what shines of the pixel: each colour through a pickup of its own where sub-pixels have
    places of their own, at `spp` samples each. Panel pixels outside the array lie under no lens and
    are black.

    Parameters
    ----------
    skip : bool
        Trace only pixels that may show anything (`inim.render.bounds_culling`): the same bits.
    mask : (rows, columns) bool, optional
        Panel pixels to trace; the others stay black. It changes no bit of those that are traced.
    """
    mask = display.lensed if mask is None else mask & display.lensed
    # Also where a pixel lacks a colour: what is not shown is left out by the panel.
    places = [replace(subpixel, turn=None) for subpixel in SUBPIXELS[display.subpixels]]
    seen = {}
    for place in dict.fromkeys(places):
        rays = pickup_rays(display, fitted.start_mm, place)
        sensor = make_sensor(rays, fitted.fit.world_from_display)
        seen[place] = _half_buffers(fitted, rays, sensor, spp, seed, skip, observer, mask=mask)

    def colours(half: str) -> np.ndarray:
        """Red of the first colour's pickup, green of the second's, blue of the third's."""
        each = [getattr(seen[place], half)[..., channel] for channel, place in enumerate(places)]
        return np.stack(each, axis=-1)

    return HalfBuffers(colours("first"), colours("second"))


def true_view(
    fitted: FittedScene,
    display: Display,
    viewpoint: Viewpoint,
    *,
    pixels_per_lens: int,
    spp: int,
    seed: int,
    skip: bool = True,
    observer: Observer | None = None,
) -> tuple[HalfBuffers, np.ndarray]:
    """The scene itself from an eye, through the window of the array; and where the relic is.

    `skip`: see `pickup`.
    """
    rays = eye_rays(display, viewpoint, pixels_per_lens, fitted.start_mm)
    sensor = make_sensor(rays, fitted.fit.world_from_display)
    truth = _half_buffers(fitted, rays, sensor, spp, seed, skip, observer)
    return truth, surface(fitted.scene, sensor, observer).covered


def _tracer(fitted: FittedScene, sensor: Any, seed: int, observer: Observer | None) -> Tracer:
    light = scene_light(fitted.scene, fitted.integrator)
    return Tracer(light, sensor, seed, observer)


def _half_buffers(
    fitted: FittedScene,
    rays: SeparableRays | NonSeparableRays,
    sensor: Any,
    spp: int,
    seed: int,
    skip: bool,
    observer: Observer | None,
    mask: np.ndarray | None = None,
) -> HalfBuffers:
    if skip:
        visible = fitted.bounds.visible_pixels(rays)
        mask = visible if mask is None else mask & visible
    halves = [
        mean_light(_tracer(fitted, sensor, 2 * seed + half, observer), max(1, spp // 2), mask)
        for half in (0, 1)
    ]
    return HalfBuffers(halves[0], halves[1])
