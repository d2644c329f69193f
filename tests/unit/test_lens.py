"""Lens models against closed forms of geometrical optics."""

from __future__ import annotations

import numpy as np
import pytest

from inim.display import DISPLAYS, Display
from inim.errors import DisplayError, UsageError
from inim.lens import check_lens_model, trace_to_panel
from inim.lens.thick import on_axis_transmittance

NOMINAL = DISPLAYS["nominal"]
SIDES = ("viewer", "panel")


def single_lens(aperture_over_f, curved_side, gap_over_f=1.0):
    """One lens, f = 100 mm, n = 1.5, just thick and wide enough for a height."""
    pitch = 2.2 * aperture_over_f * 100
    radius = 50.0
    corner = pitch / np.sqrt(2)
    return Display(
        pitch_mm=pitch,
        focal_length_mm=100.0,
        gap_mm=100.0 * gap_over_f,
        pixel_pitch_mm=0.1,
        lens_columns=1,
        lens_rows=1,
        depth_min_mm=1,
        depth_max_mm=2,
        refractive_index=1.5,
        lens_thickness_mm=1.0001 * (radius - np.sqrt(radius**2 - corner**2)),
        curved_side=curved_side,
    )


def crossing_mm(curved_side, height_over_f):
    """Where a collimated ray crosses the axis, behind the rear principal plane."""
    display = single_lens(height_over_f, curved_side)
    height = 100 * height_over_f
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


def test_exact_aberration_of_the_flat_first_lens():
    """At h / f = 0.1 an exact trace gives 4.58202 (flat side first, n = 1.5)."""
    k = (100 - crossing_mm("panel", 0.1)) / (100 * 0.1**2)
    assert k == pytest.approx(4.58202, abs=1e-5)


@pytest.mark.parametrize("side", SIDES)
def test_paraxial_rays_obey_the_thin_lens(side):
    """Landing at h (1 - g/f) + s g from the lens centre, whatever way round the lens is."""
    display = NOMINAL.replace(curved_side=side)
    height, slope = 1e-6, 1e-6
    centre = 0.5
    for x, s, expected in (
        (height, 0.0, height * (1 - 3.3 / 3)),
        (0.0, slope, slope * 3.3),
        (height, slope, height * (1 - 3.3 / 3) + slope * 3.3),
    ):
        landed, across, _ = trace_to_panel(display, "thick", centre + x, centre, s, 0.0)
        assert landed - centre == pytest.approx(expected, rel=1e-8)
        assert across == centre


@pytest.mark.parametrize("side", SIDES)
def test_a_point_at_the_central_depth_plane_focuses(side):
    """All rays of a paraxial bundle from a point at D meet in one panel point."""
    display = NOMINAL.replace(curved_side=side)
    depth = display.central_depth_mm
    source = 0.5 + 0.01
    aperture = 0.5 + np.linspace(-1e-3, 1e-3, 21)
    slope = (aperture - source) / depth
    landed, _, _ = trace_to_panel(display, "thick", aperture, 0.5, slope, 0.0)
    # Eq. 1: the image of X at D lies at x0 - (X - x0) g / D.
    assert landed == pytest.approx(0.5 - 0.01 * display.gap_mm / depth, abs=1e-8)


def test_no_ray_beyond_the_total_reflection_edge():
    """Flat side first, collimated: no light beyond h = R / n (R = 1.5 mm, n = 1.5: 1 mm)."""
    display = Display(
        pitch_mm=2.1,
        focal_length_mm=3.0,
        gap_mm=3.3,
        pixel_pitch_mm=0.1,
        lens_columns=1,
        lens_rows=1,
        refractive_index=1.5,
        lens_thickness_mm=1.5,
        curved_side="panel",
    )
    height = np.array([0.5, 0.9, 0.999999, 1.000001, 1.04])
    _, _, weight = trace_to_panel(display, "thick", height, 0.0, 0.0, 0.0)
    assert (weight[:3] > 0).all()
    assert (weight[3:] == 0).all()


@pytest.mark.parametrize("side", SIDES)
def test_light_at_normal_incidence_loses_fresnel_s_share_twice(side):
    display = NOMINAL.replace(curved_side=side)
    _, _, weight = trace_to_panel(display, "thick", 0.5, 0.5, 0.0, 0.0)
    n = display.refractive_index
    one_face = 1 - ((n - 1) / (n + 1)) ** 2
    assert weight == pytest.approx(one_face**2, rel=1e-12)
    assert on_axis_transmittance(display) == pytest.approx(one_face**2, rel=1e-12)


@pytest.mark.parametrize("model", ["pinhole", "thick"])
def test_the_chief_ray_lands_where_eq_1_says(model):
    """Through the lens centre the panel pixel is the paper's: x = x0 - g (X - x0) / z."""
    for slope in (-0.14, -0.05, 0.05, 0.14):
        x, y, _ = trace_to_panel(NOMINAL, model, 2.5, -3.5, slope, -slope)
        tolerance = 1e-12 if model == "pinhole" else 2e-3  # a thick lens distorts a little
        assert x == pytest.approx(2.5 + 3.3 * slope, abs=tolerance)
        assert y == pytest.approx(-3.5 - 3.3 * slope, abs=tolerance)


@pytest.mark.parametrize("model", ["pinhole", "thick"])
@pytest.mark.parametrize("side", SIDES)
def test_the_array_is_mirror_symmetric_and_periodic(model, side):
    display = NOMINAL.replace(curved_side=side)
    random = np.random.default_rng(1)
    x, y = random.uniform(-30, 30, (2, 500))
    sx, sy = random.uniform(-0.2, 0.2, (2, 500))
    px, py, weight = trace_to_panel(display, model, x, y, sx, sy)
    mx, my, mirrored = trace_to_panel(display, model, -x, y, -sx, sy)
    assert np.allclose(mx, -px, atol=1e-12) and np.allclose(my, py, atol=1e-12)
    assert np.allclose(mirrored, weight)
    qx, qy, moved = trace_to_panel(display, model, x + 1.0, y, sx, sy)
    assert np.allclose(qx, px + 1.0, atol=1e-9) and np.allclose(qy, py, atol=1e-9)
    assert np.allclose(moved, weight)
    tx, ty, _ = trace_to_panel(display, model, y, x, sy, sx)
    assert np.allclose(tx, py, atol=1e-12) and np.allclose(ty, px, atol=1e-12)


@pytest.mark.parametrize("model", ["pinhole", "thick"])
def test_nothing_is_brighter_than_the_panel_and_nothing_shines_beside_the_array(model):
    random = np.random.default_rng(2)
    x, y = random.uniform(-40, 40, (2, 2000))
    sx, sy = random.uniform(-1, 1, (2, 2000))
    _, _, weight = trace_to_panel(NOMINAL, model, x, y, sx, sy)
    assert (weight >= 0).all() and (weight <= 1).all()
    outside = (np.abs(x) > 33.5) | (np.abs(y) > 33.5)
    assert (weight[outside] == 0).all()


def test_an_oblique_ray_lands_under_the_neighbour():
    """Crosstalk: beyond atan(P / 2g) the panel point belongs to the next elemental image."""
    x, _, weight = trace_to_panel(NOMINAL, "thick", 0.5, 0.5, 0.25, 0.0)
    assert x > 1.0 and weight > 0.5


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"focal_length_mm": 1.0, "gap_mm": 1.2}, "radius"),
        ({"lens_thickness_mm": 0.1}, "thicker"),
        ({"lens_thickness_mm": 6.0}, "gap"),
    ],
)
def test_an_impossible_lens_is_refused(changes, word):
    with pytest.raises(DisplayError, match=word):
        check_lens_model("thick", NOMINAL.replace(**changes))


def test_an_unknown_lens_model_is_named():
    with pytest.raises(UsageError, match="'fresnel'"):
        check_lens_model("fresnel", NOMINAL)
