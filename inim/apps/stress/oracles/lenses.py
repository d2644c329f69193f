"""Oracle of the lens models: the same optics by other methods, in `numpy.longdouble`.

It is written from the docstrings of `inim.display.lens` and `inim.display`. It intersects the
curved face by Newton's method on the sag, for any shape; the lens models solve a quadratic
equation. It applies Snell's law to the tangential part of the ray; the lens models use the vector
form. `numpy.longdouble` has a mantissa of 64 bits on x86 processors and may be as narrow as float64
on others. The report lists its width.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from inim.apps.stress.oracles.rays import all_centres
from inim.display import Display

WIDE = np.longdouble
_NEWTON_STEPS = 16
# Points on the path from one bulge to the next that are tested for a second hit.
_PATH_POINTS = 16


@dataclass(frozen=True)
class LensRays:
    """Rays that cross z = 0 at (x, y) and travel (sx, sy) sideways per mm away from the viewer."""

    x: np.ndarray
    y: np.ndarray
    sx: np.ndarray
    sy: np.ndarray


@dataclass(frozen=True)
class Landing:
    """Landing points of rays on the panel (mm), their light, and distances to decisions.

    Attributes
    ----------
    x, y, weight : (n,) longdouble
        NaN and 0 if no light passes.
    edge : (n,) longdouble
        Smallest distance of the entry point from a border between lenses, in pitches.
    reflection : (n,) longdouble
        Smallest distance of sin^2 of the refracted angle from 1, the start of total reflection.
    """

    x: np.ndarray
    y: np.ndarray
    weight: np.ndarray
    edge: np.ndarray
    reflection: np.ndarray


def land(display: Display, model: str, rays: LensRays, index: float | None = None) -> Landing:
    """Trace rays through a display; `index` replaces the lenses' index, but moves no face."""
    x, y, sx, sy = (np.asarray(a, WIDE) for a in (rays.x, rays.y, rays.sx, rays.sy))
    turn = np.radians(WIDE(display.rotation_deg))
    c, s = np.cos(turn), np.sin(turn)
    x, y = x - WIDE(display.shift_x_mm), y - WIDE(display.shift_y_mm)
    x, y, sx, sy = c * x + s * y, c * y - s * x, c * sx + s * sy, c * sy - s * sx
    n = WIDE(display.refractive_index if index is None else index)
    with np.errstate(all="ignore"):
        px, py, qx, qy, weight, edge, reflection = _MODELS[model](display, x, y, sx, sy, n)
        if display.between_lenses == "clear":
            # Past the apertures, the bare sheet.
            cx, cy, inside, _ = _lens_over(display, x, y)
            past = inside & ~_in_aperture(display, x - cx, y - cy)[0]
            bare = _plate(display, x, y, sx, sy, n, thick=model == "thick")
            px, py, qx, qy, weight = (
                np.where(past, a, b) for a, b in zip(bare, (px, py, qx, qy, weight), strict=True)
            )
        px, py = c * px - s * py, c * py + s * px
        qx, qy = c * qx - s * qy, c * qy + s * qx
        px, py = px + WIDE(display.shift_x_mm), py + WIDE(display.shift_y_mm)
        # The tilted panel is g + tx x + ty y behind the array.
        tx, ty = (np.tan(np.radians(WIDE(a))) for a in (display.tilt_x_deg, display.tilt_y_deg))
        extra = (tx * px + ty * py) / (1 - tx * qx - ty * qy)
        px, py = px + extra * qx, py + extra * qy
    dark = ~(weight > 0)
    nan = WIDE(np.nan)
    return Landing(
        np.where(dark, nan, px),
        np.where(dark, nan, py),
        np.where(dark, WIDE(0), weight),
        edge,
        reflection,
    )


def _lens_over(display: Display, x: Any, y: Any) -> tuple[Any, Any, Any, Any]:
    """Centre of the nearest lens, existence of the lens, distance from the next cell in pitches."""
    pitch = WIDE(display.pitch_mm)
    if display.lattice == "lenticular":
        place = x / pitch
        column = np.rint(place)
        return column * pitch, y, np.ones(np.shape(x), bool), 0.5 - np.abs(place - column)
    if display.lattice == "square":
        centre, distance, inside = [], [], np.ones(np.shape(x), bool)
        for place, step, count in (
            (x, pitch, display.lens_columns), (y, WIDE(display.row_pitch_mm), display.lens_rows)
        ):  # fmt: skip
            cell = place / step + WIDE(count) / 2
            index = np.floor(cell)
            inside &= (index >= 0) & (index < count)
            centre.append((index + WIDE(0.5) - WIDE(count) / 2) * step)
            distance.append(np.abs(cell - np.rint(cell)))
        return centre[0], centre[1], inside, np.minimum(*distance)
    straight = display.replace(rotation_deg=0.0, shift_x_mm=0.0, shift_y_mm=0.0)
    centre_x, centre_y, has_lens = all_centres(straight, display.pitch_mm)
    apart = np.hypot(x[:, None] - centre_x, y[:, None] - centre_y)
    nearest = np.argmin(np.where(np.isnan(apart), np.inf, apart), axis=1)
    first, second = np.partition(apart, 1, axis=1)[:, :2].T
    # Distances change up to twice as fast as the point moves.
    margin = (second - first) / 2 / pitch
    return centre_x[nearest], centre_y[nearest], has_lens[nearest], margin


def _in_aperture(display: Display, dx: Any, dy: Any) -> tuple[Any, Any]:
    """Membership of a point in its lens's aperture, and its distance from the edge in pitches."""
    pitch, half = WIDE(display.pitch_mm), WIDE(display.fill_factor) * WIDE(display.pitch_mm) / 2
    if display.aperture == "round" and display.lattice != "lenticular":
        left = half - np.hypot(dx, dy)
    elif display.fill_factor == 1:
        return np.ones(np.shape(dx), bool), np.full(np.shape(dx), WIDE(1))
    else:
        left = half - np.abs(dx)
        if display.lattice != "lenticular":
            half_y = half * WIDE(display.row_pitch_mm) / pitch
            left = np.minimum(left, half_y - np.abs(dy))
    return left >= 0, np.abs(left) / pitch


def _plate(
    display: Display, x: Any, y: Any, sx: Any, sy: Any, n: Any, *, thick: bool
) -> tuple[Any, ...]:
    """A ray past the lenses: straight on, or through the sheet as a plate and the layers."""
    g, t = WIDE(display.gap_mm), _thickness(display)
    if not thick:
        return x + g * sx, y + g * sy, sx, sy, np.ones(np.shape(x), WIDE)
    d = _direction(sx, sy)
    inner, first, _ = _refract(d, _flat(x), WIDE(1), n)
    p = np.stack([x - t / WIDE(display.refractive_index) * sx,
                  y - t / WIDE(display.refractive_index) * sy, np.zeros_like(x)])  # fmt: skip
    p = _to_plane(p, inner, -t)
    p, weight, _ = _gap(display, p, d, WIDE(1), g)
    return p[0], p[1], sx, sy, weight * first * first


def _pinhole(display: Display, x: Any, y: Any, sx: Any, sy: Any, n: Any) -> tuple[Any, ...]:  # noqa: ARG001
    """Straight ray through the lens centre."""
    cx, cy, inside, edge = _lens_over(display, x, y)
    within, rim = _in_aperture(display, x - cx, y - cy)
    g = WIDE(display.gap_mm)
    far = np.full(np.shape(x), WIDE(1))
    weight = (inside & within) * WIDE(1)
    return cx + g * sx, cy + g * sy, sx, sy, weight, np.minimum(edge, rim), far


def _thin(display: Display, x: Any, y: Any, sx: Any, sy: Any, n: Any) -> tuple[Any, ...]:
    """Line from the crossing point to the focus of the parallel bundle in the focal plane."""
    cx, cy, inside, edge = _lens_over(display, x, y)
    within, rim = _in_aperture(display, x - cx, y - cy)
    # Radii are fixed: the focal length is in inverse proportion to n - 1.
    f = WIDE(display.focal_length_mm) * (WIDE(display.refractive_index) - 1) / (n - 1)
    g = WIDE(display.gap_mm)
    focus_x, focus_y = cx + f * sx, cy + f * sy
    qx, qy = (focus_x - x) / f, (focus_y - y) / f
    far = np.full(np.shape(x), WIDE(1))
    weight = (inside & within) * WIDE(1)
    return x + g * qx, y + g * qy, qx, qy, weight, np.minimum(edge, rim), far


def _thickness(display: Display) -> Any:
    return WIDE(
        display.pitch_mm if display.lens_thickness_mm is None else display.lens_thickness_mm
    )


def _direction(sx: Any, sy: Any) -> Any:
    length = np.sqrt(sx * sx + sy * sy + 1)
    return np.stack([sx / length, sy / length, -1 / length])


def _flat(x: Any) -> Any:
    return np.stack([np.zeros_like(x), np.zeros_like(x), np.ones_like(x)])


def _gap(display: Display, p: Any, d: Any, medium: Any, gap: Any) -> tuple[Any, Any, Any]:
    """Path through the rest of an air-equivalent gap and its layers, and its transmittance."""
    layers = [(WIDE(t), WIDE(index)) for t, index in display.layers]
    air = gap - sum(t / index for t, index in layers)
    weight, away = np.ones_like(p[0]), np.ones_like(p[0])
    touching = bool(layers) and abs(air) < 1e-3
    for t, index in (*(() if touching else ((air, WIDE(1)),)), *layers):
        d, share, far = _refract(d, _flat(p[0]), medium, index)
        weight, away = weight * share, np.fmin(away, far)
        p = _to_plane(p, d, p[2] - t)
        medium = index
    return p, weight, away


def _thick(display: Display, x: Any, y: Any, sx: Any, sy: Any, n: Any) -> tuple[Any, ...]:
    """Plano-convex lens: Snell's law at both faces, losses by Fresnel's equations."""
    t, design = _thickness(display), WIDE(display.refractive_index)
    d = _direction(sx, sy)
    if display.curved_side == "viewer":
        cx, cy, _, rim = _lens_over(display, x, y)
        within, edge0 = _in_aperture(display, x - cx, y - cy)
        p, normal, inside, edge, hit_rim = _meet(display, x, y, d, towards_viewer=True)
        rim = np.fmin(rim if _has_gaps(display) else WIDE(1), np.fmin(edge0, hit_rim[1]))
        d, first, away = _refract(d, normal, WIDE(1), n)
        p = _to_plane(p, d, -t)
        p, second, away2 = _gap(display, p, d, n, WIDE(display.gap_mm) - t / design)
        d, _, _ = _refract(d, _flat(x), n, WIDE(1))
        inside = inside & within & hit_rim[0]
    else:
        p = np.stack([x, y, np.zeros_like(x)])
        p = _to_plane(p, d, t / design)
        d, first, away = _refract(d, _flat(x), WIDE(1), n)
        vertex = t / design - t
        p = _to_plane(p, d, vertex)
        # Walls of holes: rays that change between a hole and the sheet have no definition.
        lens = _lens_over(display, x, y)[:2]
        above, _ = _in_aperture(display, x - lens[0], y - lens[1])
        cx, cy, _, _ = _lens_over(display, p[0], p[1])
        on_wall = above != _in_aperture(display, p[0] - cx, p[1] - cy)[0]
        for depth in (0, display.pitch_mm / 2):  # at the vertices, and above the relief
            cx, cy, _, _ = _lens_over(display, *_to_plane(p, d, vertex + depth)[:2])
            on_wall |= _has_gaps(display) & ((cx != lens[0]) | (cy != lens[1]))
        p, normal, inside, edge, (hit_within, rim) = _meet(
            display, p[0], p[1], d, towards_viewer=False
        )
        d, second, away2 = _refract(d, normal, n, WIDE(1))
        is_hit, distance = _hits_other_bulge(display, p, d)
        inside, edge = inside & ~is_hit & (d[2] < 0), np.fmin(edge, distance)
        cx, cy, _, _ = _lens_over(display, p[0], p[1])
        p = _to_plane(p, d, WIDE(0))
        leaves, leaving = _in_aperture(display, p[0] - cx, p[1] - cy)
        on_wall |= above != hit_within
        inside, rim = inside & hit_within & leaves, np.where(on_wall, 0, np.fmin(rim, leaving))
        p, layered, _ = _gap(display, p, d, WIDE(1), WIDE(display.gap_mm))
        second = second * layered
    edge = np.fmin(edge, rim)
    weight = np.where(inside, np.nan_to_num(first * second), 0)
    return p[0], p[1], -d[0] / d[2], -d[1] / d[2], weight, edge, np.fmin(away, away2)


def _has_gaps(display: Display) -> bool:
    return display.aperture == "round" or display.fill_factor < 1


def _to_plane(p: Any, d: Any, z: Any) -> Any:
    return p + d * ((z - p[2]) / d[2])


def _neighbours(display: Display) -> list[tuple[float, float]]:
    """Centres about a lens, in pitches to the right and row pitches up; without gaps only."""
    if _has_gaps(display):
        return []
    neighbours: dict[str, list[tuple[float, float]]] = {
        "square": [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j],
        "hexagonal": [(-1, 0), (1, 0), *((i, j) for i in (-0.5, 0.5) for j in (-1, 1))],
        "lenticular": [(-1, 0), (1, 0)],
    }
    return neighbours[display.lattice]


def _meet(
    display: Display, x: Any, y: Any, d: Any, *, towards_viewer: bool
) -> tuple[Any, Any, Any, Any, tuple[Any, Any]]:
    """Point where a ray through (x, y) of the vertex plane meets the relief, z from that plane.

    The bulges are one solid of overlapping caps. The candidates are the cap of the lens at (x, y)
    and its neighbours. An entering ray meets the highest cap, a leaving ray the lowest. Lenses with
    gaps between them have no overlap. The last result is whether the point is in the aperture.
    """
    pitch, row_pitch = WIDE(display.pitch_mm), WIDE(display.row_pitch_mm)
    cx, cy, _, _ = _lens_over(display, x, y)
    best, second, slope = (np.full_like(x, np.nan) for _ in range(3))
    point, middle = np.full((3, *x.shape), WIDE(np.nan)), np.stack([cx, cy])
    side = WIDE(1 if towards_viewer else -1)
    for right, up in ((0, 0), *_neighbours(display)):
        lens = np.stack([cx + right * pitch, cy + up * row_pitch])
        p, s = _newton(display, x, y, lens[0], lens[1], d, towards_viewer)
        height = side * p[2]
        ahead = np.isfinite(height) & ~(height <= best)
        second = np.where(ahead, best, np.fmax(second, height))
        best, slope = np.where(ahead, height, best), np.where(ahead, s, slope)
        point, middle = np.where(ahead, p, point), np.where(ahead, lens, middle)
    # The order of two caps is a decision, as a border between cells is.
    _, _, inside, edge = _lens_over(display, point[0], point[1])
    edge = np.fmin(edge, np.nan_to_num((best - second) / pitch, nan=1.0))
    # The face is z = -side sag(q), q = r^2. The normal points against the ray.
    tilt = 2 * side * slope * (point[:2] - middle)
    if display.lattice == "lenticular":
        tilt[1] = 0
    normal = np.concatenate([tilt, np.ones_like(tilt[:1])])
    normal /= np.sqrt((normal**2).sum(axis=0))
    within = _in_aperture(display, point[0] - middle[0], point[1] - middle[1])
    return point, normal, inside & np.isfinite(point[0]), edge, within


def _hits_other_bulge(display: Display, p: Any, d: Any) -> tuple[Any, Any]:
    """Rays that enter another bulge before the vertex plane, and the distance to this decision.

    Tests points on the path from `p`, whose z is relative to the vertex plane.
    """
    cx, cy, _, _ = _lens_over(display, p[0], p[1])
    deepest = np.full_like(p[0], -np.inf)
    pitch, row_pitch = WIDE(display.pitch_mm), WIDE(display.row_pitch_mm)
    for share in np.linspace(0, 1, _PATH_POINTS + 1, dtype=WIDE)[1:]:
        z = p[2] * (1 - share)
        x, y = p[0] + d[0] / d[2] * (z - p[2]), p[1] + d[1] / d[2] * (z - p[2])
        for right, up in _neighbours(display):
            q = (x - cx - right * pitch) ** 2
            if display.lattice != "lenticular":
                q = q + (y - cy - up * row_pitch) ** 2
            deepest = np.fmax(deepest, z - _sag(display, q)[0])
    return deepest > 0, np.abs(deepest) / pitch


def _newton(
    display: Display, x: Any, y: Any, cx: Any, cy: Any, d: Any, towards_viewer: bool
) -> tuple[Any, Any]:
    """Point where a ray meets the face, by Newton's method, and d sag / d q there."""
    side = WIDE(1 if towards_viewer else -1)
    ux, uy = d[0] / d[2], d[1] / d[2]
    z, flat_along_y = np.zeros_like(x), WIDE(display.lattice != "lenticular")
    for _ in range(_NEWTON_STEPS):
        px, py = x - cx + ux * z, flat_along_y * (y - cy + uy * z)
        sag, slope = _sag(display, px * px + py * py)
        z = z - (z + side * sag) / (1 + side * slope * 2 * (px * ux + py * uy * flat_along_y))
    px, py = x - cx + ux * z, flat_along_y * (y - cy + uy * z)
    sag, slope = _sag(display, px * px + py * py)
    # Rays that miss the face do not converge.
    converged = np.abs(z + side * sag) <= 1e-12 * WIDE(display.pitch_mm)
    z = np.where(converged, z, WIDE(np.nan))
    return np.stack([x + ux * z, y + uy * z, z]), slope


def _sag(display: Display, q: Any) -> tuple[Any, Any]:
    """Depth of the curved face below its vertex at q = r^2, and its derivative by q."""
    curvature = 1 / (WIDE(display.focal_length_mm) * (WIDE(display.refractive_index) - 1))
    root = np.sqrt(1 - (1 + WIDE(display.conic)) * curvature * curvature * q)
    a4, a6 = WIDE(display.asphere_a4), WIDE(display.asphere_a6)
    sag = curvature * q / (1 + root) + a4 * q * q + a6 * q**3
    return sag, curvature / (2 * root) + 2 * a4 * q + 3 * a6 * q * q


def _refract(d: Any, normal: Any, n1: Any, n2: Any) -> tuple[Any, Any, Any]:
    """Refracted direction, transmitted share of unpolarised light, distance to total reflection."""
    cos1 = -(d * normal).sum(axis=0)
    tangential = (d + cos1 * normal) * (n1 / n2)
    sine2 = (tangential**2).sum(axis=0)
    cos2 = np.sqrt(1 - sine2)
    out = tangential - cos2 * normal
    s = ((n1 * cos1 - n2 * cos2) / (n1 * cos1 + n2 * cos2)) ** 2
    p = ((n2 * cos1 - n1 * cos2) / (n2 * cos1 + n1 * cos2)) ** 2
    return out, 1 - (s + p) / 2, np.abs(1 - sine2)


_MODELS = {"pinhole": _pinhole, "thin": _thin, "thick": _thick}
