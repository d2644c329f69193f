"""Tracing a sensor's rays in passes of bounded memory.

Mitsuba's own pass splitting raises memory and fails when the sample count does not divide, so the
passes are planned here: each traces a wavefront of whole pixels, averages their samples on the
device in float32 (at most a few dozen values) and adds the result up in float64.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

__all__ = ["Clock", "Light", "Progress", "Surface", "mean_light", "radiance", "surface"]

# Rays in flight: a path tracer's state is roughly 300 bytes a ray, so this is about 1.3 GB at
# most; larger gains nothing on two cores.
_RAYS_PER_PASS = 2**22

Progress = Callable[[int], None]
#: What a sensor's ray brings: (sensor, pixel, place within it, point of the pupil, sampler) to
#: three channels.
Light = Callable[[Any, Any, Any, Any, Any], Any]


@dataclass
class Clock:
    """Seconds spent inside the renderer, summed over calls."""

    seconds: float = 0.0


def radiance(
    scene: Any,
    integrator: Any,
    sensor: Any,
    *,
    spp: int,
    seed: int,
    clock: Clock | None = None,
    progress: Progress | None = None,
) -> np.ndarray:
    """Mean radiance of a Mitsuba scene in each film pixel; see `mean_light`."""

    def light(sensor: Any, pixel: Any, within: Any, pupil: Any, sampler: Any) -> Any:
        ray = sensor.rays_through(pixel, within, pupil)
        return integrator.sample(scene, sampler, mi.RayDifferential3f(ray))[0]

    return mean_light(light, sensor, spp=spp, seed=seed, clock=clock, progress=progress)


def mean_light(
    light: Light,
    sensor: Any,
    *,
    spp: int,
    seed: int,
    clock: Clock | None = None,
    progress: Progress | None = None,
) -> np.ndarray:
    """Mean of what a sensor's rays bring to each film pixel, a box filter over its area.

    Parameters
    ----------
    light : callable
        Traced once for each pass; Dr.Jit compiles it once.
    sensor :
        One of `inim.kernel.sensors`.
    spp : int
        Samples per pixel.
    seed : int
        Passes derive their own seeds from it: equal seeds give equal pictures.
    clock : Clock, optional
        Adds the time spent here.
    progress : callable, optional
        Called with the number of rays finished.

    Returns
    -------
    (rows, columns, 3) float32, linear RGB. Not-a-number samples are kept: the caller counts them.
    """
    started = time.perf_counter()
    columns, rows = (int(n) for n in sensor.film().size())
    total = np.zeros((rows * columns, 3))
    for first, pixels, first_sample, samples in _passes(rows * columns, spp):
        pass_seed = _pass_seed(seed, first, first_sample)
        total[first : first + pixels] += (
            _trace_pass(light, sensor, columns, first, pixels, samples, pass_seed) * samples
        )
        if progress:
            progress(pixels * samples)
    if clock:
        clock.seconds += time.perf_counter() - started
    return (total / spp).astype(np.float32).reshape(rows, columns, 3)


def _passes(pixels: int, spp: int) -> list[tuple[int, int, int, int]]:
    """(first pixel, pixels, first sample, samples) of each pass, within `_RAYS_PER_PASS`."""
    samples = min(spp, _RAYS_PER_PASS)
    per_pass = min(pixels, max(1, _RAYS_PER_PASS // samples))
    return [
        (first, min(per_pass, pixels - first), sample, min(samples, spp - sample))
        for first in range(0, pixels, per_pass)
        for sample in range(0, spp, samples)
    ]


def _pass_seed(*parts: int) -> int:
    return int(np.random.SeedSequence(parts).generate_state(1)[0])


def _trace_pass(
    light: Light,
    sensor: Any,
    columns: int,
    first: int,
    pixels: int,
    samples: int,
    seed: int,
) -> np.ndarray:
    """Mean over the samples of each pixel, (pixels, 3) float64; one compiled kernel for all."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, pixels * samples)
    lane = dr.arange(mi.UInt32, pixels * samples)
    index = lane // dr.opaque(mi.UInt32, samples) + dr.opaque(mi.UInt32, first)
    width = dr.opaque(mi.UInt32, columns)
    pixel = mi.Point2u(index % width, index // width)
    within, pupil = sampler.next_2d(), None
    if sensor.has_pupil:
        pupil = mi.warp.square_to_uniform_disk_concentric(sampler.next_2d())
    color = light(sensor, pixel, within, pupil, sampler)
    dr.eval(color)
    # Summing outside the kernel keeps the sample count out of it: no compilation per setting.
    mean = [np.asarray(dr.block_sum(channel, samples), np.float64) for channel in color]
    return np.stack(mean, axis=-1) / samples


@dataclass(frozen=True)
class Surface:
    """What the rays through pixel centres meet.

    Attributes
    ----------
    covered : (rows, columns) bool
        Whether there is a surface that is not a light.
    distance : (rows, columns) float64
        World distance from the ray's start; infinite where not covered.
    origin, direction : (rows, columns, 3) float64
        World rays, in the float32 that was traced.
    """

    covered: np.ndarray
    distance: np.ndarray
    origin: np.ndarray
    direction: np.ndarray

    @property
    def point(self) -> np.ndarray:
        """World points (rows, columns, 3); not finite where not covered."""
        points: np.ndarray = self.origin + self.distance[..., None] * self.direction
        return points


def surface(scene: Any, sensor: Any, clock: Clock | None = None) -> Surface:
    """First surface on the ray through each pixel's centre, past any light."""
    started = time.perf_counter()
    columns, rows = (int(n) for n in sensor.film().size())
    lane = dr.arange(mi.UInt32, rows * columns)
    width = dr.opaque(mi.UInt32, columns)
    ray = sensor.rays_through(mi.Point2u(lane % width, lane // width), mi.Point2f(0.5))
    hit = _first_not_light(scene, ray)
    distance = dr.select(hit.is_valid(), hit.t, dr.inf)
    shape = (rows, columns)
    found = Surface(
        covered=np.asarray(hit.is_valid()).reshape(shape),
        distance=np.asarray(distance, np.float64).reshape(shape),
        origin=np.stack([np.asarray(c, np.float64).reshape(shape) for c in ray.o], -1),
        direction=np.stack([np.asarray(c, np.float64).reshape(shape) for c in ray.d], -1),
    )
    if clock:
        clock.seconds += time.perf_counter() - started
    return found


def _first_not_light(scene: Any, ray: Any) -> Any:
    """Nearest hit that is no light. Lights are hidden from cameras here as in the colour."""
    hit = scene.ray_intersect_preliminary(ray)
    start = mi.Float(0.0)
    emitters = sum(shape.is_emitter() for shape in scene.shapes())
    for _ in range(emitters):  # a ray can pass each light once at most
        light = hit.is_valid() & hit.shape.is_emitter()
        if not dr.any(light):
            break
        start = dr.select(light, start + hit.t * (1 + 1e-5), start)
        onward = mi.Ray3f(ray.o + start * ray.d, ray.d)
        again = scene.ray_intersect_preliminary(onward, active=light)
        again.t += start
        hit = dr.select(light, again, hit)
    return hit
