"""`thick`: a plano-convex lens, refracted exactly at both faces.

Position: the front principal plane is the plane z = 0, and the panel is at the distance g behind
the rear principal plane. With the bulge towards the viewer the vertex is at z = 0 and the rear
principal plane t - t/n behind it; with the bulge towards the panel the flat face is at z = t/n and
the vertex is the rear principal plane (Hecht, Optics, thick lenses: h = f (n - 1) t / (R n)). The
planes use the design index, so that they do not depend on a ray's colour. Layers in the gap are
plane-parallel, with the rest of the gap as air before them; a tilt of the panel widens what is
next to the lenses.

The bulges of lenses that fill their cells make one relief, and a ray meets its first bulge. None
leaves a bulge and strikes the next: at a slope b it would have to leave at more than 90 - b degrees
off the axis, so n sin(a - b) >= cos(2 b) for its angle a in the glass: in PMMA it would arrive 70
degrees off the axis. Lenses with gaps between them are sunk in a sheet of thickness t, vertices
flush.

Weights are the unpolarised Fresnel transmittances of the two faces; the factor n^2 of radiance
inside glass cancels between them. docs/theory/lens-models.md has omissions and comparisons.
"""

import math
from itertools import pairwise, starmap
from typing import Any, NamedTuple

import numpy as np

from inim.display import Display
from inim.display.declaration import rows_text
from inim.display.layers import air_equivalent_mm
from inim.display.lens.array import (
    NUMPY_OPS,
    LensArray,
    LensTraits,
    Ops,
    PanelRay,
    air_mm,
    in_aperture,
    lens_array,
    lens_centre,
    lens_traits,
    pass_straight,
)
from inim.display.lens.model import (
    Face,
    LensModel,
    advance,
    fresnel_on_axis,
    intersect,
    refract,
    sag,
    steepness,
    surface_normal,
)
from inim.system.errors import DisplayError

_AGAINST_THE_LIGHT = (0.0, 0.0, -1.0)  # a flat face's normal
_AIR = 1.0  # its refractive index
# Below this a ray runs along the array and never reaches the panel.
_ALONG_THE_ARRAY = 1e-6
# From the foot of the relief to a ray's bulge: the cell there and one more. A third is crossed only
# at a corner, where the foot itself is; none was needed by millions of rays up to 40 degrees.
_CELLS_ON_THE_WAY = 2
# Heights at which an asphere is checked for turning back.
_HEIGHTS = 512


def check(display: Display) -> None:
    """Raise `DisplayError` where a lens cannot fill its aperture, be this thin, or this thick."""
    array, traits = lens_array(display), lens_traits(display)
    face = _curved_face(array, traits._replace(bulges_to_viewer=True))  # its sag counts as height
    reach = math.sqrt(_reach_squared(array, traits, NUMPY_OPS))
    position = f"the aperture's edge ({reach:.4g} mm from the lens's axis)"
    if (1 + array.conic) * reach**2 >= array.radius**2:
        conic = f" and conic {array.conic:g}" if traits.conic else ""
        raise DisplayError(
            f"thick lens: a face of radius f (n - 1) = {array.radius:.4g} mm{conic} does not "
            f"reach {position}; use a longer focal_length_mm or a higher refractive_index"
        )
    heights = np.linspace(0, reach, _HEIGHTS + 1)[1:]
    turned = heights[steepness(NUMPY_OPS, face, heights**2) <= 0]
    if turned.size:
        raise DisplayError(
            f"asphere_a4 = {array.a4:g}, asphere_a6 = {array.a6:g}: the face turns back at "
            f"{turned[0]:.4g} mm, inside {position}; use smaller terms or a smaller fill_factor"
        )
    height = float(sag(NUMPY_OPS, face, reach**2))
    if array.thickness < height:
        raise DisplayError(
            f"lens_thickness_mm = {array.thickness:g}: the bulge alone is {height:.4g} mm high at "
            f"{position}; make the lens thicker"
        )
    behind = array.thickness / array.design_index if traits.bulges_to_viewer else 0.0
    if display.gap_mm <= behind:
        raise DisplayError(
            f"gap_mm = {display.gap_mm:g}: the lens's flat face lies {behind:.4g} mm behind its "
            "principal plane, inside the panel; use a thinner lens or a larger gap"
        )
    if display.layers and not traits.touching and air_mm(display) < 0:
        raise DisplayError(
            f"layers = {rows_text(display.layers)!r}: count as "
            f"{air_equivalent_mm(display.layers):.4g} mm of air, and gap_mm = {display.gap_mm:g} "
            f"leaves {display.gap_mm - behind:.4g} mm behind the lens; use a larger gap"
        )


def on_axis_transmittance(display: Display) -> float:
    """Share of light through both faces, (4 n / (n + 1)^2)^2, and the layers, on the axis."""
    n, layers = display.refractive_index, [index for _, index in display.layers]
    touching = lens_traits(display).touching and display.curved_side == "viewer"
    faces = fresnel_on_axis(1.0, n) ** (1 if touching else 2)
    return faces * math.prod(starmap(fresnel_on_axis, pairwise([n if touching else 1.0, *layers])))


def relief_mm(display: Display) -> tuple[float, float]:
    """Curvature of the lens surfaces along the light, mm^-1, and depth of the foot of their
    relief, mm.

    For callers that trace spherical faces with other arithmetic than `Ops`.
    """
    array, traits = lens_array(display), lens_traits(display)
    face = _curved_face(array, traits)
    foot = sag(NUMPY_OPS, face, _reach_squared(array, traits, NUMPY_OPS))
    return float(face.curvature), float(foot)


def trace(
    array: LensArray, traits: LensTraits, ops: Ops, x: Any, y: Any, sx: Any, sy: Any, index: Any
) -> PanelRay:
    """See `inim.display.lens`: where a viewer's ray meets the panel."""
    length = ops.sqrt(sx * sx + sy * sy + 1.0)
    d = (sx / length, sy / length, 1.0 / length)  # in the faces' frame: z is depth
    through = _trace_bulge_first if traits.bulges_to_viewer else _trace_flat_first
    return through(array, traits, ops, x, y, d, index)


def _trace_bulge_first(
    array: LensArray, traits: LensTraits, ops: Ops, x: Any, y: Any, arriving: Any, index: Any
) -> PanelRay:
    """Curved face with its vertex at z = 0, flat face at z = -t."""
    face = _curved_face(array, traits)
    centre_x, centre_y, on_array = lens_centre(array, traits, ops, x, y)
    within = in_aperture(array, traits, x - centre_x, y - centre_y)
    if traits.full_aperture:
        lens = _intersect_relief(array, traits, ops, face, x, y, arriving)
    else:
        lens = _intersect_lens(ops, face, x, y, arriving, (centre_x, centre_y, on_array))
        lens = lens._replace(
            is_hit=lens.is_hit & within & in_aperture(array, traits, lens.x, lens.y)
        )
    d, front = refract(
        ops, arriving, surface_normal(ops, face, lens.x, lens.y, lens.z), 1.0 / index
    )
    u, v = advance(lens.x, lens.y, d, array.thickness - lens.z)
    behind = array.gap - array.thickness / array.design_index
    u, v, d, back = _through_gap(array, traits, ops, u, v, d, index, behind)
    ray = _ray_at_panel(ops, lens, u, v, d, lens.is_hit, front * back)
    past, clear = _through_plate(array, traits, ops, x, y, arriving, index)
    return pass_straight(array, traits, ops, ray, within, on_array, past, clear)


def _trace_flat_first(
    array: LensArray, traits: LensTraits, ops: Ops, x: Any, y: Any, arriving: Any, index: Any
) -> PanelRay:
    """Flat face at z = t/n, vertex of the curved face at z = t/n - t."""
    face = _curved_face(array, traits)
    past, clear = _through_plate(array, traits, ops, x, y, arriving, index)
    x, y = advance(x, y, arriving, -array.thickness / array.design_index)
    inner, front = refract(ops, arriving, _AGAINST_THE_LIGHT, 1.0 / index)
    x, y = advance(x, y, inner, array.thickness)  # on the vertex plane, beyond the face
    lens = _intersect_relief(array, traits, ops, face, x, y, inner)
    d, back = refract(ops, inner, surface_normal(ops, face, lens.x, lens.y, lens.z), index)
    leaves = lens.is_hit & (d[2] > _ALONG_THE_ARRAY)
    d = (d[0], d[1], ops.where(leaves, d[2], 1.0))
    u, v = advance(lens.x, lens.y, d, -lens.z)
    if traits.full_aperture:
        within, on_array = True, True
    else:
        centre_x, centre_y, on_array = lens_centre(array, traits, ops, x, y)
        within = in_aperture(array, traits, lens.x, lens.y) & lens.is_hit
        leaves &= within & in_aperture(array, traits, u, v)
        # A ray of the sheet that ends up in an aperture but on no lens has met a wall.
        within |= in_aperture(array, traits, x - centre_x, y - centre_y)
    u, v, d, layered = _through_gap(array, traits, ops, u, v, d, _AIR, array.gap)
    ray = _ray_at_panel(ops, lens, u, v, d, leaves, front * back * layered)
    return pass_straight(array, traits, ops, ray, within, on_array, past, clear)


class _SurfaceHit(NamedTuple):
    """Intersection with a lens surface: the lens's centre, the point from its vertex, a flag."""

    centre_x: Any
    centre_y: Any
    x: Any
    y: Any
    z: Any
    is_hit: Any


def _curved_face(array: LensArray, traits: LensTraits) -> Face:
    """The curved face; light goes down into the glass or out of it, hence the sign."""
    side = 1.0 if traits.bulges_to_viewer else -1.0
    return Face(
        side / array.radius,
        array.conic if traits.conic else None,
        (side * array.a4, side * array.a6) if traits.asphere else None,
        traits.layout.of_cylinders,
    )


def _reach_squared(array: LensArray, traits: LensTraits, ops: Ops) -> Any:
    """Square of how far a bulge reaches from its axis: to its aperture's corner, or its cell's."""
    cell = traits.layout.reach_squared(array, ops)
    if traits.full_aperture:
        return cell
    half, aspect = array.half_aperture, array.pitch_y / array.pitch_x
    has_corners = not (traits.round_aperture or traits.layout.of_cylinders)
    edge = half * half * (1.0 + aspect * aspect if has_corners else 1.0)
    return ops.where(edge < cell, edge, cell)


def _intersect_lens(
    ops: Ops, face: Face, x: Any, y: Any, d: Any, lens: tuple[Any, Any, Any]
) -> _SurfaceHit:
    """Intersection of a ray through (x, y) of the vertex plane with the face of a given lens."""
    centre_x, centre_y, exists = lens
    x, y = x - centre_x, y - centre_y
    path, is_hit = intersect(ops, face, x, y, d)
    return _SurfaceHit(
        centre_x, centre_y, x + path * d[0], y + path * d[1], path * d[2], is_hit & exists
    )


def _intersect_relief(
    array: LensArray, traits: LensTraits, ops: Ops, face: Face, x: Any, y: Any, d: Any
) -> _SurfaceHit:
    """Intersection of a ray with the relief of all lenses, one solid of overlapping caps.

    At the foot of the relief a ray is inside the glass for certain. The cap of the cell it is in
    there is the deepest around it; where the ray crosses that cap it may lie within the next one's,
    whose cell it is in then, and so on. The relief sinks less steeply than rays do, so there is
    one crossing only: the angle of a ray and that of a bulge's edge add up to less than 90 degrees.
    """
    path = sag(ops, face, _reach_squared(array, traits, ops)) / d[2]
    at_x, at_y = x + path * d[0], y + path * d[1]
    for _ in range(_CELLS_ON_THE_WAY):
        lens = _intersect_lens(ops, face, x, y, d, lens_centre(array, traits, ops, at_x, at_y))
        at_x, at_y = lens.centre_x + lens.x, lens.centre_y + lens.y
    return lens


def _through_gap(
    array: LensArray,
    traits: LensTraits,
    ops: Ops,
    x: Any,
    y: Any,
    d: Any,
    medium: Any,
    air_equivalent: Any,
) -> tuple[Any, Any, Any, Any]:
    """Ray from the back of a lens to the panel, through air and layers.

    * `medium`: refractive index around the ray, the lens's before its flat face.
    * `air_equivalent`: length of the way along the axis, mm.

    Returns the panel point, the direction next to the lens, and the transmittance.
    """
    for thickness, index in array.layers:
        air_equivalent = air_equivalent - thickness / index
    air = [] if traits.touching else [(air_equivalent, _AIR)]
    first, transmittance = None, 1.0
    for thickness, index in (*air, *array.layers):
        if index is not medium:
            d, passing = refract(ops, d, _AGAINST_THE_LIGHT, medium / index)
            transmittance = transmittance * passing
        x, y = advance(x, y, d, thickness)
        first, medium = first or d, index
    return x, y, first, transmittance


def _through_plate(
    array: LensArray, traits: LensTraits, ops: Ops, x: Any, y: Any, d: Any, index: Any
) -> tuple[tuple[Any, Any, Any, Any], Any]:
    """Ray outside the lenses, through a plate of the sheet's thickness, and its transmittance.

    As if it went straight on from the plane z = 0, also through the layers.
    """
    inner, one_face = refract(ops, d, _AGAINST_THE_LIGHT, 1.0 / index)
    x, y = advance(x, y, d, -array.thickness / array.design_index)
    x, y = advance(x, y, inner, array.thickness)
    transmittance = one_face * one_face
    if array.layers:
        no_air = traits._replace(touching=True)
        if traits.touching and traits.bulges_to_viewer:
            x, y, _, layered = _through_gap(array, no_air, ops, x, y, inner, index, 0.0)
            transmittance = one_face * layered
        else:
            x, y, _, layered = _through_gap(array, no_air, ops, x, y, d, _AIR, 0.0)
            transmittance = transmittance * layered
        x, y = advance(x, y, d, -sum(thickness / n for thickness, n in array.layers))
    return (x, y, d[0] / d[2], d[1] / d[2]), transmittance


def _ray_at_panel(
    ops: Ops, lens: _SurfaceHit, u: Any, v: Any, d: Any, passes: Any, transmittance: Any
) -> PanelRay:
    """The ray of a lens at the panel; `u` and `v` are seen from the lens's axis."""
    return PanelRay(
        lens.centre_x + u,
        lens.centre_y + v,
        d[0] / d[2],
        d[1] / d[2],
        ops.where(passes, transmittance, 0.0),
    )


MODEL = LensModel(
    "thick",
    summary="plano-convex lens, refracted exactly at both faces",
    trace=trace,
    check=check,
    transmittance=on_axis_transmittance,
    stand_in="thin",
    steepest_slope=1.0,
    least_index=1.01,
)
