"""Ground truth by the renderer: the RGB-D picture, the ground-truth EIA and views."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from inim.display import Display
from inim.display.pixels import SUBPIXELS
from inim.display.viewpoint import Viewpoint
from inim.image.noisy_image import NoisyImage
from inim.image.rgbd import RGBD, Layer, LayeredRGBD
from inim.process.observer import Observer
from inim.render import splats
from inim.render.depth_peeling import MOST_LAYERS, Peeled
from inim.render.rays import (
    NonSeparableRays,
    SeparableRays,
    capture_rays,
    eye_rays,
    pickup_rays,
)
from inim.render.scene import FittedScene
from inim.render.sensors import make_sensor
from inim.render.sides import side_light
from inim.render.trace import Tracer, centre_rays, mean_light, scene_light, surface


def capture(
    fitted: FittedScene,
    display: Display,
    *,
    pixels_per_pitch: float,
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
    pixels_per_pitch: float,
    spp: int,
    seed: int,
    skip: bool = True,
    observer: Observer | None = None,
) -> tuple[RGBD, RGBD]:
    """Capture two independent halves of the samples, as `capture`; depth is equal in both.

    `skip`: see `pickup`.
    """
    camera = _Camera.of(fitted, display, pixels_per_pitch)
    halves = _rendered(fitted, camera.rays, camera.sensor, spp, seed, skip, observer)
    first = camera.picture(fitted, halves.first, observer)
    return first, replace(first, color=halves.second)


@dataclass(frozen=True)
class _Camera:
    """The depth camera: parallel rays straight back."""

    rays: SeparableRays
    sensor: Any
    pixel_mm: float

    @classmethod
    def of(cls, fitted: FittedScene, display: Display, pixels_per_pitch: float) -> _Camera:
        rays = capture_rays(display, pixels_per_pitch, fitted.start_mm)
        sensor = make_sensor(rays, fitted.fit.world_from_display)
        return cls(rays, sensor, rays.x.place_step_mm)

    def picture(self, fitted: FittedScene, color: np.ndarray, observer: Observer | None) -> RGBD:
        """Colour with depth and coverage."""
        surfaces = surface(fitted.scene, fitted.integrator, self.sensor, observer)
        forward = fitted.fit.display_from_world
        with np.errstate(invalid="ignore"):  # rays that meet nothing end at infinity
            depth = surfaces.point @ forward[2, :3] + forward[2, 3]
        depth = np.where(surfaces.covered, depth, 0.0).astype(np.float32)
        return RGBD(color, depth, surfaces.covered, self.pixel_mm)


def capture_absorption(
    fitted: FittedScene, display: Display, *, pixels_per_pitch: float
) -> tuple[splats.Absorption, float]:
    """Depths of light absorption in splats along the rays of `capture`, and display mm per world
    unit.
    """
    camera = _Camera.of(fitted, display, pixels_per_pitch)
    lost = splats.absorption(fitted.scene, fitted.integrator, centre_rays(camera.sensor))
    # The rays are parallel to the display's axis.
    return lost, 1 / float(np.linalg.norm(fitted.fit.world_from_display[:3, 2]))


def capture_layers(
    fitted: FittedScene,
    peeled: Peeled,
    *,
    spp: int,
    seed: int,
    observer: Observer | None = None,
) -> LayeredRGBD:
    """Colour all layers of a peeled scene (`inim.render.depth_peeling`) with `spp` samples each.

    Depth and coverage of the front are those of `capture`; its colour is not mixed with its
    surroundings. A solid with a side (`inim.render.sides`) is a sheet, and the pieces of its
    side are separate layers behind it.
    """
    solids, sides = peeled.covered, peeled.sides
    first = np.zeros(solids.shape, np.int64)
    np.add.at(first, (sides.solid, sides.row, sides.column), 1)
    first = np.arange(len(solids))[:, None, None] + first.cumsum(axis=0) - first
    layer = sides.solid + 1 + sides.order
    layers = 1 + max(first[solids].max(initial=0), layer.max(initial=0))

    def stacked(of_solids: np.ndarray, of_pieces: np.ndarray | bool) -> np.ndarray:
        """(layers, rows, columns, ...): each solid, and behind it the pieces of its side."""
        values = np.zeros((layers, *of_solids.shape[1:]), of_solids.dtype)
        _, row, column = np.nonzero(solids)
        values[first[solids], row, column] = of_solids[solids]
        values[layer, sides.row, sides.column] = of_pieces
        return values

    light, has_samples = _side_colours(fitted, peeled, spp, seed, observer)
    color = stacked(_layer_colours(fitted, peeled, spp, seed, observer), light)
    covered, front = stacked(solids, True), stacked(peeled.front_mm, sides.front_mm)
    ends, top = peeled.back_mm.copy(), sides.is_first
    ends[sides.solid[top], sides.row[top], sides.column[top]] = sides.front_mm[top]
    back = stacked(ends, sides.back_mm)
    unseen = covered & ~stacked(solids, has_samples)
    for k in range(1, layers):  # what no ray comes to looks like what is before it
        color[k][unseen[k]] = color[k - 1][unseen[k]]
    deeper = [Layer(color[k], front[k], back[k], covered[k]) for k in range(1, layers)]
    return LayeredRGBD(color[0], front[0], covered[0], peeled.pixel_mm, back[0], tuple(deeper))


def _layer_colours(
    fitted: FittedScene, peeled: Peeled, spp: int, seed: int, observer: Observer | None
) -> np.ndarray:
    """Light of each layer towards the viewer, with the layers in front removed.

    (layers, rows, columns, 3) float32, linear RGB, black without a layer.

    Samples cover a pixel, or, if wider, the area that a quarter of a panel pixel sees. They count
    only on the surface at the pixel's centre: a sample that would meet another surface is taken
    at the centre instead.
    """
    sensor = make_sensor(peeled.rays, fitted.fit.world_from_display)
    colours = np.zeros((*peeled.front_mm.shape, 3), np.float32)
    for layer, covered in enumerate(peeled.covered):
        if not covered.any():
            continue
        tracer = Tracer(
            _layer_light(fitted, sensor, peeled, layer),
            _Row(int(np.count_nonzero(covered))),
            int(np.random.SeedSequence((seed, layer)).generate_state(1)[0]),
            observer,
        )
        colours[layer][covered] = mean_light(tracer, spp)[0]
    return colours


def _side_colours(
    fitted: FittedScene, peeled: Peeled, spp: int, seed: int, observer: Observer | None
) -> tuple[np.ndarray, np.ndarray]:
    """Light of each piece of a side, (pieces, 3) float32, and whether it has any sample.

    The mean over the rays that reach it: the walls between its pixel and the neighbours are
    weighted by the number of rays that cross them.
    """
    sides = peeled.sides
    color, weight = np.zeros((2, len(sides.row), 3))
    if not len(sides.row):
        return color, weight[:, 0] > 0
    sensor = make_sensor(peeled.rays, fitted.fit.world_from_display)
    light_of = side_light(fitted, sensor, peeled.rays, sides)
    row, own = _Row(len(sides.walls)), np.random.SeedSequence((seed, MOST_LAYERS))
    piece, beside = sides.walls.T
    share = np.asarray(sides.slopes)[beside // 2] * (sides.high_mm - sides.low_mm)[piece, beside]
    for seen_only, sums in ((False, color), (True, weight)):
        tracer = Tracer(light_of(seen_only), row, int(own.generate_state(1)[0]), observer)
        np.add.at(sums, piece, mean_light(tracer, spp)[0] * share[:, None])
    return np.divide(color, weight, out=color, where=weight > 0), weight[:, 0] > 0


@dataclass(frozen=True)
class _Row:
    """A sensor for `Tracer` whose film is one row of all pixels that a layer covers."""

    pixels: int
    has_pupil: bool = False

    def film(self) -> _Row:
        return self

    def size(self) -> tuple[int, int]:
        return self.pixels, 1


def _layer_light(fitted: FittedScene, sensor: Any, peeled: Peeled, layer: int) -> Any:
    """Light of samples of one layer's pixels; see `inim.render.trace.Light`."""
    covered = peeled.covered[layer]
    rows, columns = (mi.UInt32(places.astype(np.uint32)) for places in np.nonzero(covered))

    def table(kind: Any, values: np.ndarray) -> Any:
        return kind(values[layer][covered])

    near, far = table(mi.Float, peeled.near), table(mi.Float, peeled.far)
    facing, spread = table(mi.Bool, peeled.facing), table(mi.Float, peeled.spread)

    def light(_row: _Row, pixel: Any, within: Any, _pupil: Any, sampler: Any) -> Any:
        index = pixel.x
        place = mi.Point2u(dr.gather(mi.UInt32, columns, index), dr.gather(mi.UInt32, rows, index))
        begin, end = dr.gather(mi.Float, near, index), dr.gather(mi.Float, far, index)

        def ray(within: Any) -> Any:
            ray_sample = sensor.rays_through(place, within)
            return mi.Ray3f(ray_sample.o + begin * ray_sample.d, ray_sample.d)

        spread_ray = ray((within - 0.5) * dr.gather(mi.Float, spread, index) + 0.5)
        if fitted.shows_splats:
            return splats.radiance(fitted.scene, fitted.integrator, sampler, spread_ray)
        hit = fitted.scene.ray_intersect(spread_ray)
        same = hit.is_valid() & (begin + hit.t <= end) & ~hit.shape.is_emitter()
        same &= (dr.dot(hit.n, spread_ray.d) < 0) == dr.gather(mi.Bool, facing, index)
        chosen_ray = dr.select(same, spread_ray, ray(mi.Point2f(0.5)))
        return fitted.integrator.sample(fitted.scene, sampler, mi.RayDifferential3f(chosen_ray))[0]

    return light


def pickup(
    fitted: FittedScene,
    display: Display,
    *,
    spp: int,
    seed: int,
    skip: bool = True,
    mask: np.ndarray | None = None,
    observer: Observer | None = None,
) -> NoisyImage:
    """Render the ground-truth EIA: every panel pixel path traced through its lens centre (Eq. 1).

    Samples cover the emitting area of the pixel. With sub-pixels, each colour has a separate pickup
    with `spp` samples. Panel pixels outside the array have no lens and are black.

    Parameters
    ----------
    skip : bool
        Trace only pixels that can be non-black (`inim.render.culling`): the same bits.
    mask : (rows, columns) bool, optional
        Panel pixels to trace; the others stay black. It does not change the traced pixels.
    """
    mask = display.lensed if mask is None else mask & display.lensed
    # Also where a pixel lacks a colour: what is not shown is left out by the panel.
    places = [replace(subpixel, turn=None) for subpixel in SUBPIXELS[display.subpixels]]
    pickups = {}
    for place in dict.fromkeys(places):
        rays = pickup_rays(display, fitted.start_mm, place)
        sensor = make_sensor(rays, fitted.fit.world_from_display)
        pickups[place] = _rendered(fitted, rays, sensor, spp, seed, skip, observer, mask=mask)

    def colours(half: str) -> np.ndarray:
        """Red of the first colour's pickup, green of the second's, blue of the third's."""
        channels = [
            getattr(pickups[place], half)[..., channel] for channel, place in enumerate(places)
        ]
        return np.stack(channels, axis=-1)

    return NoisyImage.from_halves(colours("first"), colours("second"))


def true_view(
    fitted: FittedScene,
    display: Display,
    viewpoint: Viewpoint,
    *,
    pixels_per_lens: int | tuple[float, float],
    spp: int,
    seed: int,
    skip: bool = True,
    observer: Observer | None = None,
) -> tuple[NoisyImage, np.ndarray]:
    """The scene itself from an eye, through the window of the array; and where the relic is.

    `skip`: see `pickup`; `pixels_per_lens`: see `eye_rays`.
    """
    rays = eye_rays(display, viewpoint, pixels_per_lens, fitted.start_mm)
    sensor = make_sensor(rays, fitted.fit.world_from_display)
    truth = _rendered(fitted, rays, sensor, spp, seed, skip, observer)
    return truth, surface(fitted.scene, fitted.integrator, sensor, observer).covered


def _tracer(fitted: FittedScene, sensor: Any, seed: int, observer: Observer | None) -> Tracer:
    light = scene_light(fitted.scene, fitted.integrator)
    return Tracer(light, sensor, seed, observer)


def _rendered(
    fitted: FittedScene,
    rays: SeparableRays | NonSeparableRays,
    sensor: Any,
    spp: int,
    seed: int,
    skip: bool,
    observer: Observer | None,
    mask: np.ndarray | None = None,
) -> NoisyImage:
    if skip:
        visible = fitted.bounds.visible_pixels(rays)
        mask = visible if mask is None else mask & visible
    halves = [
        mean_light(_tracer(fitted, sensor, 2 * seed + half, observer), max(1, spp // 2), mask)
        for half in (0, 1)
    ]
    return NoisyImage.from_halves(halves[0], halves[1])
