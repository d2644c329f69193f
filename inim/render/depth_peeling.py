"""Depth peeling: all layers along the depth camera's parallel rays.

A ray through a pixel's centre is followed through every surface except lights. The interval between
a front face and a back face is solid, and each solid that no other covers in depth is a layer of
that pixel: its front and its back. docs/theory/layers.md, "Depth peeling", has the rules that pair
fronts with backs and close gaps between pixels of one surface.

`inim.image.sides` determines which layers have sides, `inim.render.culling` which layers no display
ray can meet; `inim.render.ground_truth.capture_layers` colours them.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inim.display import Display
from inim.image.sides import Sides
from inim.render import splats
from inim.render.culling import layers_in_view
from inim.render.library import dr, mi
from inim.render.rays import SeparableRays, capture_rays
from inim.render.scene import FittedScene
from inim.render.trace import FilmCamera
from inim.system.backend.kernels import compiled
from inim.system.process.observer import Observer

#: What lies behind more than this is cut off, and counted.
MOST_LAYERS = 8
# Surfaces and lights on one ray, those inside solids included; beyond, the rest is not seen.
_MOST_HITS = 96
# A ray goes on this share of its coordinates behind what it met. float32 keeps 6e-8 of them; the
# start, the sum and the intersection each lose a few of these, and more where they graze.
_STEP = 4e-6
# Hits of one face nearer than this many steps are one hit: through an edge that triangles share.
_SAME_STEPS = 4


@dataclass(frozen=True)
class PeeledLayers:
    """Layers of a scene without colours, (layers, rows, columns), nearest first.

    * `front_mm`, `back_mm`, float32: depths in the display frame; -inf without a layer.
    * `near`, `far`, float32: world distances on the ray between which a neighbouring ray's hit is
      on the same surface.
    * `facing`: true if the ray meets the front face.
    * `spread`, float32: width in pixels over which colours are averaged.
    * `cut_share`: share of the covered pixels with more than `MOST_LAYERS` layers.
    * `hidden_share`: removed share of the layers behind the front surface that no display ray
      meets. Zero without such layers.
    * `has_sides`: true if the space between a front and a back is solid and has sides.
    """

    display: Display
    rays: SeparableRays
    front_mm: NDArray[np.float32]
    back_mm: NDArray[np.float32]
    near: NDArray[np.float32]
    far: NDArray[np.float32]
    facing: NDArray[np.bool_]
    spread: NDArray[np.float32]
    cut_share: float
    hidden_share: float = 0.0
    has_sides: bool = True

    @property
    def pixel_mm(self) -> float:
        """Side of a pixel."""
        return self.rays.x.place_step_mm

    @property
    def covered(self) -> NDArray[np.bool_]:
        """(layers, rows, columns): where there is a layer."""
        return np.isfinite(self.front_mm)

    @cached_property
    def sides(self) -> Sides:
        """Sides of the layers, for rays from the side."""
        back_mm = self.back_mm if self.has_sides else self.front_mm
        display = self.display
        return Sides.of(
            self.front_mm, back_mm, display.depth_range_mm, display.steepest_slopes, self.pixel_mm
        )


def peel(
    fitted: FittedScene,
    display: Display,
    *,
    pixels_per_pitch: float,
    hidden: bool = False,
    observer: Observer | None = None,
) -> PeeledLayers:
    """Find the layers of a scene along the rays of its RGB-D picture.

    * `hidden`: keep also the layers that no display ray can meet.
    """
    started = time.perf_counter()
    rays = capture_rays(display, pixels_per_pitch, fitted.start_mm)
    peeled = (_peel_splats if fitted.shows_splats else _peel_surfaces)(fitted, display, rays)
    if not hidden:
        front, back = peeled.front_mm, peeled.back_mm
        is_in_view = layers_in_view(front, back, display, peeled.pixel_mm)
        peeled = _remove_layers(peeled, ~is_in_view & peeled.covered)
    if observer:
        observer.record_rendering(time.perf_counter() - started)
    return peeled


def _peel_surfaces(fitted: FittedScene, display: Display, rays: SeparableRays) -> PeeledLayers:
    """The layers of surfaces, the hidden ones too."""
    pixel_mm = rays.x.place_step_mm
    hits = _Hits.of(fitted, fitted.camera(rays))
    front, back, hit, solid_counts = _join_to_solids(
        hits.count, hits.depth, _orient_outward(hits), hits.shape
    )
    layers = max(1, int(min(solid_counts.max(), MOST_LAYERS)))
    front, back, hit = front[:layers], back[:layers], hit[:layers]
    near, far, facing, spread = _surface_limits(fitted, display, pixel_mm, hits, front, hit)
    slope = hits.slope[hit, np.arange(front.shape[1])]
    front, back, near, far, facing, spread, slope = (
        values.reshape(layers, *rays.shape)
        for values in (front, back, near, far, facing, spread, slope)
    )
    _close_gaps(front, back, slope, facing, np.float32(pixel_mm))
    cut_share = _cut_share(solid_counts)
    return PeeledLayers(display, rays, front, back, near, far, facing, spread, cut_share)


def _peel_splats(fitted: FittedScene, display: Display, rays: SeparableRays) -> PeeledLayers:
    """Layers of splats, including hidden layers; see `inim.render.splats`.

    Splats have no normals: neighbouring fronts determine the slope of a surface.
    """
    pixel_mm = rays.x.place_step_mm
    ray = fitted.camera(rays).centre_rays()
    splat_layers = splats.find_layers(fitted.scene, fitted.integrator, ray, MOST_LAYERS)
    layers = max(1, int(min(splat_layers.count.max(), MOST_LAYERS)))
    shape = (layers, *rays.shape)
    origin, along = (np.stack(vector, dtype=np.float64) for vector in (ray.o, ray.d))
    forward = fitted.fit.display_from_world

    def depth(distance: np.ndarray) -> np.ndarray:
        there = np.isfinite(distance[:layers])
        points = origin[:, None] + np.where(there, distance[:layers], 0) * along[:, None]
        z = np.tensordot(forward[2, :3], points, 1) + forward[2, 3]
        return np.where(there, z, -np.inf).astype(np.float32).reshape(shape)

    front, back = depth(splat_layers.front), depth(splat_layers.back)
    everywhere = np.ones(shape, bool)
    _close_gaps(front, back, _front_slopes(front, pixel_mm), everywhere, np.float32(pixel_mm))
    near = np.maximum(splat_layers.near[:layers], 0).reshape(shape)
    far, spread = np.full(shape, np.inf, np.float32), _averaging_width(front, display, pixel_mm)
    cut_share = _cut_share(splat_layers.count)
    return PeeledLayers(
        display, rays, front, back, near, far, everywhere, spread, cut_share, has_sides=False
    )


def _front_slopes(front: np.ndarray, pixel_mm: float) -> np.ndarray:
    """Slopes of fronts, (layers, rows, columns), x and y added, to the nearer of two neighbours."""
    slope = np.zeros(front.shape, np.float32)
    for axis in (1, 2):
        with np.errstate(invalid="ignore"):
            step = np.nan_to_num(np.abs(np.diff(front, axis=axis)), nan=np.inf, posinf=np.inf)
        ends = [(0, 0)] * 3
        ends[axis] = (1, 1)
        step = np.moveaxis(np.pad(step, ends, constant_values=np.inf), axis, 0)
        nearer = np.moveaxis(np.minimum(step[:-1], step[1:]), 0, axis) / pixel_mm
        slope += np.where(np.isfinite(nearer), nearer, 0)
    return slope


def _cut_share(layer_counts: np.ndarray) -> float:
    """Share of the covered pixels that lack layers, from the numbers of those found."""
    cut, covered = np.count_nonzero(layer_counts > MOST_LAYERS), np.count_nonzero(layer_counts)
    return int(cut) / max(1, int(covered))


def _remove_layers(peeled: PeeledLayers, hidden: np.ndarray) -> PeeledLayers:
    """Remove the hidden layers, (layers, rows, columns), and move deeper layers up."""
    behind = int(np.count_nonzero(peeled.covered[1:]))
    order = np.argsort(hidden, axis=0, kind="stable")
    layers = max(1, int((peeled.covered & ~hidden).sum(axis=0).max()))

    def kept(values: np.ndarray) -> np.ndarray:
        return np.take_along_axis(values, order, axis=0)[:layers]

    there, no_layer = kept(peeled.covered & ~hidden), np.float32(-np.inf)
    names = ("near", "far", "facing", "spread")
    others: dict[str, Any] = {name: kept(getattr(peeled, name)) for name in names}
    return replace(
        peeled,
        front_mm=np.where(there, kept(peeled.front_mm), no_layer),
        back_mm=np.where(there, kept(peeled.back_mm), no_layer),
        **others,
        hidden_share=int(np.count_nonzero(hidden)) / max(1, behind),
    )


@dataclass(frozen=True)
class _Hits:
    """Hits of each ray in order; all fields except `count` are (hits, rays), of which `count` are
    valid.

    * `count`: (rays,) int32.
    * `distance`, float32: world distance from the ray's start.
    * `depth`, float32: display z.
    * `slope`, float32: millimetres of depth per millimetre sideways in the display frame, x and y
      added.
    """

    count: np.ndarray
    distance: np.ndarray
    depth: np.ndarray
    slope: np.ndarray
    facing: np.ndarray
    shape: np.ndarray

    @classmethod
    def of(cls, fitted: FittedScene, camera: FilmCamera) -> _Hits:
        """Follow the rays through all pixel centres to their ends."""
        rays = camera.shape[0] * camera.shape[1]
        count = np.zeros(rays, np.int32)
        going, start = np.arange(rays, dtype=np.uint32), np.zeros(rays, np.float32)
        # The previous hit of each ray, and all hits: number on its ray, ray, values.
        previous: dict[str, np.ndarray] = {}
        hits: list[tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]] = []
        for _ in range(_MOST_HITS):
            hit = _next_hit(fitted, camera, going, start)
            going, start = going[hit.pop("rays")], hit.pop("onward")
            if not len(going):
                break
            is_light, step = hit.pop("light"), hit.pop("step")
            if not previous:
                previous = {name: np.zeros(rays, values.dtype) for name, values in hit.items()}
            last = {name: values[going] for name, values in previous.items()}
            new = ~is_light & ~((count[going] > 0) & _is_repeated(hit, last, step))
            ray = going[new]
            hits.append((count[ray], ray, {name: values[new] for name, values in hit.items()}))
            for name, values in hits[-1][2].items():
                previous[name][ray] = values
            count[ray] += 1
        kinds = {
            "distance": np.float32, "depth": np.float32, "slope": np.float32, "facing": np.bool_,
            "shape": np.uint32,
        }  # fmt: skip
        tables = {name: np.zeros((max(1, count.max()), rays), kind) for name, kind in kinds.items()}
        for number, ray, hit in hits:
            for name, table in tables.items():
                table[number, ray] = hit[name]
        return cls(count, **tables)


def _next_hit(
    fitted: FittedScene, camera: FilmCamera, going: np.ndarray, start: np.ndarray
) -> dict[str, np.ndarray]:
    """Next hit of rays beyond the world distance `start`, and the indices of the rays with a hit.

    One compiled kernel serves all steps.
    """
    ray, begin = camera.centre_rays(mi.UInt32(going)), mi.Float(start)
    hit = fitted.scene.ray_intersect(mi.Ray3f(ray.o + begin * ray.d, ray.d))
    distance = begin + hit.t
    place = ray.o + distance * ray.d
    step = _STEP * (dr.maximum(dr.max(dr.abs(ray.o)), dr.max(dr.abs(place))) + distance)
    light = hit.is_valid() & hit.shape.is_emitter()
    shape = dr.reinterpret_array(mi.UInt32, hit.shape)
    dr.eval(distance, step, light, shape, hit, ray)
    hit_rays = np.flatnonzero(np.asarray(hit.is_valid()))

    def chosen(values: Any) -> np.ndarray:
        return np.asarray(values)[hit_rays]

    def vectors(vector: Any) -> np.ndarray:
        return np.stack([chosen(part).astype(np.float64) for part in vector], axis=-1)

    forward = fitted.fit.display_from_world
    points = vectors(ray.o) + chosen(distance).astype(np.float64)[:, None] * vectors(ray.d)
    normal = vectors(hit.n) @ fitted.fit.world_from_display[:3, :3]
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.nan_to_num(np.abs(normal[:, :2]).sum(axis=1) / np.abs(normal[:, 2]), nan=0.0)
    return {
        "rays": hit_rays,
        "light": chosen(light),
        "distance": chosen(distance),
        "onward": chosen(distance + step),
        "step": chosen(step),
        "depth": (points @ forward[2, :3] + forward[2, 3]).astype(np.float32),
        "slope": np.minimum(slope, np.finfo(np.float32).max).astype(np.float32),
        "facing": chosen(dr.dot(hit.n, ray.d) < 0),
        "shape": chosen(shape),
        "face": chosen(hit.prim_index),
    }


def _is_repeated(
    hit: dict[str, np.ndarray], last: dict[str, np.ndarray], step: np.ndarray
) -> np.ndarray:
    """Mask of hits of the same face as the last hit, or of its neighbour across an edge."""
    same = (hit["shape"] == last["shape"]) & (hit["facing"] == last["facing"])
    # No straight line meets a triangle or a quadric twice from one side; grazing, it may be
    # found again farther on than elsewhere.
    most = np.where(hit["face"] == last["face"], 16, 1) * _SAME_STEPS * step
    repeated: np.ndarray = same & (hit["distance"] - last["distance"] <= most)
    return repeated


def _orient_outward(hits: _Hits) -> np.ndarray:
    """`facing` with the shapes turned round whose normals are inside out."""
    facing = hits.facing.copy()
    there = np.arange(len(facing))[:, None] < hits.count
    for shape in np.unique(hits.shape[there]):
        own = there & (hits.shape == shape)
        rays = np.flatnonzero(own.sum(axis=0) >= 2)
        if not len(rays):
            continue
        first = own[:, rays].argmax(axis=0)
        last = len(own) - 1 - own[::-1, rays].argmax(axis=0)
        enters, leaves = hits.facing[first, rays], hits.facing[last, rays]
        if np.count_nonzero(~enters & leaves) > np.count_nonzero(enters & ~leaves):
            facing[own] = ~facing[own]
    return facing


@compiled
def _join_to_solids(count, depth, facing, shape):  # type: ignore[no-untyped-def]
    """Join the hits of each ray to solids and these to layers; see the module's text.

    Returns fronts, backs and the hit that each front is, (MOST_LAYERS, rays), and the number of
    layers per ray.
    """
    rays = len(count)
    front = np.full((MOST_LAYERS, rays), -np.inf, np.float32)
    back = np.full((MOST_LAYERS, rays), -np.inf, np.float32)
    hit = np.zeros((MOST_LAYERS, rays), np.int32)
    solid_counts = np.zeros(rays, np.int32)
    partner = np.empty(len(depth), np.int64)
    for ray in range(rays):
        n = count[ray]
        partner[:] = -1
        for own in (True, False):  # fronts of the same shape first
            for b in range(n):
                if facing[b, ray] or partner[b] >= 0:
                    continue
                for f in range(b - 1, -1, -1):
                    open_front = facing[f, ray] and partner[f] < 0
                    if open_front and (not own or shape[f, ray] == shape[b, ray]):
                        partner[f], partner[b] = b, f
                        break
        layers, end = 0, np.float32(np.inf)
        for f in range(n):
            if partner[f] >= 0 and not facing[f, ray]:
                continue
            last = partner[f] if partner[f] >= 0 else f
            ends = depth[last, ray]
            if layers > 0 and depth[f, ray] > end:  # inside what there is
                end = min(end, ends)
            else:
                layers += 1
                end = ends
                if layers <= len(front):
                    front[layers - 1, ray] = depth[f, ray]
                    hit[layers - 1, ray] = f
            if layers <= len(front):
                back[layers - 1, ray] = end
        solid_counts[ray] = layers
    return front, back, hit, solid_counts


@compiled
def _close_gaps(front, back, slope, facing, pixel):  # type: ignore[no-untyped-def]
    """Lower the backs, (layers, rows, columns), to neighbouring fronts of the same surface."""
    layers, rows, columns = front.shape
    for k in range(layers):
        for r in range(rows):
            for c in range(columns):
                own = front[k, r, c]
                if own == -np.inf:
                    continue
                end = back[k, r, c]
                for down, right in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                    y, x = r + down, c + right
                    if not (0 <= y < rows and 0 <= x < columns):
                        continue
                    for n in range(layers):
                        beside = front[n, y, x]
                        if beside >= end or facing[n, y, x] != facing[k, r, c]:
                            continue
                        # Twice the slope, and a pixel: slopes grow towards a rim.
                        step = pixel * (1 + 2 * min(slope[k, r, c], slope[n, y, x]))
                        if own - beside <= step:
                            end = beside
                if k + 1 < layers:
                    end = max(end, front[k + 1, r, c])
                back[k, r, c] = end


def _averaging_width(front: np.ndarray, display: Display, pixel_mm: float) -> np.ndarray:
    """Width in pixels over which the colours of fronts, -inf where there is none, are averaged."""
    # A quarter of a panel pixel is what one of its four samples stands for at that depth.
    width_mm = np.abs(front) * display.pixel_pitch_mm / display.gap_mm / 2
    wide = np.where(np.isfinite(front), np.maximum(1, width_mm / pixel_mm), 1)
    spread: np.ndarray = wide.astype(np.float32)
    return spread


def _surface_limits(
    fitted: FittedScene,
    display: Display,
    pixel_mm: float,
    hits: _Hits,
    front: np.ndarray,
    hit: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Near, far, facing and spread of `PeeledLayers`, (layers, rays)."""
    ray = np.arange(front.shape[1])
    own, facing = hits.distance[hit, ray], hits.facing[hit, ray]
    spread = _averaging_width(front, display, pixel_mm)
    # Neighbours on a slope lie that much deeper; on a steep one, as far as the display's steepest
    # ray gets across a pixel, and beyond it the centre's own samples do.
    slope = np.minimum(hits.slope[hit, ray], 2 * display.gap_mm / display.pitch_mm)
    reach_mm = pixel_mm * (1 + spread * slope)
    # World units are display millimetres over the length of a unit step along the ray.
    along = fitted.fit.world_from_display[:3, 2]
    reach = (reach_mm * np.linalg.norm(along)).astype(np.float32)
    before = np.where(hit > 0, hits.distance[np.maximum(hit - 1, 0), ray], -own)
    after = np.full(own.shape, np.inf, np.float32)
    for number in range(len(hits.depth) - 1, 0, -1):
        follows = (number > hit) & (number < hits.count) & (hits.facing[number] == facing)
        after = np.where(follows, hits.distance[number], after)
    near = np.maximum((before + own) / 2, own - reach)
    far = np.minimum((own + after) / 2, own + reach)
    return np.maximum(near, 0).astype(np.float32), far.astype(np.float32), facing, spread
