"""Lens models against closed forms of geometrical optics."""

import numpy as np
import pytest

from inim.display import DISPLAYS
from inim.display.lens import check_lens_model, trace_to_panel
from inim.display.lens.thick import on_axis_transmittance
from inim.system.errors import DisplayError
from tests.conftest import display_shape, small_display

NOMINAL = DISPLAYS["nominal"]
SIDES = ("viewer", "panel")


def single_lens(aperture_over_f, curved_side):
    """One lens, f = 100 mm, n = 1.5, just thick and wide enough for a height."""
    pitch, radius = 2.2 * aperture_over_f * 100, 50.0
    return small_display(
        1, 1, pitch_mm=pitch, focal_length_mm=100.0, gap_mm=100.0, pixel_pitch_mm=0.1,
        depth_min_mm=1, depth_max_mm=2, refractive_index=1.5, curved_side=curved_side,
        lens_thickness_mm=1.0001 * (radius - np.sqrt(radius**2 - pitch**2 / 2)),
    )  # fmt: skip


def crossing_mm(curved_side, height_over_f):
    """Distance from the rear principal plane to a collimated ray's crossing of the axis."""
    display, height = single_lens(height_over_f, curved_side), 100 * height_over_f
    near, _, weight = trace_to_panel(display, "thick", height, 0.0, 0.0, 0.0)
    far, _, _ = trace_to_panel(display.replace(gap_mm=110.0), "thick", height, 0.0, 0.0, 0.0)
    assert weight > 0.9
    return 100.0 - near / ((far - near) / 10.0)


@pytest.mark.parametrize(("side", "third_order"), [("viewer", 7 / 6), ("panel", 9 / 2)])
def test_spherical_aberration_tends_to_the_third_order_form(side, third_order):
    """Longitudinal aberration k h^2 / f with k = 7/6 bulge first, 9/2 flat first, at n = 1.5."""
    heights = np.array([0.04, 0.02, 0.01])
    k = np.array([(100 - crossing_mm(side, h)) / (100 * h**2) for h in heights])
    error = np.abs(k - third_order)
    # The next term is of fourth order in h: halving h divides what is left by four.
    assert error[2] < 2e-3
    assert error[0] / error[1] == pytest.approx(4, rel=0.15)
    assert error[1] / error[2] == pytest.approx(4, rel=0.15)


def test_no_ray_beyond_the_total_reflection_edge():
    """Flat side first, collimated: no light beyond h = R / n (R = 1.5 mm, n = 1.5: 1 mm)."""
    display = small_display(
        1, 1, pitch_mm=2.1, pixel_pitch_mm=0.1, refractive_index=1.5, lens_thickness_mm=1.5,
        curved_side="panel",
    )  # fmt: skip
    height = np.array([0.5, 0.9, 0.999999, 1.000001, 1.04])
    _, _, weight = trace_to_panel(display, "thick", height, 0.0, 0.0, 0.0)
    assert (weight[:3] > 0).all()
    assert (weight[3:] == 0).all()


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"focal_length_mm": 1.0, "gap_mm": 1.2}, "radius"),
        ({"lens_thickness_mm": 0.1}, "thicker"),
        ({"lens_thickness_mm": 6.0}, "gap"),
        ({"conic": 4.0}, "conic 4"),
        ({"asphere_a4": -1.0}, "turns back at"),
        ({"asphere_a6": 2.0, "lens_thickness_mm": 0.3}, "thicker"),
    ],
)
def test_an_impossible_lens_is_refused(changes, word):
    with pytest.raises(DisplayError, match=word):
        check_lens_model("thick", NOMINAL.replace(**changes))


# -- the panel as a furnace --------------------------------------------------------------------


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize(
    "changes",
    [{}, {"conic": -0.8}, {"asphere_a4": 0.03}, {"aperture": "round", "between_lenses": "clear"}],
)
def test_a_white_panel_is_seen_with_both_faces_loss_and_never_brighter(side, changes):
    """Radiance over n^2 is kept: all that is lost is Fresnel's share, at least that of the axis."""
    display = NOMINAL.replace(curved_side=side, **changes)
    random = np.random.default_rng(9)
    x, y = random.uniform(-20, 20, (2, 5000))
    sx, sy = random.uniform(-0.8, 0.8, (2, 5000))
    _, _, weight = trace_to_panel(display, "thick", x, y, sx, sy)
    axis = on_axis_transmittance(display)
    # Unpolarised transmittance of one face is greatest upright.
    assert (weight <= axis * (1 + 1e-12)).all() and (weight >= 0).all()
    assert weight.max() > 0.999 * axis


# -- what lens models tend to as apertures shrink, and how fast ----------------------------------

CENTRE = np.array([0.5, -2.5])  # of one lens
SHRINKING = 0.5 ** np.arange(1, 6)
# Shapes of the curved face; none changes f.
SHAPES = {
    "sphere": {},
    "conic": {"conic": -0.7},
    "asphere": {"conic": 0.5, "asphere_a4": 0.02, "asphere_a6": -0.01},
}


def orders(errors):
    """Slope of log error over log aperture from one halving to the next."""
    return np.diff(np.log(errors)) / np.log(0.5)


def skew_rays(aperture, count=300):
    """Heights within an aperture of the lens, and slopes that shrink with it."""
    random = np.random.default_rng(3)
    hx, hy = random.uniform(-0.5, 0.5, (2, count)) * aperture
    sx, sy = random.uniform(-0.2, 0.2, (2, count)) * aperture
    return hx, hy, sx, sy


def landing(display, model, hx, hy, sx, sy, **method):
    x, y, weight = trace_to_panel(display, model, CENTRE[0] + hx, CENTRE[1] + hy, sx, sy, **method)
    assert (weight > 0).all()
    return x - CENTRE[0], y - CENTRE[1]


def paraxial(display, hx, hy, sx, sy):
    """The lens's matrix, then the gap's: h (1 - g / f) + g s."""
    shrunk = 1 - display.gap_mm / display.focal_length_mm
    return hx * shrunk + sx * display.gap_mm, hy * shrunk + sy * display.gap_mm


def test_the_thin_lens_is_the_paraxial_lens_at_any_height():
    rays = skew_rays(1.0)
    for ours, expected in zip(
        landing(NOMINAL, "thin", *rays), paraxial(NOMINAL, *rays), strict=True
    ):
        assert ours == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("shape", SHAPES)
def test_the_thick_lens_tends_to_the_thin_one_by_the_third_order(shape, side):
    """Seidel's: what is left beside the paraxial landing point shrinks with aperture^3."""
    display = NOMINAL.replace(curved_side=side, **SHAPES[shape])
    errors = []
    for aperture in SHRINKING:
        rays = skew_rays(aperture)
        (x, y), (px, py) = landing(display, "thick", *rays), landing(display, "thin", *rays)
        errors.append(np.hypot(x - px, y - py).max())
    assert orders(errors)[1:] == pytest.approx(3, abs=0.2)


@pytest.mark.parametrize("side", SIDES)
def test_principal_planes_stay_where_they_are_for_all_colours(side):
    """Another index changes the power as (n - 1), and moves no face.

    Then the paraxial ray of that index, through the faces of the design's places.
    """
    display = NOMINAL.replace(curved_side=side)
    n, design = 1.52, display.refractive_index
    t, g, f = display.pitch_mm, display.gap_mm, display.focal_length_mm
    power = (n - 1) / (f * (design - 1))
    h, s = 1e-6, 2e-6
    if side == "viewer":
        bent = (s - h * power) / n  # in the glass
        expected = h + t * bent + (g - t / design) * n * bent
    else:
        at_vertex = h - s * t / design + t * s / n
        expected = at_vertex + g * (s - at_vertex * power)
    landed, across = landing(display, "thick", h, 0.0, s, 0.0, index=n)
    assert landed == pytest.approx(expected, rel=1e-8)
    assert across == 0


def rays_from(point, depth_mm, aperture, count=400):
    """Rays from a point in front of the lens through a disc of its front principal plane."""
    random = np.random.default_rng(4)
    radius = aperture / 2 * np.sqrt(random.uniform(0, 1, count))
    turn = random.uniform(0, 2 * np.pi, count)
    hx, hy = radius * np.cos(turn), radius * np.sin(turn)
    return hx, hy, (hx - point[0]) / depth_mm, (hy - point[1]) / depth_mm


def test_a_hyperboloid_brings_collimated_light_to_one_point():
    """Flat first with k = -n^2 is free of spherical aberration (Descartes): a closed form."""
    n = NOMINAL.refractive_index
    display = NOMINAL.replace(
        curved_side="panel", conic=-(n**2), gap_mm=3.0, depth_min_mm=10, depth_max_mm=20
    )
    hx, hy, _, _ = rays_from((0.0, 0.0), np.inf, 0.98)
    x, y = landing(display, "thick", hx, hy, 0.0, 0.0)
    assert np.hypot(x, y).max() < 1e-14
    sphere = display.replace(conic=0.0)
    assert np.hypot(*landing(sphere, "thick", hx, hy, 0.0, 0.0)).max() > 0.05


# -- the renderer's arithmetic -----------------------------------------------------------------


KINDS = {
    "square": {},
    "hexagonal": {"lattice": "hexagonal"},
    "asphere": {"conic": -0.6, "asphere_a4": 0.03, "asphere_a6": -0.02},
    "round, clear between": {"aperture": "round", "fill_factor": 0.8, "between_lenses": "clear"},
    "colours": {"abbe_number": 57.4},
    "layers": {"layers": "0.5 1.52, 0.1 1.41"},
}


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("name", KINDS)
def test_the_renderer_s_emitter_agrees_with_numpy(renderer, name, side):
    """Same rays, one in the Dr.Jit kernel in float32, one here in float64, on a panel of noise.

    A landing point is known to 1e-4 mm in float32: rays that come closer than that to a pixel's
    border, or to an edge of the relief, may see the next pixel, and are few.
    """
    import mitsuba as mi

    from inim.display.lens import channel_indices

    display = small_display(8, 8, pixels=8, curved_side=side, **KINDS[name])
    random = np.random.default_rng(10)
    eia = random.uniform(0.1, 1.0, (*display.eia_shape, 3)).astype(np.float32)
    scene = mi.load_dict({"type": "scene", "display": display_shape(eia, display, "thick")})
    count = 4000
    at = random.uniform(-2.5, 2.5, (2, count)).astype(np.float32)
    slope = random.uniform(-0.5, 0.5, (2, count)).astype(np.float32)
    towards = mi.Vector3f(mi.Float(slope[0]), mi.Float(slope[1]), mi.Float(-1.0))
    away = mi.Point3f(mi.Float(at[0]), mi.Float(at[1]), mi.Float(0.0)) - towards
    si = scene.ray_intersect(
        mi.Ray3f(away, mi.Vector3f(towards / mi.Float(np.sqrt(1 + (slope**2).sum(axis=0)))))
    )
    radiance = np.array(si.emitter(scene).eval(si)).T
    points = np.array(si.p, np.float64)
    direction = np.array(si.to_world(si.wi), np.float64)
    sx, sy = -direction[0] / direction[2], -direction[1] / direction[2]
    expected, doubtful = np.zeros((count, 3)), np.zeros(count, bool)
    for channel, index in enumerate(channel_indices(display)):
        x, y, weight = trace_to_panel(display, "thick", points[0], points[1], sx, sy, index=index)
        columns, rows = x / display.pixel_pitch_mm, -y / display.pixel_pitch_mm
        column = np.floor(columns + eia.shape[1] / 2).astype(int)
        row = np.floor(rows + eia.shape[0] / 2).astype(int)
        inside = (column >= 0) & (column < eia.shape[1]) & (row >= 0) & (row < eia.shape[0])
        lit = inside & (weight > 0)
        expected[lit, channel] = eia[row[lit], column[lit], channel] * weight[lit]
        border = np.abs(np.stack([columns, rows]) - np.round([columns, rows])).min(axis=0)
        doubtful |= border * display.pixel_pitch_mm < 1e-4
    same = (np.abs(radiance - expected) < 2e-5).all(axis=1)
    assert expected.max(axis=1).astype(bool).mean() > 0.5
    assert same[~doubtful].mean() > 0.998, "all but rays at the relief's edges"
    assert doubtful.mean() < 0.02
    assert (np.abs(radiance[::-1] - expected) > 0.01).any(axis=1).mean() > 0.5, (
        "noise tells rays apart"
    )
