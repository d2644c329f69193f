"""Tracing rays in passes of bounded memory.

Mitsuba's own pass splitting raises memory and fails when the sample count does not divide, so the
passes are planned here: each traces a wavefront of samples, adds up those of a pixel on the device
in float32 (at most a few dozen values) and goes into float64 sums. Random numbers are counter-based
(`inim.render.counter_sampler`), so passes may hold any pixels in any order.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from inim.process.observer import Observer
from inim.render import splats
from inim.render.camera import FilmCamera
from inim.render.counter_sampler import PLUGIN

# Rays in flight, at most; see `limit_rays`. Larger gains nothing on two cores.
_RAYS_PER_PASS = 2**22
# Pixels whose float64 sums are held at once.
_PIXELS_PER_BAND = 2**20

#: Function of the flat indices of pixels and a sampler that traces a sample of each pixel and
#: returns three channels of light. Traced once for each pass; Dr.Jit compiles it once.
Light = Callable[[Any, Any], Any]


def limit_rays(count: int) -> None:
    """Limit the number of simultaneous rays in this process, according to its memory."""
    global _RAYS_PER_PASS
    _RAYS_PER_PASS = count


def rays_per_pass() -> int:
    """Maximum number of simultaneous rays in this process."""
    return _RAYS_PER_PASS


def scene_light(scene: Any, integrator: Any, camera: FilmCamera) -> Light:
    """Function that returns the light of a camera's rays in a Mitsuba scene."""

    def light(index: Any, sampler: Any) -> Any:
        ray = camera.rays(*camera.sample(index, sampler))
        return splats.radiance(scene, integrator, sampler, ray)

    return light


def mean_light(
    light: Light,
    shape: tuple[int, ...],
    spp: int,
    seed: int,
    mask: np.ndarray | None = None,
    observer: Observer | None = None,
) -> np.ndarray:
    """Mean light of each pixel over its area, a box filter.

    Not-a-number samples are kept: the caller counts them.

    * `mask`, (*shape) bool: pixels to trace; the others stay black and need no time.

    Returns (*shape, 3) float32, linear RGB. Equal seeds give equal pixels for every mask.
    """
    started, traced = time.perf_counter(), 0
    count = math.prod(shape)
    image = np.zeros((count, 3), np.float32)
    for first in range(0, count, _PIXELS_PER_BAND):
        pixels = np.arange(first, min(first + _PIXELS_PER_BAND, count))
        if mask is not None:
            pixels = pixels[mask.reshape(-1)[pixels]]
        image[pixels] = _sums(light, pixels, spp, seed) / spp
        traced += len(pixels) * spp
    if observer and traced:
        observer.record_rendering(time.perf_counter() - started, traced)
    return image.reshape(*shape, 3)


def _sums(light: Light, pixels: np.ndarray, spp: int, seed: int) -> np.ndarray:
    """Sums of the light of all samples of pixels, (n, 3) float64, in passes."""
    total = np.zeros((len(pixels), 3))
    samples_per_pass = min(spp, _RAYS_PER_PASS)
    pixels_per_pass = max(1, _RAYS_PER_PASS // samples_per_pass)
    for start in range(0, len(pixels), pixels_per_pass):
        part = slice(start, start + pixels_per_pass)
        for first in range(0, spp, samples_per_pass):
            samples = min(samples_per_pass, spp - first)
            color = trace_samples(light, pixels[part], first, samples, seed)
            # Summing outside the kernel keeps the count out of it: no compilation per setting.
            total[part] += np.stack([np.asarray(dr.block_sum(c, samples)) for c in color], -1)
    return total


def trace_samples(light: Light, pixels: np.ndarray, first: int, samples: int, seed: int) -> Any:
    """Result of a function for each sample of one pass; one compiled kernel for all passes.

    Parameters
    ----------
    light : callable
        See `Light`. Its result may be any value that Dr.Jit evaluates.
    pixels : (n,) int
        Flat indices of the pixels.
    first, samples : int
        First sample of each pixel, and their number.
    seed : int

    Returns
    -------
    Values of n * samples lanes, pixel by pixel.
    """
    lane = dr.arange(mi.UInt32, len(pixels) * samples)
    count = dr.opaque(mi.UInt32, samples)
    entry = lane // count
    index = dr.gather(mi.UInt32, mi.UInt32(np.asarray(pixels, np.uint32)), entry)
    sampler = mi.load_dict({"type": PLUGIN})
    seed = int(np.random.SeedSequence(seed).generate_state(1)[0])
    sampler.start(seed, index, lane - entry * count + dr.opaque(mi.UInt32, first))
    color = light(index, sampler)
    dr.eval(color)
    return color


def first_surface(
    scene: Any, integrator: Any, camera: FilmCamera, observer: Observer | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Find the first surface on the ray through each pixel's centre.

    Lights do not count; splats count where they have absorbed half of the light.

    Returned values:
    * `covered`, (rows, columns) bool: pixels with a surface.
    * `points`, (rows, columns, 3) float64: world points; not finite where not covered.
    """
    started = time.perf_counter()
    ray = camera.centre_rays()
    if splats.shows_splats(integrator):
        distance = splats.absorption(scene, integrator, ray).half
    else:
        hit = first_not_light(scene, ray)
        distance = np.asarray(dr.select(hit.is_valid(), hit.t, dr.inf))
    origin, direction = (np.stack(vector, axis=-1, dtype=np.float64) for vector in (ray.o, ray.d))
    with np.errstate(invalid="ignore"):  # infinity times zero
        points = origin + distance.astype(np.float64)[:, None] * direction
    if observer:
        observer.record_rendering(time.perf_counter() - started)
    return np.isfinite(distance).reshape(camera.shape), points.reshape(*camera.shape, 3)


def first_not_light(scene: Any, ray: Any) -> Any:
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
