"""Interface of lens models, and refraction at one face for models that trace it.

Frame of a face: origin at its vertex, z along the light's direction (depth), as in lens design: a
face whose centre of curvature is behind it has a positive curvature. Its sag is::

    z(r) = c r^2 / (1 + sqrt(1 - (1 + k) c^2 r^2)) + a4 r^4 + a6 r^6

(Spencer and Murty, J. Opt. Soc. Am. 52, 672, 1962, who also give the vector form of Snell's law.)
Roots are written without cancellation: float32 is sufficient for panel points.
"""

import math
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import Any, NamedTuple

import numpy as np

from inim.display import Display
from inim.display.lens.array import LensArray, LensTraits, Ops, PanelRay
from inim.system.errors import UsageError

#: (array, traits, ops, x, y, sx, sy, index) to the ray at the panel; see `inim.display.lens`.
Trace = Callable[[LensArray, LensTraits, Ops, Any, Any, Any, Any, Any], PanelRay]


@dataclass(frozen=True)
class SheetMesh:
    """A closed body, display frame, millimetres; faces run counter-clockwise seen from outside."""

    #: (n, 3) float64: normals point outwards and are those of the exact surface.
    vertices: np.ndarray
    normals: np.ndarray
    faces: np.ndarray  #: (m, 3) uint32
    is_glass: np.ndarray  #: (m,) bool: which faces refract; the others are the black mount.
    front_mm: float  #: Largest z.
    #: z of the flat face, and of the rear principal plane.
    flat_mm: float
    rear_principal_mm: float
    facet_error_mm: float  #: How far, along z, facets depart from the curved face at most.


def _accept_any(_: Display) -> None:
    pass  # every display is possible; a docstring here would become an ambiguous link on the site


def _lossless(display: Display) -> float:  # noqa: ARG001
    """All light gets through."""
    return 1.0


@dataclass(frozen=True)
class LensModel:
    """Lens model: a function `trace`, or a `mesh` through which the renderer traces rays.

    Attributes
    ----------
    name : str
        Name in settings.
    summary : str
        One line.
    trace : callable, optional
        See `inim.display.lens`. It runs in NumPy and in the renderer, and determines in advance the
        panel pixels of a view.
    mesh : callable, optional
        From a `Display` to its lens array as a `SheetMesh`. It is path traced: rays scatter between
        the lenses, and any panel pixel may contribute.
    check : callable
        Function of a `Display` that raises `DisplayError` if its lenses are impossible for the
        model, such as a thick lens that cannot be manufactured.
    transmittance : callable
        From a `Display` to the share of the panel's light, above 0, that its lenses transmit along
        the axis. The exposure of views is its inverse.
    refracts : bool
        True if the material's index matters: only then are colours traced separately.
    stand_in : str
        Simpler replacement for this model: in `inim inspect` if it is a mesh or, as the default,
        rejects the display; and in the virtual display, which draws only models that are their own
        replacement.
    steepest_slope : float
        Sideways travel per millimetre of the steepest ray with tested float32 accuracy.
    least_index : float
        Smallest refractive index with sufficient digits in float32.

    Raises
    ------
    UsageError
        Neither `trace` nor `mesh`, or both.
    """

    name: str
    _: KW_ONLY
    summary: str
    trace: Trace | None = None
    mesh: Callable[[Display], SheetMesh] | None = None
    check: Callable[[Display], None] = _accept_any
    transmittance: Callable[[Display], float] = _lossless
    refracts: bool = True
    stand_in: str = "thin"
    steepest_slope: float = math.inf
    least_index: float = 1.0

    def __post_init__(self) -> None:
        if callable(self.trace) == callable(self.mesh):
            raise UsageError(f"lens model {self.name!r}: define exactly one of trace and mesh")

    def traced_without_renderer(self) -> Trace:
        """The model's `trace`.

        Raises
        ------
        UsageError
            The model is a mesh, which only the renderer can trace.
        """
        if self.trace is None:
            raise UsageError(
                f"lens model {self.name!r} is traced by the renderer only; use "
                f"{self.stand_in!r} here"
            )
        return self.trace


# Newton's steps from the conic to the asphere: quadratic, so that the fourth is below rounding for
# any face that is nearly a conic; one to spare for those that are not.
_NEWTON_STEPS = 5
# How far off an asphere, in radii of curvature, a ray counts as meeting it: some float32 roundings.
_ON_FACE = 3e-6


class Face(NamedTuple):
    """Face of revolution, or cylinder; absent terms are None and are not computed."""

    curvature: Any  #: c = 1 / R, mm^-1; 0 for a plane.
    conic: Any = None  #: k: 0 or None for a sphere, -1 for a paraboloid.
    asphere: tuple[Any, Any] | None = None  #: (a4, a6), optional: mm^-3 and mm^-5.
    cylinder: bool = False  #: r is abs(x): no curvature along y.


def _under_root(face: Face, r_squared: Any) -> Any:
    """1 - (1 + k) c^2 r^2: above zero where the conic reaches."""
    stretch = 1.0 if face.conic is None else 1.0 + face.conic
    return 1.0 - stretch * (face.curvature * face.curvature) * r_squared


def sag(ops: Ops, face: Face, r_squared: Any) -> Any:
    """Depth of the face below its vertex plane at r^2, in millimetres."""
    under = _under_root(face, r_squared)
    depth = face.curvature * r_squared / (1.0 + ops.sqrt(ops.where(under > 0, under, 0.0)))
    if face.asphere is None:
        return depth
    a4, a6 = face.asphere
    return depth + (a4 + a6 * r_squared) * (r_squared * r_squared)


def steepness(ops: Ops, face: Face, r_squared: Any) -> Any:
    """The sag's slope over the radius, z'(r) / r, mm^-1."""
    under = _under_root(face, r_squared)
    slope = face.curvature / ops.sqrt(ops.where(under > 0, under, 1.0))
    if face.asphere is None:
        return slope
    a4, a6 = face.asphere
    return slope + (4.0 * a4 + 6.0 * a6 * r_squared) * r_squared


def intersect(ops: Ops, face: Face, x: Any, y: Any, d: Any) -> tuple[Any, Any]:
    """Path along a ray from the vertex plane to the face, and whether the ray meets it.

    * `x`, `y`: intersection of the ray with the vertex plane z = 0, mm.
    * `d`, (dx, dy, dz): unit vector along the light, dz > 0.

    Returns `path`, `is_hit`: millimetres, negative if the face is in front of its vertex plane. Of
    a conic's two intersections it is the one next to the vertex.
    """
    c = face.curvature
    bent = c * c if face.conic is None else c * c * (1.0 + face.conic * (d[2] * d[2]))
    if face.cylinder:  # only the ray's projection on x and z counts, which is no unit vector
        y = 0.0 * y
        bent = bent - c * c * (d[1] * d[1])
        d = (d[0], 0.0 * d[1], d[2])
    r_squared = x * x + y * y
    ahead = d[2] - c * (x * d[0] + y * d[1])
    under = ahead * ahead - bent * r_squared
    is_hit = (under > 0) & (ahead > 0)
    path = c * r_squared / ops.where(is_hit, ahead + ops.sqrt(ops.where(is_hit, under, 0.0)), 1.0)
    if face.asphere is None:
        return path, is_hit
    return _meet_asphere(ops, face, x, y, d, path)


def _meet_asphere(ops: Ops, face: Face, x: Any, y: Any, d: Any, path: Any) -> tuple[Any, Any]:
    """Path from the conic to the asphere by Newton's method, with a fixed number of steps."""
    for _ in range(_NEWTON_STEPS):
        px, py = x + path * d[0], y + path * d[1]
        r_squared = px * px + py * py
        above = sag(ops, face, r_squared) - path * d[2]
        closing = d[2] - steepness(ops, face, r_squared) * (px * d[0] + py * d[1])
        step = above / ops.where(closing > 0, closing, 1.0)
        # No face is met a radius off its conic: a ray that misses would run away.
        path = path + ops.where(ops.absolute(step * face.curvature) < 1, step, 0.0)
    px, py = x + path * d[0], y + path * d[1]
    r_squared = px * px + py * py
    above = (sag(ops, face, r_squared) - path * d[2]) * face.curvature
    return path, (ops.absolute(above) < _ON_FACE) & (_under_root(face, r_squared) > 0)


def surface_normal(ops: Ops, face: Face, x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
    """Unit normal at a point of the face, against the light."""
    if face.cylinder:
        y = 0.0 * y
    if face.asphere is None:
        c = face.curvature
        if face.conic is None:
            return c * x, c * y, c * z - 1.0
        # On a conic the gradient's length is known: 1 - k c^2 r^2 is its square.
        length = ops.sqrt(1.0 - face.conic * (c * c) * (x * x + y * y))
        return c * x / length, c * y / length, (c * (1.0 + face.conic) * z - 1.0) / length
    r_squared = x * x + y * y
    slope = steepness(ops, face, r_squared)
    length = ops.sqrt(1.0 + slope * slope * r_squared)
    return slope * x / length, slope * y / length, -1.0 / length


def refract(ops: Ops, d: Any, against: Any, ratio: Any) -> tuple[tuple[Any, Any, Any], Any]:
    """Snell's law in vector form, and Fresnel's transmittance of unpolarised light.

    * `d`, `against`, (x, y, z): the ray's unit vector, and the face's normal against it.
    * `ratio`: index in front of the face over the index behind it.

    Returns `d`, `transmittance`: the refracted unit vector; 0 under total reflection and on a face
    met from behind.
    """
    cos_in = -(d[0] * against[0] + d[1] * against[1] + d[2] * against[2])
    under = 1.0 - ratio * ratio * (1.0 - cos_in * cos_in)
    passes = (under > 0) & (cos_in > 0)
    cos_out = ops.sqrt(ops.where(passes, under, 1.0))
    bend = ratio * cos_in - cos_out
    x, y, z = (ratio * a + bend * b for a, b in zip(d, against, strict=True))
    r_s = bend / ops.where(passes, ratio * cos_in + cos_out, 1.0)
    r_p = (cos_in - ratio * cos_out) / ops.where(passes, cos_in + ratio * cos_out, 1.0)
    return (x, y, z), ops.where(passes, 1.0 - 0.5 * (r_s * r_s + r_p * r_p), 0.0)


def fresnel_on_axis(before: float, behind: float) -> float:
    """Fresnel's transmittance of a face between two indices at normal incidence."""
    return 4 * before * behind / (before + behind) ** 2


def advance(x: Any, y: Any, d: Any, depth: Any) -> tuple[Any, Any]:
    """Follow a ray for a depth; behind where it is (negative) as well."""
    return x + d[0] / d[2] * depth, y + d[1] / d[2] * depth
