"""`thick`: a plano-convex lens, refracted exactly at both faces.

Where it stands: the front principal plane is the plane z = 0 that rays arrive on, and the panel
lies the gap g behind the rear principal plane, so f and g mean what they mean for a thin lens.
With the bulge towards the viewer the vertex is at z = 0 and the rear principal plane t - t/n
behind it; with the bulge towards the panel the flat face is at z = t/n and the vertex is the rear
principal plane, t - t/n behind z = 0 (Hecht, Optics, thick lenses: h = f (n - 1) t / (R n)).

Weights are the unpolarised Fresnel transmittances of the two faces; the factor n^2 of radiance
inside glass cancels between them.
"""

from __future__ import annotations

import math
from typing import Any

from inim.display import Display
from inim.errors import DisplayError
from inim.lens.array import LensArray, LensTraits, Ops, lens_array, lens_centre
from inim.lens.ray import PanelRay

__all__ = ["check", "on_axis_transmittance", "trace"]


def check(display: Display) -> None:
    """Raise `DisplayError` where the lens cannot fill its cell, be so thin, or clear the panel."""
    array = lens_array(display)
    corner = display.pitch_mm / math.sqrt(2)
    if array.radius <= corner:
        raise DisplayError(
            f"thick lens: radius f (n - 1) = {array.radius:.4g} mm cannot fill a square cell of "
            f"pitch {display.pitch_mm:g} mm (corner at {corner:.4g} mm); use a longer "
            "focal_length_mm or a higher refractive_index"
        )
    sag = array.radius - math.sqrt(array.radius**2 - corner**2)
    if array.thickness < sag:
        raise DisplayError(
            f"lens_thickness_mm = {array.thickness:g}: the bulge alone is {sag:.4g} mm high at "
            "the corner of the cell; make the lens thicker"
        )
    behind = array.thickness / display.refractive_index if display.curved_side == "viewer" else 0.0
    if display.gap_mm <= behind:
        raise DisplayError(
            f"gap_mm = {display.gap_mm:g}: the lens's flat face lies {behind:.4g} mm behind its "
            "principal plane, inside the panel; use a thinner lens or a larger gap"
        )


def on_axis_transmittance(display: Display) -> float:
    """Share of light through both faces at normal incidence, (4 n / (n + 1)^2)^2."""
    n = display.refractive_index
    return (4 * n / (n + 1) ** 2) ** 2


def trace(
    array: LensArray, traits: LensTraits, ops: Ops, x: Any, y: Any, sx: Any, sy: Any, index: Any
) -> PanelRay:
    """See `inim.lens`: where a viewer's ray meets the panel."""
    length = ops.sqrt(sx * sx + sy * sy + 1.0)
    direction = (sx / length, sy / length, -1.0 / length)
    through = _trace_bulge_first if traits.bulges_to_viewer else _trace_flat_first
    return through(array, traits, ops, x, y, direction, index)


def _trace_bulge_first(
    array: LensArray, traits: LensTraits, ops: Ops, x: Any, y: Any, d: Any, index: Any
) -> PanelRay:
    """Curved face at z = 0, flat face at z = -t."""
    centre_x, centre_y, _ = lens_centre(array, traits, ops, x, y)
    path, _ = _meet_sphere(ops, x - centre_x, y - centre_y, d, array.radius, near=True)
    # The sag lets an oblique ray slip past its own cell's edge and meet the neighbour's bulge.
    centre_x, centre_y, inside = lens_centre(array, traits, ops, x + path * d[0], y + path * d[1])
    path, hit = _meet_sphere(ops, x - centre_x, y - centre_y, d, array.radius, near=True)
    px, py, pz = x + path * d[0], y + path * d[1], path * d[2]
    normal = (
        (px - centre_x) / array.radius,
        (py - centre_y) / array.radius,
        (pz + array.radius) / array.radius,
    )
    d, front = _refract(ops, d, normal, 1.0 / index)
    px, py = _carry(px, py, d, array.thickness + pz)
    d, back = _refract(ops, d, (0.0, 0.0, 1.0), index)
    px, py = _carry(px, py, d, array.gap - array.thickness / index)
    return PanelRay(px, py, -d[0] / d[2], -d[1] / d[2], ops.where(inside & hit, front * back, 0.0))


def _trace_flat_first(
    array: LensArray, traits: LensTraits, ops: Ops, x: Any, y: Any, d: Any, index: Any
) -> PanelRay:
    """Flat face at z = t/n, vertex of the curved face at z = t/n - t."""
    x, y = _carry(x, y, d, -array.thickness / index)
    d, front = _refract(ops, d, (0.0, 0.0, 1.0), 1.0 / index)
    x, y = _carry(x, y, d, array.thickness)  # on the vertex plane, inside a neighbour maybe
    centre_x, centre_y, _ = lens_centre(array, traits, ops, x, y)
    path, _ = _meet_sphere(ops, x - centre_x, y - centre_y, d, array.radius, near=False)
    centre_x, centre_y, inside = lens_centre(array, traits, ops, x + path * d[0], y + path * d[1])
    path, hit = _meet_sphere(ops, x - centre_x, y - centre_y, d, array.radius, near=False)
    px, py, pz = x + path * d[0], y + path * d[1], path * d[2]
    normal = (
        (centre_x - px) / array.radius,
        (centre_y - py) / array.radius,
        (array.radius - pz) / array.radius,
    )
    d, back = _refract(ops, d, normal, index)
    px, py = _carry(px, py, d, array.gap + pz)
    return PanelRay(px, py, -d[0] / d[2], -d[1] / d[2], ops.where(inside & hit, front * back, 0.0))


def _meet_sphere(ops: Ops, x: Any, y: Any, d: Any, radius: Any, *, near: bool) -> tuple[Any, Any]:
    """Path from the vertex plane to a sphere whose vertex is the origin, and whether it is met.

    The sphere bulges towards the viewer (`near`, met going in) or towards the panel (met going
    out, so the path is negative). The root next to the vertex, written without cancellation.
    """
    side = 1.0 if near else -1.0
    half_b = x * d[0] + y * d[1] + side * radius * d[2]
    height_squared = x * x + y * y
    discriminant = half_b * half_b - height_squared
    root = ops.sqrt(ops.where(discriminant > 0, discriminant, 0.0))
    path = height_squared / (-half_b + root) if near else -height_squared / (half_b + root)
    return path, discriminant > 0


def _carry(x: Any, y: Any, d: Any, depth: Any) -> tuple[Any, Any]:
    """Follow a ray for a depth away from the viewer."""
    return x - d[0] / d[2] * depth, y - d[1] / d[2] * depth


def _refract(ops: Ops, d: Any, normal: Any, ratio: Any) -> tuple[tuple[Any, Any, Any], Any]:
    """Snell's law in vector form and the Fresnel transmittance; 0 under total reflection.

    `ratio` is the index in front over the index behind; `normal` points against the ray.
    """
    cos_in = -(d[0] * normal[0] + d[1] * normal[1] + d[2] * normal[2])
    under = 1.0 - ratio * ratio * (1.0 - cos_in * cos_in)
    passes = under > 0
    cos_out = ops.sqrt(ops.where(passes, under, 1.0))
    bend = ratio * cos_in - cos_out
    out = tuple(ratio * a + bend * b for a, b in zip(d, normal, strict=True))
    r_s = (ratio * cos_in - cos_out) / (ratio * cos_in + cos_out)
    r_p = (cos_in - ratio * cos_out) / (cos_in + ratio * cos_out)
    transmittance = 1.0 - 0.5 * (r_s * r_s + r_p * r_p)
    return out, ops.where(passes, transmittance, 0.0)
