"""Film camera, and tracing its rays in passes of bounded memory.

The rays of `inim.render.rays` come as float64 tables, so the float32 rays carry one rounding and no
cancellation. The tables are run-time values of a kernel: all cameras with separable rays share one
kernel, and the path tracer is compiled once for all.

Mitsuba's own pass splitting raises memory and fails when the sample count does not divide, so the
passes are planned here: each traces a wavefront of samples, adds up those of a pixel on the device
in float32 (at most a few dozen values) and goes into float64 sums. Random numbers are counter-based
(`inim.render.counter_sampler`), so passes may hold any pixels in any order.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from inim.render import splats
from inim.render.counter_sampler import PLUGIN
from inim.render.library import dr, mi
from inim.render.rays import NonSeparableRays, SeparableRays
from inim.system.process.garbage import no_garbage_collection
from inim.system.process.observer import Observer

# Rays in flight, at most; see `limit_rays`. Larger gains nothing on two cores.
_RAYS_PER_PASS = 2**22
# Embree traces up to 16 successive rays together, and visits the scene's parts in an order that
# depends on all of them. If surfaces meet where a ray hits, as cells of an `sdfgrid` do, the order
# decides which of them is hit. Skipped pixels must therefore not change the packets of the others.
_PACKET = 16
# Pixels whose float64 sums are held at once.
_PIXELS_PER_BAND = 2**20

#: Function of the flat indices of pixels and a sampler that traces a sample of each pixel and
#: returns three channels of light. Traced once for each pass; Dr.Jit compiles it once.
Light = Callable[[Any, Any], Any]


def _value(number: float) -> Any:
    return dr.opaque(mi.Float, float(number))


def _table(numbers: np.ndarray) -> Any:
    return mi.Float(np.asarray(numbers, np.float32).reshape(-1))


class FilmCamera:
    """Camera with the rays of a ray family.

    * `world_from_display`, (4, 4) float64: any invertible affine map. It keeps lines and their
      order, so a picture squeezed into the display's depth range is exact geometry, lit in its own
      world.
    """

    def __init__(
        self, rays: SeparableRays | NonSeparableRays, world_from_display: np.ndarray
    ) -> None:
        self.shape = rays.shape
        self.has_pupil = rays.has_pupil
        self._width = dr.opaque(mi.UInt32, rays.shape[1])
        self._start = _value(rays.start_mm)
        self._is_separable = isinstance(rays, SeparableRays)
        if isinstance(rays, NonSeparableRays):
            self._centres = [_table(rays.x0_mm), _table(rays.y0_mm)]
            self._offsets = [_table(rays.offset_x_mm), _table(rays.offset_y_mm)]
            self._gaps = _table(rays.gap_mm)
            self._steps = [_value(rays.step_x_mm), _value(rays.step_y_mm)]
            self._tilts = [_value(rays.tilt_x), _value(rays.tilt_y)]
            self._along = None
            if rays.along_x or rays.along_y:
                self._along = [_value(rays.along_x), _value(rays.along_y)]
        else:
            axes = (rays.x, rays.y)
            self._places = [_table(axis.place_mm) for axis in axes]
            self._slopes = [_table(axis.slope) for axis in axes]
            self._place_steps = [_value(axis.place_step_mm) for axis in axes]
            self._slope_steps = [_value(axis.slope_step) for axis in axes]
            self._pupil_place = _value(rays.pupil_place_mm)
            self._pupil_slope = _value(rays.pupil_slope)
        self.place(world_from_display)

    def place(self, world_from_display: np.ndarray) -> None:
        """Move the camera: change the map from the display frame to the world."""
        rows = np.asarray(world_from_display, np.float64)[:3]
        self._linear = [[_value(number) for number in row[:3]] for row in rows]
        self._shift = [_value(row[3]) for row in rows]

    def pixel(self, index: Any) -> Any:
        """Column and row of film pixels, Point2u, from their flat indices."""
        return mi.Point2u(index % self._width, index // self._width)

    def lines(
        self, pixel: Any, within: Any, pupil: Any = None, active: Any = True
    ) -> tuple[list[Any], list[Any]]:
        """Rays through film pixels as [x, y] on the start plane and [x, y] slopes.

        * `pixel`, (n,) Point2u: column and row.
        * `within`, (n,) Point2f: position inside the pixel, 0..1, rightwards and downwards.
        * `pupil`, (n,) Point2f: point of the pupil, in the unit disc; its middle if None.
        """
        if not self._is_separable:
            return self._non_separable_lines(pixel, within, active)
        start, run = [], []
        for axis in (0, 1):
            offset = within[axis] - 0.5
            place = dr.gather(mi.Float, self._places[axis], pixel[axis], active)
            slope = dr.gather(mi.Float, self._slopes[axis], pixel[axis], active)
            place = dr.fma(offset, self._place_steps[axis], place)
            slope = dr.fma(offset, self._slope_steps[axis], slope)
            if pupil is not None:
                place = dr.fma(pupil[axis], self._pupil_place, place)
                slope = dr.fma(pupil[axis], self._pupil_slope, slope)
            start.append(place)
            run.append(slope)
        return start, run

    def _non_separable_lines(
        self, pixel: Any, within: Any, active: Any
    ) -> tuple[list[Any], list[Any]]:
        """Rays as `lines`, with an individual lens, position and gap for each pixel."""
        index = dr.fma(pixel.y, self._width, pixel.x)
        moved = [(within[axis] - 0.5) * self._steps[axis] for axis in (0, 1)]
        gap = dr.gather(mi.Float, self._gaps, index, active)
        gap = dr.fma(moved[0], self._tilts[0], dr.fma(moved[1], self._tilts[1], gap))
        start, run = [], []
        for axis in (0, 1):
            offset = dr.gather(mi.Float, self._offsets[axis], index, active)
            centre = dr.gather(mi.Float, self._centres[axis], index, active)
            start_offset = moved[axis] - offset
            if self._along is not None:
                crossing = self._along[axis] * moved[1]
                centre, start_offset = centre + crossing, start_offset - crossing
            slope = start_offset / gap  # away from the viewer, to the panel
            start.append(dr.fma(-slope, self._start, centre))
            run.append(slope)
        return start, run

    def rays(self, pixel: Any, within: Any, pupil: Any = None, active: Any = True) -> Any:
        """World rays through film pixels; see `lines`."""
        return self.world_rays(*self.lines(pixel, within, pupil, active))[0]

    def centre_rays(self, index: Any = None) -> Any:
        """World rays through the centres of the pixels with flat indices; default: all pixels."""
        if index is None:
            index = dr.arange(mi.UInt32, self.shape[0] * self.shape[1])
        return self.rays(self.pixel(index), mi.Point2f(0.5))

    def sample(self, index: Any, sampler: Any) -> tuple[Any, Any, Any]:
        """Arguments of `lines` and `rays` for random points of pixels and of the pupil."""
        within, pupil = sampler.next_2d(), None
        if self.has_pupil:
            pupil = mi.warp.square_to_uniform_disk_concentric(sampler.next_2d())
        return self.pixel(index), within, pupil

    def world_rays(self, start: list[Any], run: list[Any]) -> tuple[Any, Any]:
        """World rays of `lines`, and their lengths per millimetre of depth."""
        place, towards = [*start, self._start], [*run, -1.0]
        origin = [dr.dot(mi.Vector3f(*row), mi.Vector3f(*place)) for row in self._linear]
        along = mi.Vector3f(
            *(dr.dot(mi.Vector3f(*row), mi.Vector3f(*towards)) for row in self._linear)
        )
        ray = mi.Ray3f(
            mi.Point3f(*(o + s for o, s in zip(origin, self._shift, strict=True))),
            dr.normalize(along),
        )
        return ray, dr.norm(along)


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
    first: int = 0,
) -> np.ndarray:
    """Mean light of each pixel over its area, a box filter, (*shape, 3) float32, linear RGB.

    `mask`, (*shape) bool: pixels to trace; the others stay black. Other parameters: `pixel_light`.
    """
    selected = np.ones(math.prod(shape), bool) if mask is None else mask.reshape(-1)
    image = np.zeros((len(selected), 3), np.float32)
    for pixels, means in pixel_light(light, selected, spp, [seed], observer, first):
        image[pixels] = means[0]
    return image.reshape(*shape, 3)


def pixel_light(
    light: Light,
    selected: np.ndarray,
    spp: int,
    seeds: Sequence[int],
    observer: Observer | None = None,
    first: int = 0,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Mean light of some pixels over their area, once for each seed, in bands.

    Not-a-number samples are kept: the caller counts them.

    * `selected`, (n,) bool: pixels to trace. Those in a packet with a selected pixel need time, all
      others need none.
    * `spp`, `first`: number of samples per pixel and seed, and number of samples of the pixel's
      sequence that precede them.

    Yields flat indices of selected pixels, (m,) int, and their light, (seeds, m, 3) float32, linear
    RGB. Equal seeds give equal pixels, whatever the other seeds and the other selected pixels are.
    """
    band = max(1, _PIXELS_PER_BAND // len(seeds) // _PACKET) * _PACKET
    for start in range(0, len(selected), band):
        started, is_selected = time.perf_counter(), selected[start : start + band]
        in_packets = whole_packets(is_selected, spp)
        pixels, is_selected = start + np.flatnonzero(in_packets), is_selected[in_packets]
        if not len(pixels):
            continue
        sums = _sums(light, pixels, spp, seeds, first)[:, is_selected]
        if observer:
            traced = len(pixels) * spp * len(seeds)
            observer.record_rendering(time.perf_counter() - started, traced)
        yield pixels[is_selected], (sums / spp).astype(np.float32)


def whole_packets(is_selected: np.ndarray, spp: int = 1) -> np.ndarray:
    """Pixels whose samples fill all packets with samples of selected pixels, (n,) bool."""
    size = _PACKET // math.gcd(_PACKET, spp)
    groups = np.logical_or.reduceat(is_selected, np.arange(0, len(is_selected), size))
    return np.repeat(groups, size)[: len(is_selected)]


def _sums(
    light: Light, pixels: np.ndarray, spp: int, seeds: Sequence[int], first: int
) -> np.ndarray:
    """Sums of the light of `spp` samples of pixels, (seeds, n, 3) float64, in passes."""
    total = np.zeros((len(seeds), len(pixels), 3))
    packets = max(1, _RAYS_PER_PASS // len(seeds) // _PACKET)  # of every seed
    samples_per_pass = min(spp, packets)
    pixels_per_pass = packets // samples_per_pass * _PACKET
    for start in range(0, len(pixels), pixels_per_pass):
        part = pixels[start : start + pixels_per_pass]
        # The packets of every seed are those of the first.
        padded = np.pad(part, (0, -len(part) % _PACKET), mode="edge")
        for offset in range(0, spp, samples_per_pass):
            samples = min(samples_per_pass, spp - offset)
            color = trace_samples(light, padded, first + offset, samples, *seeds)
            for channel, values in enumerate(color):
                # Summing outside the kernel keeps the count out of it: no compilation per setting.
                sums = np.asarray(dr.block_sum(values, samples)).reshape(len(seeds), -1)
                total[:, start : start + len(part), channel] += sums[:, : len(part)]
    return total


def trace_samples(light: Light, pixels: np.ndarray, first: int, samples: int, *seeds: int) -> Any:
    """Result of a function for each sample of one pass; one compiled kernel for all passes.

    Parameters
    ----------
    light : callable
        See `Light`. Its result may be any value that Dr.Jit evaluates.
    pixels : (n,) int
        Flat indices of the pixels.
    first, samples : int
        First sample of each pixel, and their number.
    *seeds : int
        At least one; each has samples of its own.

    Returns
    -------
    Values of seeds * n * samples lanes, seed by seed and pixel by pixel.
    """
    lane = dr.arange(mi.UInt32, len(seeds) * len(pixels) * samples)
    count, size = dr.opaque(mi.UInt32, samples), dr.opaque(mi.UInt32, len(pixels))
    entry = lane // count
    part = entry // size
    index = dr.gather(mi.UInt32, mi.UInt32(np.asarray(pixels, np.uint32)), entry - part * size)
    keys = [np.random.SeedSequence(seed).generate_state(1)[0] for seed in seeds]
    key = dr.gather(mi.UInt32, mi.UInt32(np.array(keys, np.uint32)), part)
    sampler = mi.load_dict({"type": PLUGIN})
    sampler.start(key, index, lane - entry * count + dr.opaque(mi.UInt32, first))
    # An object of another scene, freed between two calls of a kernel, would make Dr.Jit define the
    # called function twice, and abort.
    with no_garbage_collection():
        color = light(index, sampler)
        dr.eval(color)
    return color


def first_surface(
    scene: Any,
    integrator: Any,
    camera: FilmCamera,
    observer: Observer | None = None,
    mask: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Find the first surface on the ray through each pixel's centre.

    Lights do not count; splats count where they have absorbed half of the light.

    * `mask`, (rows, columns) bool: pixels to trace; the others are not covered.

    Returned values:
    * `covered`, (rows, columns) bool: pixels with a surface.
    * `points`, (n, 3) float64: their world points, row by row.
    """
    started = time.perf_counter()
    is_selected = np.ones(math.prod(camera.shape), bool) if mask is None else mask.reshape(-1)
    if not is_selected.any():  # the renderer has no empty arrays
        return np.zeros(camera.shape, bool), np.empty((0, 3))
    traced = np.flatnonzero(whole_packets(is_selected))
    ray = camera.centre_rays(mi.UInt32(traced.astype(np.uint32)))
    if splats.shows_splats(integrator):
        distance = splats.absorption(scene, integrator, ray).half
    else:
        hit = first_not_light(scene, ray)
        distance = np.asarray(dr.select(hit.is_valid(), hit.t, dr.inf))
    is_hit = np.isfinite(distance) & is_selected[traced]
    origin, direction = (
        np.stack([np.asarray(axis)[is_hit] for axis in vector], axis=-1, dtype=np.float64)
        for vector in (ray.o, ray.d)
    )
    points = origin + distance[is_hit].astype(np.float64)[:, None] * direction
    covered = np.zeros(is_selected.shape, bool)
    covered[traced] = is_hit
    if observer:
        observer.record_rendering(time.perf_counter() - started)
    return covered.reshape(camera.shape), points


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
