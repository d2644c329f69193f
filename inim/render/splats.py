"""Traversal of 3D Gaussian splats, equal to Mitsuba's integrator `volprim_rf_basic`.

docs/theory/ground-truth.md, "Splats", has the formulas. Colours and transmittance are the
integrator's own; this module computes depths and layers. A splat's absorption is assigned to its
**peak**, the point of the ray with the least Mahalanobis distance from the splat's centre.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inim.render.library import dr, mi

#: Mitsuba's integrator for splats that emit light.
INTEGRATOR = "volprim_rf_basic"
# A ray goes on so far behind where it entered a splat, in world units, and ends where so little
# light is left: as in the integrator.
_STEP = 1e-4
# Of a shape's `data` for each splat: centre, scale, quaternion.
_NUMBERS = 10
_LEAST_LIGHT = 0.01


def shows_splats(integrator: Any) -> bool:
    """True for the integrator of splats."""
    return hasattr(integrator, "eval_transmission")


def splat_count(shape: Any) -> int:
    """Number of splats in a shape of splats."""
    return len(mi.traverse(shape)["data"]) // _NUMBERS


def radiance(scene: Any, integrator: Any, sampler: Any, ray: Any) -> Any:
    """Light along rays, three channels, from a C++ integrator or the integrator for splats."""
    if shows_splats(integrator):
        # Differentiable integrators in Python take a mode, and gradients that there are none of.
        primal = dr.ADMode.Primal
        return integrator.sample(primal, scene, sampler, ray, None, None, mi.Bool(True))[0]
    return integrator.sample(scene, sampler, mi.RayDifferential3f(ray), active=True)[0]


@dataclass(frozen=True)
class Absorption:
    """Depths of light absorption along rays, (rays,) each.

    * `left`, float32: transmittance of all that they meet, down to 0.01: rays end there.
    * `tenth`, `half`, `most`, float32: world distances at which 10, 50 and 90 % are gone; infinite
      where they never are.
    * `twice`: whether the renderer met a splat twice in succession, which no straight line does: it
      counted that splat double.
    """

    left: NDArray[np.float32]
    tenth: NDArray[np.float32]
    half: NDArray[np.float32]
    most: NDArray[np.float32]
    twice: NDArray[np.bool_]


@dr.syntax  # type: ignore[untyped-decorator]
def absorption(scene: Any, integrator: Any, ray: Any) -> Absorption:
    """Follow rays as far as the integrator does."""
    ray = mi.Ray3f(ray)
    start = mi.Point3f(ray.o)
    active, twice = mi.Bool(True), mi.Bool(False)
    left = mi.Float(1)
    tenth, half, most = mi.Float(dr.inf), mi.Float(dr.inf), mi.Float(dr.inf)
    last, count = mi.UInt32(0xFFFFFFFF), mi.UInt32(0)
    while active:
        hit, is_hit, passed, peak = _next_splat(scene, integrator, ray, active)
        peak += dr.dot(ray.o - start, ray.d)
        twice |= is_hit & (hit.prim_index == last)
        last = dr.select(is_hit, hit.prim_index, last)
        before = left
        left = dr.select(is_hit, left * passed, left)
        tenth = dr.select((before > 0.9) & (left <= 0.9), peak, tenth)
        half = dr.select((before > 0.5) & (left <= 0.5), peak, half)
        most = dr.select((before > 0.1) & (left <= 0.1), peak, most)
        ray.o = dr.select(is_hit, hit.p + ray.d * _STEP, ray.o)
        count += 1
        active = is_hit & (left > _LEAST_LIGHT) & (count < integrator.max_depth)
    depths = left, tenth, half, most, twice
    dr.eval(depths)
    return Absorption(*(np.asarray(depth) for depth in depths))


@dataclass(frozen=True)
class SplatLayers:
    """Layers of splats along rays, (layers, rays) float32, nearest first, in world distances.

    * `near`, `front`, `back`, float32: where the layer before it has ended, and where this one
      begins and ends; -inf where there is no layer.
    * `count`, (rays,) uint32: how many layers there are; those beyond the first dimension are cut
      off.
    """

    near: NDArray[np.float32]
    front: NDArray[np.float32]
    back: NDArray[np.float32]
    count: NDArray[np.uint32]


@dr.syntax  # type: ignore[untyped-decorator]
def find_layers(scene: Any, integrator: Any, ray: Any, most: int) -> SplatLayers:
    """Follow rays to their ends through all splats, with at most `most` layers each."""
    rays = dr.width(ray.d)
    lane = dr.arange(mi.UInt32, rays)
    nears, fronts, backs = (dr.full(mi.Float, -dr.inf, most * rays) for _ in range(3))
    dr.eval(nears, fronts, backs)
    ray = mi.Ray3f(ray)
    start = mi.Point3f(ray.o)
    active, is_open = mi.Bool(True), mi.Bool(False)
    left = mi.Float(1)  # of the light at the end of the layer before
    near, end, deepest = mi.Float(0), mi.Float(-dr.inf), mi.Float(-dr.inf)
    layer_count, count = mi.UInt32(0), mi.UInt32(0)
    while active:
        hit, is_hit, passed, peak = _next_splat(scene, integrator, ray, active)
        travelled = dr.dot(ray.o - start, ray.d)
        entry, peak = travelled + hit.t, travelled + peak
        begins = is_hit & (entry > end)
        closes = begins & is_open
        dr.scatter(backs, deepest, layer_count * rays + lane, closes & (layer_count < most))
        layer_count += dr.select(closes, mi.UInt32(1), mi.UInt32(0))
        near = dr.select(closes, end, near)
        left = dr.select(closes, 1, left)
        is_open &= ~closes
        deepest = dr.select(begins, peak, dr.select(is_hit, dr.maximum(deepest, peak), deepest))
        # A splat is symmetric about its peak.
        end = dr.select(is_hit, dr.maximum(end, 2 * peak - entry), end)
        left = dr.select(is_hit, left * passed, left)
        opens = is_hit & ~is_open & (left <= 0.5)
        dr.scatter(fronts, peak, layer_count * rays + lane, opens & (layer_count < most))
        dr.scatter(nears, near, layer_count * rays + lane, opens & (layer_count < most))
        is_open |= opens
        ray.o = dr.select(is_hit, hit.p + ray.d * _STEP, ray.o)
        count += 1
        active = is_hit & (count < integrator.max_depth)
    dr.scatter(backs, deepest, layer_count * rays + lane, is_open & (layer_count < most))
    layer_count += dr.select(is_open, mi.UInt32(1), mi.UInt32(0))
    dr.eval(layer_count, nears, fronts, backs)
    near, front, back = (np.asarray(t).reshape(most, rays) for t in (nears, fronts, backs))
    return SplatLayers(near, front, back, np.asarray(layer_count))


def _next_splat(scene: Any, integrator: Any, ray: Any, active: Any) -> tuple[Any, Any, Any, Any]:
    """Next splat on each ray, a flag whether there is one, its transmittance, and its peak."""
    hit = scene.ray_intersect(ray, ray_flags=mi.RayFlags.All, coherent=False, active=active)
    is_hit = active & hit.is_valid() & hit.shape.is_ellipsoids()
    passed = integrator.eval_transmission(hit, ray, is_hit)
    return hit, is_hit, passed, dr.dispatch(hit.shape, _peak_distance, hit.prim_index, ray, is_hit)


def _peak_distance(shape: Any, splat: Any, ray: Any, active: Any) -> Any:
    """Distance along rays at which they are nearest to a splat, in its own measure."""
    if shape is None or not shape.is_ellipsoids():
        return mi.Float(0)
    hit = dr.zeros(mi.SurfaceInteraction3f)
    hit.prim_index = splat
    data = shape.eval_attribute_x("ellipsoid", hit, active)
    centre, scale = (
        mi.Point3f(*(data[k] for k in range(3))),
        mi.Vector3f(*(data[3 + k] for k in range(3))),
    )
    own = dr.quat_to_matrix(mi.Matrix3f, mi.Quaternion4f(*(data[6 + k] for k in range(4)))).T
    origin, along = own * (ray.o - centre) / scale, own * ray.d / scale
    return -dr.dot(origin, along) / dr.dot(along, along)
