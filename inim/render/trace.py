"""Tracing a sensor's rays in passes of bounded memory.

Mitsuba's own pass splitting raises memory and fails when the sample count does not divide, so the
passes are planned here: each traces a wavefront of samples, adds up those of a pixel on the device
in float32 (at most a few dozen values) and goes into float64 sums. Random numbers are counter-based
(`inim.render.counter_sampler`), so passes may hold any pixels in any order.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from inim.process.observer import Observer
from inim.render import splats
from inim.render.counter_sampler import PLUGIN

# Rays in flight, at most; see `limit_rays`. Larger gains nothing on two cores.
_RAYS_PER_PASS = 2**22
# Pixels whose float64 sums are held at once.
_PIXELS_PER_BAND = 2**20

#: What a sensor's ray brings: (sensor, pixel, place within it, point of the pupil, sampler) to
#: three channels.
Light = Callable[[Any, Any, Any, Any, Any], Any]


def limit_rays(count: int) -> None:
    """Limit the number of simultaneous rays in this process, according to its memory."""
    global _RAYS_PER_PASS
    _RAYS_PER_PASS = count


def scene_light(scene: Any, integrator: Any) -> Light:
    """Function that returns the light of a sensor's rays in a Mitsuba scene."""

    def light(sensor: Any, pixel: Any, within: Any, pupil: Any, sampler: Any) -> Any:
        ray = sensor.rays_through(pixel, within, pupil)
        return splats.radiance(scene, integrator, sampler, ray)

    return light


@dataclass(frozen=True)
class Tracer:
    """Traces samples of a sensor's pixels, any of them.

    Parameters
    ----------
    light : callable
        Traced once for each pass; Dr.Jit compiles it once.
    sensor :
        One of `inim.render.sensors`.
    seed : int
    observer : Observer, optional
        Counts time and samples.
    """

    light: Light
    sensor: Any
    seed: int
    observer: Observer | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the film."""
        columns, rows = (int(n) for n in self.sensor.film().size())
        return rows, columns

    def means(self, pixels: np.ndarray, samples: int) -> np.ndarray:
        """Means over the first samples of pixels, box filters over their areas.

        Not-a-number samples are kept: the caller counts them.

        Parameters
        ----------
        pixels : (n,) int array
            Flat film indices.
        samples : int

        Returns
        -------
        (n, 3) float64, linear RGB
        """
        started = time.perf_counter()
        total = np.zeros((len(pixels), 3))
        for part, first, sample_count in _passes(len(pixels), samples):
            color = self._wavefront(pixels[part], first, sample_count)
            # Summing outside the kernel keeps the count out of it: no compilation per setting.
            total[part] += np.stack([np.asarray(dr.block_sum(c, sample_count)) for c in color], -1)
        if self.observer:
            self.observer.rendered(time.perf_counter() - started, len(pixels) * samples)
        mean: np.ndarray = total / samples
        return mean

    def _wavefront(self, pixels: np.ndarray, first: int, samples: int) -> Any:
        """Light of each sample of one pass; one compiled kernel for all passes."""
        lane = dr.arange(mi.UInt32, len(pixels) * samples)
        count = dr.opaque(mi.UInt32, samples)
        entry = lane // count
        index = dr.gather(mi.UInt32, mi.UInt32(np.asarray(pixels, np.uint32)), entry)
        sample = lane - entry * count + dr.opaque(mi.UInt32, first)
        seed = int(np.random.SeedSequence(self.seed).generate_state(1)[0])
        sampler = mi.load_dict({"type": PLUGIN})
        sampler.start(seed, index, sample)
        width = dr.opaque(mi.UInt32, self.shape[1])
        pixel = mi.Point2u(index % width, index // width)
        within, pupil = sampler.next_2d(), None
        if self.sensor.has_pupil:
            pupil = mi.warp.square_to_uniform_disk_concentric(sampler.next_2d())
        color = self.light(self.sensor, pixel, within, pupil, sampler)
        dr.eval(color)
        return color


def mean_light(tracer: Tracer, spp: int, mask: np.ndarray | None = None) -> np.ndarray:
    """Mean light of each film pixel over its area, a box filter.

    Parameters
    ----------
    tracer : Tracer
    spp : int
        Samples per pixel.
    mask : (rows, columns) bool, optional
        Pixels to trace; the others stay black and need no time.

    Returns
    -------
    (rows, columns, 3) float32, linear RGB. Equal seeds give equal pixels for every mask.
    """
    rows, columns = tracer.shape
    image = np.zeros((rows * columns, 3), np.float32)
    for pixels in _bands(rows * columns, mask):
        image[pixels] = tracer.means(pixels, spp)
    return image.reshape(rows, columns, 3)


def _bands(count: int, mask: np.ndarray | None = None) -> Iterator[np.ndarray]:
    """Flat indices of the mask's pixels, in bands small enough for their float64 sums."""
    for first in range(0, count, _PIXELS_PER_BAND):
        last = min(first + _PIXELS_PER_BAND, count)
        if mask is None:
            yield np.arange(first, last)
        elif len(pixels := first + np.flatnonzero(mask.reshape(-1)[first:last])):
            yield pixels


def _passes(pixels: int, samples: int) -> list[tuple[slice, int, int]]:
    """Pixels, first sample and samples of each pass, within `_RAYS_PER_PASS`."""
    samples_per_pass = min(samples, _RAYS_PER_PASS)
    pixels_per_pass = max(1, _RAYS_PER_PASS // samples_per_pass)
    return [
        (
            slice(start, min(start + pixels_per_pass, pixels)),
            first,
            min(samples_per_pass, samples - first),
        )
        for start in range(0, pixels, pixels_per_pass)
        for first in range(0, samples, samples_per_pass)
    ]


@dataclass(frozen=True)
class Surface:
    """Surfaces on the rays through pixel centres.

    Attributes
    ----------
    covered : (rows, columns) bool
        Whether there is a surface that is not a light, or splats that take half of the light.
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


def centre_rays(sensor: Any) -> Any:
    """The rays through the centres of a sensor's pixels, row by row."""
    columns, rows = (int(n) for n in sensor.film().size())
    lane = dr.arange(mi.UInt32, rows * columns)
    width = dr.opaque(mi.UInt32, columns)
    return sensor.rays_through(mi.Point2u(lane % width, lane // width), mi.Point2f(0.5))


def surface(scene: Any, integrator: Any, sensor: Any, observer: Observer | None = None) -> Surface:
    """First surface on the ray through each pixel's centre, past any light; of splats, half."""
    started = time.perf_counter()
    columns, rows = (int(n) for n in sensor.film().size())
    ray = centre_rays(sensor)
    if splats.shows_splats(integrator):
        distance = splats.absorption(scene, integrator, ray).half
    else:
        hit = first_not_light(scene, ray)
        distance = np.asarray(dr.select(hit.is_valid(), hit.t, dr.inf))
    shape = (rows, columns)
    result = Surface(
        covered=np.isfinite(distance).reshape(shape),
        distance=distance.astype(np.float64).reshape(shape),
        origin=np.stack([np.asarray(c, np.float64).reshape(shape) for c in ray.o], -1),
        direction=np.stack([np.asarray(c, np.float64).reshape(shape) for c in ray.d], -1),
    )
    if observer:
        observer.rendered(time.perf_counter() - started)
    return result


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
