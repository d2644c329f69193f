"""What lens models tend to as apertures shrink, and how fast: orders measured, not assumed."""

import numpy as np
import pytest

from inim.display import DISPLAYS
from inim.lens import trace_to_panel

NOMINAL = DISPLAYS["nominal"]
SIDES = ("viewer", "panel")
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


def landing(display, model, hx, hy, sx, sy, **how):
    x, y, weight = trace_to_panel(display, model, CENTRE[0] + hx, CENTRE[1] + hy, sx, sy, **how)
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
    """From a point at a depth in front of the lens through a disc of its front principal plane."""
    random = np.random.default_rng(4)
    radius = aperture / 2 * np.sqrt(random.uniform(0, 1, count))
    turn = random.uniform(0, 2 * np.pi, count)
    hx, hy = radius * np.cos(turn), radius * np.sin(turn)
    return hx, hy, (hx - point[0]) / depth_mm, (hy - point[1]) / depth_mm


@pytest.mark.parametrize(("model", "size_mm"), [("thin", 1e-12), ("thick", 0.06)])
def test_a_point_on_the_central_depth_plane_has_one_image(model, size_mm):
    """Eq. 1: at -X g / D from the lens's axis; the thick lens's aberrations blur it."""
    depth = NOMINAL.central_depth_mm
    point = (2.0, -1.0)
    x, y = landing(NOMINAL, model, *rays_from(point, depth, 0.5))
    image = -np.array(point) * NOMINAL.gap_mm / depth
    assert np.hypot(x - image[0], y - image[1]).max() < size_mm


@pytest.mark.parametrize("side", SIDES)
def test_the_image_of_a_point_beside_the_axis_shrinks_with_the_aperture(side):
    """At a fixed field, field curvature and astigmatism are left: the first order."""
    display = NOMINAL.replace(curved_side=side)
    sizes = []
    for aperture in SHRINKING / 4:
        rays = rays_from((3.0, -2.0), display.central_depth_mm, aperture)
        x, y = landing(display, "thick", *rays)
        sizes.append(np.hypot(x - x.mean(), y - y.mean()).max())
    assert orders(sizes)[1:] == pytest.approx(1, abs=0.2)
    assert sizes[-1] < 1e-3


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
