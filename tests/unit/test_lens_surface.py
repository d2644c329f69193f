"""One refracting face: met, refracted, reversed; and a camera lens of eleven of them."""

import math

import numpy as np
import pytest

from inim.display.lens.array import NUMPY_OPS as OPS
from inim.display.lens.model import (
    Face,
    advance,
    intersect,
    refract,
    sag,
    steepness,
    surface_normal,
)

FACES = {
    "plane": Face(0.0),
    "sphere": Face(1 / 1.475),
    "sphere, hollow": Face(-1 / 1.475),
    "paraboloid": Face(1 / 1.475, -1.0),
    "hyperboloid": Face(1 / 1.475, -2.2),
    "oblate": Face(1 / 1.475, 0.4),
    "asphere": Face(1 / 1.475, -0.6, (0.02, -0.015)),
    "asphere, hollow": Face(-1 / 1.475, None, (-0.03, 0.01)),
}


def rays(count=2000, reach=0.7, steepest_deg=40.0, seed=1, dtype=np.float64):
    """Points of the vertex plane and unit vectors along the light."""
    random = np.random.default_rng(seed)
    x, y = random.uniform(-reach / math.sqrt(2), reach / math.sqrt(2), (2, count))
    slope = np.tan(np.radians(random.uniform(0, steepest_deg, count)))
    turn = random.uniform(0, 2 * np.pi, count)
    length = np.sqrt(1 + slope**2)
    d = (slope * np.cos(turn) / length, slope * np.sin(turn) / length, 1 / length)
    return x.astype(dtype), y.astype(dtype), tuple(a.astype(dtype) for a in d)


def points(face, x, y, d):
    path, hits = intersect(OPS, face, x, y, d)
    return x + path * d[0], y + path * d[1], path * d[2], hits


def implicit(face, x, y, z):
    """Distance of a point from the face by the conic's equation: r^2 - 2 R z + (1 + k) z^2."""
    r_squared = x**2 + y**2
    c, k = face.curvature, face.conic or 0.0
    if face.asphere is None:
        return (c * r_squared - 2 * z + c * (1 + k) * z**2) / 2
    conic_z = z - face.asphere[0] * r_squared**2 - face.asphere[1] * r_squared**3
    return (c * r_squared - 2 * conic_z + c * (1 + k) * conic_z**2) / 2


@pytest.mark.parametrize("name", FACES)
def test_rays_end_on_the_face(name):
    face = FACES[name]
    x, y, z, hits = points(face, *rays())
    assert hits.mean() > 0.95
    assert np.abs(implicit(face, x, y, z))[hits].max() < 1e-14
    # Next to the vertex, not on the far side of the ball.
    assert np.abs(z[hits]).max() < 0.9
    assert np.abs(z - sag(OPS, face, x**2 + y**2))[hits].max() < 1e-13


def test_a_ray_that_misses_the_ball_has_no_hit():
    ball = Face(1.0)
    straight = tuple(np.array([a]) for a in (0.0, 0.0, 1.0))
    for height, expected in ((0.999, True), (1.001, False)):
        assert intersect(OPS, ball, np.array([height]), np.zeros(1), straight)[1] == expected
    bumpy = Face(1.0, None, (1e-3, 0.0))
    path, hits = intersect(
        OPS, bumpy, np.array([1.2, 0.5]), np.zeros(2), (*straight[:2], np.ones(2))
    )
    assert list(hits) == [False, True]
    assert np.isfinite(path).all()


@pytest.mark.parametrize("name", FACES)
def test_the_normal_has_length_one_and_follows_the_face(name):
    """Against differences of the sag."""
    face = FACES[name]
    x, y, d = rays()
    x, y, z, hits = points(face, x, y, d)
    n = surface_normal(OPS, face, x, y, z)
    length = np.broadcast_to(np.sqrt(sum(a * a for a in n)), x.shape)
    assert np.abs(length - 1)[hits].max() < 1e-13
    h = 1e-5
    for offset, part in (((h, 0), 0), ((0, h), 1)):
        ahead = sag(OPS, face, (x + offset[0]) ** 2 + (y + offset[1]) ** 2)
        behind = sag(OPS, face, (x - offset[0]) ** 2 + (y - offset[1]) ** 2)
        slope = (ahead - behind) / (2 * h)
        assert np.abs(-n[part] / n[2] - slope)[hits].max() < 1e-8
    r = np.linspace(0.05, 0.7, 30)
    differences = (sag(OPS, face, (r + h) ** 2) - sag(OPS, face, (r - h) ** 2)) / (2 * h)
    assert steepness(OPS, face, r**2) * r == pytest.approx(differences, abs=1e-8)


@pytest.mark.parametrize("ratio", [1 / 1.4917, 1.4917], ids=["into glass", "out of glass"])
@pytest.mark.parametrize("name", FACES)
def test_refraction_keeps_snell_s_law_and_the_length(name, ratio):
    face = FACES[name]
    x, y, d = rays()
    x, y, z, hits = points(face, x, y, d)
    n = surface_normal(OPS, face, x, y, z)
    out, transmittance = refract(OPS, d, n, ratio)
    passes = hits & (transmittance > 0)
    assert passes.mean() > 0.5
    n, d, out = (np.stack([b * np.ones_like(x) for b in a], -1) for a in (n, d, out))
    assert np.abs(np.linalg.norm(out, axis=-1) - 1)[passes].max() < 1e-13
    # n1 (d x N) = n2 (out x N): the law, and that the ray stays in the plane of incidence.
    residual = ratio * np.cross(d, n) - np.cross(out, n)
    assert np.abs(residual)[passes].max() < 1e-13
    sine = np.linalg.norm(np.cross(d, n), axis=-1)
    assert ((transmittance == 0) == (ratio * sine >= 1))[hits].all(), "total reflection, only"


def test_fresnel_s_share_is_that_of_the_angles():
    """Sines and tangents of sum and difference; at Brewster's angle half of the light is kept."""
    incidence = np.radians(np.linspace(0.5, 89, 60))
    d = (np.sin(incidence), np.zeros(60), np.cos(incidence))
    _, transmittance = refract(OPS, d, (0.0, 0.0, -1.0), 1 / 1.5)
    t = np.arcsin(np.sin(incidence) / 1.5)
    s = np.sin(incidence - t) ** 2 / np.sin(incidence + t) ** 2
    p = np.tan(incidence - t) ** 2 / np.tan(incidence + t) ** 2
    assert transmittance == pytest.approx(1 - (s + p) / 2, abs=1e-12)
    # The way back loses as much (Stokes).
    _, backwards = refract(OPS, (np.sin(t), np.zeros(60), np.cos(t)), (0.0, 0.0, -1.0), 1.5)
    assert backwards == pytest.approx(transmittance, abs=1e-12)


@pytest.mark.parametrize("name", FACES)
def test_light_takes_the_same_path_back(name):
    """A ray into glass and turned round comes out where it came from, to 1e-12."""
    face = FACES[name]
    x, y, d = rays(steepest_deg=30)
    px, py, pz, hits = points(face, x, y, d)
    inner, share = refract(OPS, d, surface_normal(OPS, face, px, py, pz), 1 / 1.4917)
    ok = hits & (share > 0)
    # Looked at from behind, z is turned round: the face bends the other way.
    asphere = None if face.asphere is None else tuple(-a for a in face.asphere)
    turned = Face(-face.curvature, face.conic, asphere)
    back = (-inner[0], -inner[1], inner[2])
    sx, sy = advance(px, py, back, pz)  # on to the vertex plane, for the face to be met anew
    qx, qy, qz, again = points(turned, sx, sy, back)
    ok &= again
    assert ok.mean() > 0.9
    assert np.abs(np.stack([qx - px, qy - py, qz + pz]))[:, ok].max() < 1e-12
    out, other = refract(OPS, back, surface_normal(OPS, turned, qx, qy, qz), 1.4917)
    expected = (-d[0], -d[1], d[2])
    assert (
        np.abs(np.stack([a - b for a, b in zip(out, expected, strict=True)]))[:, ok].max() < 1e-12
    )
    assert np.abs(other - share)[ok].max() < 1e-12


# -- CODE V ------------------------------------------------------------------------------------

# "Double Gauss F/2 - Available Glasses", traced by CODE V 10.8 at 587.6 nm: radius, thickness and
# index behind each face, then rays as x, y, z on each face and the tangents behind it.
# From ray-optics (Michael J. Hayford, https://github.com/mjhoptics/ray-optics), ag_dblgauss.lis.
# Copyright (c) 2017-2025, Michael J. Hayford. All rights reserved. BSD 3-Clause License.
RADII = (56.20238, 152.28580, 37.68262, math.inf, 24.23130, math.inf,
         -28.37731, math.inf, -37.92546, 177.41176, -79.41143)  # fmt: skip
THICKNESSES = (8.75, 0.5, 12.5, 3.8, 16.369445, 13.747957, 3.8, 11.0, 0.5, 7.0)
INDICES = (1.622292, 1.0, 1.607379, 1.603417, 1.0, 1.0, 1.603417, 1.620408, 1.0, 1.620408, 1.0)
TRACED = {
    "axis, margin": ((0.0, 0.0), (
        (25.000000, 0.000000, 5.866433, -0.185302, 0.000000),
        (24.109772, 0.000000, 1.920632, -0.200953, 0.000000),
        (22.844992, 0.000000, 7.714534, -0.394267, 0.000000),
        (20.958242, 0.000000, 0.000000, -0.395393, 0.000000),
        (16.784894, 0.000000, 6.754936, -0.112583, 0.000000),
        (15.702464, 0.000000, 0.000000, -0.112583, 0.000000),
        (14.610682, 0.000000, -4.050377, 0.153430, 0.000000),
        (15.815163, 0.000000, 0.000000, 0.151784, 0.000000),
        (16.882946, 0.000000, -3.965091, -0.057039, 0.000000),
        (16.583956, 0.000000, 0.776812, -0.071127, 0.000000),
        (16.261006, 0.000000, -1.682704, -0.258832, 0.000000),
    )),
    "10 degrees, lower edge": ((0.0, 0.176327), (
        (0.000000, -27.814923, 7.365534, 0.000000, 0.318993),
        (0.000000, -26.625064, 2.345576, 0.000000, 0.414152),
        (0.000000, -23.861803, 8.517672, 0.000000, 0.552822),
        (0.000000, -21.660286, 0.000000, 0.000000, 0.554607),
        (0.000000, -16.138458, 6.156286, 0.000000, 0.384678),
        (0.000000, -12.209678, 0.000000, 0.000000, 0.384678),
        (0.000000, -7.287205, -0.951622, 0.000000, 0.115385),
        (0.000000, -6.738941, 0.000000, 0.000000, 0.114159),
        (0.000000, -5.529458, -0.405257, 0.000000, 0.291165),
        (0.000000, -5.243314, 0.077499, 0.000000, 0.187265),
        (0.000000, -3.965527, -0.099074, 0.000000, 0.350427),
    )),
    "14 degrees, skew": ((0.0, 0.249328), (
        (25.000000, -12.986720, 7.570573, -0.191290, 0.255919),
        (24.308178, -12.061158, 2.437190, -0.211138, 0.375690),
        (22.783140, -9.347566, 9.160149, -0.415726, 0.358991),
        (21.394677, -8.148589, 0.000000, -0.417065, 0.360147),
        (16.783147, -4.166402, 7.257112, -0.112921, 0.421165),
        (15.754175, -0.328604, 0.000000, -0.112921, 0.421165),
        (14.695540, 3.619826, -4.372943, 0.171784, 0.315011),
        (16.099525, 6.194395, 0.000000, 0.169755, 0.311290),
        (17.109703, 8.046817, -5.049217, -0.048037, 0.352610),
        (16.790182, 10.392211, 1.102304, -0.067266, 0.184927),
        (16.563765, 11.014676, -2.531694, -0.258613, 0.213120),
    )),
}  # fmt: skip


def double_gauss(arriving, radii, thicknesses, indices):
    """A ray through the lens: (faces, 5) as listed. It arrives as x, y, tan x, tan y at z = 0."""
    x, y, tan_x, tan_y = arriving
    length = math.sqrt(1 + tan_x**2 + tan_y**2)
    d = (tan_x / length, tan_y / length, 1 / length)
    before, listed = 1.0, []
    for radius, index, thickness in zip(radii, indices, (*thicknesses, 0.0), strict=True):
        face = Face(1 / radius)
        path, hits = intersect(OPS, face, x, y, d)
        x, y, z = x + path * d[0], y + path * d[1], path * d[2]
        d, passes = refract(OPS, d, surface_normal(OPS, face, x, y, z), before / index)
        assert hits and passes > 0
        listed.append((x, y, z, d[0] / d[2], d[1] / d[2]))
        x, y = advance(x, y, d, thickness - z)
        before = index
    return np.array(listed, float)


@pytest.mark.parametrize("name", TRACED)
def test_a_double_gauss_is_traced_as_by_code_v(name):
    """Tolerance from the printed digits: the listing rounds prescription and ray."""
    (tan_x, tan_y), faces = TRACED[name]
    expected = np.array(faces)
    x, y, z = expected[0, :3]
    numbers = [x - z * tan_x, y - z * tan_y, tan_x, tan_y, *RADII, *THICKNESSES, *INDICES]
    last_digits = [1e-6] * 2 + [1e-6] * 2 + [1e-5] * len(RADII)
    last_digits += [1e-6] * len(THICKNESSES) + [1e-6] * len(INDICES)

    def traced(values):
        rest, parts = list(values), []
        for count in (4, len(RADII), len(THICKNESSES), len(INDICES)):
            parts.append(rest[:count])
            rest = rest[count:]
        return double_gauss(*parts)

    ours = traced(numbers)
    # What half a unit of each last digit moves, all added; and the listing's own rounding.
    doubt = np.full_like(expected, 0.5e-6)
    exact = {0.0, 1.0, math.inf, *THICKNESSES} - {16.369445, 13.747957}
    for i, (value, digit) in enumerate(zip(numbers, last_digits, strict=True)):
        if value not in exact:
            moved = [*numbers[:i], value + digit / 2, *numbers[i + 1 :]]
            doubt += np.abs(traced(moved) - ours)
    assert doubt.max() < 3e-4, "digits enough to tell a right trace from a wrong one"
    assert (np.abs(ours - expected) <= doubt).all()
    assert np.abs(ours - expected)[:, :3].max() < 5e-5
