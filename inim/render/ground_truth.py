"""Ground truth by the renderer: the RGB-D picture, the ground-truth EIA and views."""

from dataclasses import replace
from typing import Any

import numpy as np

from inim.display import Display
from inim.display.pixels import SUBPIXELS
from inim.display.viewpoint import Viewpoint
from inim.image.noisy_image import REPLICATES, NoisyEIA, NoisyImage, split_samples
from inim.image.rgbd import RGBD, LayeredRGBD
from inim.image.sides import BESIDE, Sides, with_sides
from inim.render import splats
from inim.render.depth_peeling import MOST_LAYERS, PeeledLayers
from inim.render.library import dr, mi
from inim.render.rays import NonSeparableRays, SeparableRays, capture_rays, eye_rays, pickup_rays
from inim.render.scene import FittedScene
from inim.render.trace import (
    Light,
    first_not_light,
    first_surface,
    mean_light,
    pixel_light,
    scene_light,
    whole_packets,
)
from inim.system.process.observer import Observer


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
    rays = capture_rays(display, pixels_per_pitch, fitted.start_mm)
    camera = fitted.camera(rays)
    light = scene_light(fitted.scene, fitted.integrator, camera)
    color = mean_light(light, camera.shape, spp, seed, observer=observer)
    return _add_depth(fitted, rays, color, observer)


def capture_parts(
    fitted: FittedScene,
    display: Display,
    *,
    pixels_per_pitch: float,
    spp: int,
    seed: int,
    first: int = 0,
    slopes: tuple[float, float] = (0.0, 0.0),
    skip: bool = True,
    observer: Observer | None = None,
) -> tuple[RGBD, ...]:
    """Capture independent parts of the samples (`split_samples`), as `capture`, of equal depth.

    `first`, `skip`: see `pickup`; `slopes`: see `capture_rays`.
    """
    rays = capture_rays(display, pixels_per_pitch, fitted.start_mm, slopes)
    mask = fitted.bounds.visible_pixels(rays) if skip else None
    color, *colors = _render_parts(fitted, rays, spp, seed, first, mask, observer)
    rgbd = _add_depth(fitted, rays, color, observer, mask)
    return rgbd, *(replace(rgbd, color=color) for color in colors)


def _add_depth(
    fitted: FittedScene,
    rays: SeparableRays,
    color: np.ndarray,
    observer: Observer | None,
    mask: np.ndarray | None = None,
) -> RGBD:
    """Colour with the depth and coverage of the depth camera; `mask`: pixels to trace."""
    camera = fitted.camera(rays)
    covered, points = first_surface(fitted.scene, fitted.integrator, camera, observer, mask)
    forward = fitted.fit.display_from_world
    depth = np.zeros(covered.shape, np.float32)
    depth[covered] = points @ forward[2, :3] + forward[2, 3]
    return RGBD(color, depth, covered, rays.x.place_step_mm)


def capture_absorption(
    fitted: FittedScene, display: Display, *, pixels_per_pitch: float
) -> tuple[splats.Absorption, float]:
    """Depths of light absorption in splats along the rays of `capture`, and display mm per world
    unit.
    """
    camera = fitted.camera(capture_rays(display, pixels_per_pitch, fitted.start_mm))
    absorption = splats.absorption(fitted.scene, fitted.integrator, camera.centre_rays())
    # The rays are parallel to the display's axis.
    return absorption, 1 / float(np.linalg.norm(fitted.fit.world_from_display[:3, 2]))


def capture_layers(
    fitted: FittedScene,
    peeled: PeeledLayers,
    *,
    spp: int,
    seed: int,
    first: int = 0,
    observer: Observer | None = None,
) -> LayeredRGBD:
    """Colour all layers of a peeled scene (`inim.render.depth_peeling`) with `spp` samples each.

    `first`: see `inim.render.trace.mean_light`.

    Depth and coverage of the front are those of `capture`; its colour is not mixed with its
    surroundings. Sides have their own layers (`inim.image.sides`).
    """
    sides = peeled.sides
    samples = spp, seed, first, observer
    colors = _layer_colours(fitted, peeled, *samples)
    light, has_samples = _side_colours(fitted, peeled, *samples)
    solids = peeled.front_mm, peeled.back_mm, colors
    return with_sides(solids, sides, light, has_samples, peeled.pixel_mm)


def _layer_colours(
    fitted: FittedScene,
    peeled: PeeledLayers,
    spp: int,
    seed: int,
    first: int,
    observer: Observer | None,
) -> np.ndarray:
    """Light of each layer towards the viewer, with the layers in front removed.

    (layers, rows, columns, 3) float32, linear RGB, black without a layer.

    Samples cover a pixel, or, if wider, the area that a quarter of a panel pixel sees. They count
    only on the surface at the pixel's centre: a sample that would meet another surface is taken
    at the centre instead.
    """
    colours = np.zeros((*peeled.front_mm.shape, 3), np.float32)
    for layer, covered in enumerate(peeled.covered):
        if not covered.any():
            continue
        light, shape = _layer_light(fitted, peeled, layer), (int(np.count_nonzero(covered)),)
        layer_seed = int(np.random.SeedSequence((seed, layer)).generate_state(1)[0])
        colours[layer][covered] = mean_light(light, shape, spp, layer_seed, None, observer, first)
    return colours


def _side_colours(
    fitted: FittedScene,
    peeled: PeeledLayers,
    spp: int,
    seed: int,
    first: int,
    observer: Observer | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Light of each piece of a side, (pieces, 3) float32, and whether it has any sample.

    The mean over the rays that reach it: the walls between its pixel and the neighbours are
    weighted by the number of rays that cross them.
    """
    sides = peeled.sides
    color, weight = np.zeros((2, len(sides.row), 3))
    if not len(sides.row):
        return color, weight[:, 0] > 0
    piece, beside = sides.walls.T
    share = np.asarray(sides.slopes)[beside // 2] * (sides.high_mm - sides.low_mm)[piece, beside]
    side_seed = int(np.random.SeedSequence((seed, MOST_LAYERS)).generate_state(1)[0])
    for seen_only, sums in ((False, color), (True, weight)):
        light = _side_light(fitted, peeled.rays, sides, seen_only)
        mean = mean_light(light, piece.shape, spp, side_seed, None, observer, first)
        np.add.at(sums, piece, mean * share[:, None])
    return np.divide(color, weight, out=color, where=weight > 0), weight[:, 0] > 0


# Rays that enter a wall are the more, the more aslant they are; those that graze it start far off.
_LEAST_SHARE = 1e-3


def _side_light(fitted: FittedScene, rays: SeparableRays, sides: Sides, seen_only: bool) -> Light:
    """Function that returns the light of samples on the walls of sides, one pixel per wall.

    A piece's colour is the mean over the display rays that reach it: through any point of the walls
    between its pixel and the four neighbours, at any slope of the display's pixels, and
    unobstructed from the viewer to the centre of the neighbouring pixel, which the camera saw to be
    empty. From there a ray meets the side, up to half a pixel in front of the wall or behind it.

    * `seen_only`: return 1 for a sample that reaches its wall unobstructed, instead of its light.
      The others are 0 in both cases. Equal seeds draw equal samples.
    """
    camera = fitted.camera(rays)
    piece, beside = sides.walls.T
    down, right = BESIDE[beside].T
    row, column = sides.row[piece], sides.column[piece]
    pixel_mm = abs(rays.x.place_step_mm)
    slope_x, slope_y = (dr.opaque(mi.Float, slope) for slope in sides.slopes)
    start, half = dr.opaque(mi.Float, rays.start_mm), dr.opaque(mi.Float, pixel_mm / 2)

    def table(values: np.ndarray) -> Any:
        return mi.Float(np.asarray(values, np.float32))

    tables = [
        table(values)
        for values in (
            rays.x.place_mm[column], rays.y.place_mm[row], right, -down,
            sides.low_mm[piece, beside], sides.high_mm[piece, beside],
        )
    ]  # fmt: skip

    def light(index: Any, sampler: Any) -> Any:
        within = sampler.next_2d()
        x, y, across, up, low, high = (dr.gather(mi.Float, t, index) for t in tables)
        along, level = sampler.next_2d()
        # A wall is as wide as a ray's slope towards it lets it appear.
        towards = dr.sqrt(dr.maximum(within.x, _LEAST_SHARE))
        offset = 2 * within.y - 1
        is_left_or_right = across != 0
        run_x = dr.select(is_left_or_right, -across * towards, offset) * slope_x
        run_y = dr.select(is_left_or_right, offset, -up * towards) * slope_y
        # From a point of the wall back to the middle of the pixel beside, and to the viewer.
        place = (2 * along - 1) * half
        x += dr.select(is_left_or_right, across * half, place)
        y += dr.select(is_left_or_right, place, up * half)
        z = dr.lerp(low, high, level)
        before = half / dr.select(is_left_or_right, dr.abs(run_x), dr.abs(run_y))
        depth = start - z
        ray, length = camera.world_rays([x - run_x * depth, y - run_y * depth], [run_x, run_y])
        hit = first_not_light(fitted.scene, ray)
        is_unobstructed = ~hit.is_valid() | (hit.t >= (depth - before) * length)
        if seen_only:
            return mi.Color3f(dr.select(is_unobstructed, mi.Float(1), mi.Float(0)))
        radiance_sample = fitted.integrator.sample(
            fitted.scene, sampler, mi.RayDifferential3f(ray), active=is_unobstructed
        )[0]
        return dr.select(is_unobstructed, radiance_sample, 0)

    return light


def _layer_light(fitted: FittedScene, peeled: PeeledLayers, layer: int) -> Light:
    """Function that returns the light of samples of one layer's pixels."""
    camera = fitted.camera(peeled.rays)
    covered = peeled.covered[layer]
    rows, columns = (mi.UInt32(places.astype(np.uint32)) for places in np.nonzero(covered))

    def table(kind: Any, values: np.ndarray) -> Any:
        return kind(values[layer][covered])

    near, far = table(mi.Float, peeled.near), table(mi.Float, peeled.far)
    facing, spread = table(mi.Bool, peeled.facing), table(mi.Float, peeled.spread)

    def light(index: Any, sampler: Any) -> Any:
        within = sampler.next_2d()
        place = mi.Point2u(dr.gather(mi.UInt32, columns, index), dr.gather(mi.UInt32, rows, index))
        begin, end = dr.gather(mi.Float, near, index), dr.gather(mi.Float, far, index)

        def ray(within: Any) -> Any:
            ray_sample = camera.rays(place, within)
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
    first: int = 0,
    skip: bool = True,
    mask: np.ndarray | None = None,
    observed: np.ndarray | None = None,
    observer: Observer | None = None,
) -> NoisyEIA:
    """Render the ground-truth EIA: every panel pixel path traced through its lens centre (Eq. 1).

    Samples cover the emitting area of the pixel. With sub-pixels, each colour has a separate pickup
    with `spp` samples. Panel pixels outside the array have no lens and are black.

    * `first`: number of samples per pixel that earlier calls have taken, a multiple of
      `REPLICATES`; the mean over all calls is the image of all samples.
    * `skip`: trace only pixels that can be non-black (`inim.render.culling`): the same bits.
    * `mask`, (rows, columns) bool: panel pixels to trace; the others stay black. It does not change
      the traced pixels.
    * `observed`, (rows, columns) bool: panel pixels whose replicates are kept.
    """
    mask = display.lensed if mask is None else mask & display.lensed
    # Also where a pixel lacks a colour: what is not shown is left out by the panel.
    places = [replace(subpixel, turn=None) for subpixel in SUBPIXELS[display.subpixels]]
    pickups = {}
    for place in dict.fromkeys(places):
        rays = pickup_rays(display, fitted.start_mm, place)
        visible = mask & fitted.bounds.visible_pixels(rays) if skip else mask
        pickups[place] = _render_panel(fitted, rays, spp, seed, first, visible, observed, observer)
    if len(pickups) == 1:
        halves, replicates = pickups[places[0]]
        return NoisyEIA(halves, stores_halves=True, observed=replicates)
    # Red of the first colour's pickup, green of the second's, blue of the third's.
    channels = [pickups[place] for place in places]
    first_half, second_half = (
        np.stack([images[half][..., c] for c, (images, _) in enumerate(channels)], axis=-1)
        for half in (0, 1)
    )
    of_observed = [parts[..., c] for c, (_, parts) in enumerate(channels) if parts is not None]
    replicates = np.stack(of_observed, axis=-1) if of_observed else None
    return NoisyEIA((first_half, second_half), stores_halves=True, observed=replicates)


def _render_panel(
    fitted: FittedScene,
    rays: SeparableRays | NonSeparableRays,
    spp: int,
    seed: int,
    first: int,
    mask: np.ndarray,
    observed: np.ndarray | None,
    observer: Observer | None,
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray | None]:
    """Render two halves of a panel, and the replicates of observed pixels, (K, pixels, 3).

    The halves of observed pixels are means of their replicates. The replicates are None if there
    are too few samples, or without observed pixels.
    """
    camera, (count, part_spp) = fitted.camera(rays), split_samples(spp)
    light, in_half = scene_light(fitted.scene, fitted.integrator, camera), count // 2
    seeds = [REPLICATES * seed + part for part in range(count)]
    before = first // count
    if observed is None or count < REPLICATES:
        observed = np.zeros(camera.shape, bool)
    # Pixels that may be traced together with observed ones have replicates as well: the same
    # pixels for any number of samples.
    has_replicates = mask & whole_packets(observed.ravel()).reshape(camera.shape)
    others = mask & ~has_replicates
    halves = [
        mean_light(light, camera.shape, in_half * part_spp, s, others, observer, in_half * before)
        for s in seeds[:2]
    ]
    if not observed.any():
        return (halves[0], halves[1]), None
    is_observed = observed.ravel()
    place, flat_halves = np.cumsum(is_observed) - 1, [half.reshape(-1, 3) for half in halves]
    replicates = np.zeros((count, np.count_nonzero(observed), 3), np.float32)
    bands = pixel_light(light, has_replicates.ravel(), part_spp, seeds, observer, before)
    for pixels, parts in bands:
        replicates[:, place[pixels[is_observed[pixels]]]] = parts[:, is_observed[pixels]]
        for half, parts_of_half in zip(flat_halves, np.split(parts, 2), strict=True):
            half[pixels] = sum(parts_of_half / np.float32(in_half))
    return (halves[0], halves[1]), replicates


def true_view(
    fitted: FittedScene,
    display: Display,
    viewpoint: Viewpoint,
    *,
    pixels_per_lens: int | tuple[float, float],
    spp: int,
    seed: int,
    first: int = 0,
    skip: bool = True,
    observer: Observer | None = None,
) -> tuple[NoisyImage, np.ndarray]:
    """The scene itself from an eye, through the window of the array; and where the relic is.

    `first`, `skip`: see `pickup`; `pixels_per_lens`: see `eye_rays`.
    """
    rays = eye_rays(display, viewpoint, pixels_per_lens, fitted.start_mm)
    mask = fitted.bounds.visible_pixels(rays) if skip else None
    parts = _render_parts(fitted, rays, spp, seed, first, mask, observer)
    camera, truth = fitted.camera(rays), NoisyImage.from_parts(parts)
    return truth, first_surface(fitted.scene, fitted.integrator, camera, observer, mask)[0]


def _render_parts(
    fitted: FittedScene,
    rays: SeparableRays | NonSeparableRays,
    spp: int,
    seed: int,
    first: int,
    mask: np.ndarray | None,
    observer: Observer | None,
) -> np.ndarray:
    """Render independent parts of the samples (`split_samples`); `first`: see `pickup`.

    Returns (parts, rows, columns, 3) float32 array, black outside the mask.
    """
    camera, (count, part_spp) = fitted.camera(rays), split_samples(spp)
    light = scene_light(fitted.scene, fitted.integrator, camera)
    if mask is None:
        mask = np.ones(camera.shape, bool)
    seeds = [REPLICATES * seed + part for part in range(count)]
    parts = np.zeros((count, *camera.shape, 3), np.float32)
    flat_parts = parts.reshape(count, -1, 3)
    bands = pixel_light(light, mask.ravel(), part_spp, seeds, observer, first // count)
    for pixels, means in bands:
        flat_parts[:, pixels] = means
    return parts
