"""The eye's pupil and focus against closed forms: blur circles, symmetry, and what stays a pinhole.

An eye at distance V with a pupil of diameter A, focused at distance F, sees a point at distance L
as a disc; measured on the lens array, where the film is, its diameter is A V |1/F - 1/L|. An edge's
picture then rises like a disc's integral: its slope has the variance (diameter / 4)^2.
"""

import numpy as np
import pytest

from inim.display import DISPLAYS
from inim.display.viewpoint import Viewpoint, check_viewpoint, focus_distance_mm
from inim.system.errors import ViewpointError
from tests.conftest import display_shape, small_display

NOMINAL = DISPLAYS["nominal"]
DISTANCE = 200.0


def family(display, viewpoint, per_lens=4, start_mm=1.0):
    from inim.render.rays import eye_rays

    return eye_rays(display, viewpoint, per_lens, start_mm)


def crossing(rays, axis, point, z):
    """Crossings of the rays of a pupil point (in radii) with a plane, in float64."""
    coordinates = getattr(rays, axis)
    place = coordinates.place_mm + point * rays.pupil_place_mm
    return place + (coordinates.slope + point * rays.pupil_slope) * (rays.start_mm - z)


@pytest.mark.parametrize("start_mm", [0.0, 37.0])
@pytest.mark.parametrize("focus", [60.0, DISTANCE, 900.0])
def test_rays_from_all_over_the_pupil_meet_in_the_plane_of_focus(start_mm, focus):
    eye = Viewpoint("eye", 7.0, -3.0, DISTANCE, pupil_mm=5.0, focus_mm=focus)
    rays = family(small_display(), eye, start_mm=start_mm)
    for axis, centre in (("x", 7.0), ("y", -3.0)):
        chief = crossing(rays, axis, 0.0, DISTANCE - focus)
        for point in (-1.0, -0.3, 1.0):
            places = crossing(rays, axis, point, DISTANCE - focus)
            assert np.allclose(places, chief, rtol=0, atol=1e-11)
            at_eye = crossing(rays, axis, point, DISTANCE)
            assert np.allclose(at_eye, centre + 2.5 * point, rtol=0, atol=1e-11)


def edge(z):
    """A glowing half plane, x > 0, at a depth of the display frame."""
    import mitsuba as mi

    place = mi.ScalarTransform4f().translate([50, 0, z]).scale([50, 50, 1])
    glow = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    return mi.load_dict(
        {"type": "scene", "edge": {"type": "rectangle", "to_world": place, "emitter": glow}}
    )


def edge_profile(eye, z, spp=128):
    """The edge's picture along a row, mean of all rows, and the film pixel on the array."""
    import mitsuba as mi

    from inim.render.trace import FilmCamera, mean_light, scene_light

    display, per_lens = small_display(12, 10), 8
    camera = FilmCamera(family(display, eye, per_lens, start_mm=z + 1), np.eye(4))
    integrator = mi.load_dict({"type": "path", "max_depth": 1})
    picture = mean_light(scene_light(edge(z), integrator, camera), camera.shape, spp, 2)
    return picture[..., 0].mean(axis=0).astype(np.float64), display.pitch_mm / per_lens


@pytest.mark.usefixtures("renderer")
@pytest.mark.parametrize("focus", [150.0, 260.0])
@pytest.mark.parametrize("z", [20.0, -25.0])
def test_blur_has_the_diameter_of_the_closed_form(focus, z):
    eye = Viewpoint("eye", 0.0, 0.0, DISTANCE, pupil_mm=6.0, focus_mm=focus)
    diameter = 6.0 * DISTANCE * abs(1 / focus - 1 / (DISTANCE - z))
    profile, pixel = edge_profile(eye, z)
    rise = np.diff(profile)
    place = (np.arange(len(rise)) - (len(rise) - 1) / 2) * pixel
    assert rise.sum() == pytest.approx(1, abs=1e-6), "the edge and its blur lie in the picture"
    middle = (rise * place).sum()
    variance = (rise * (place - middle) ** 2).sum()
    # Two pixels' widths come in: the film's box, and that of the difference.
    expected = (diameter / 4) ** 2 + pixel**2 / 6
    assert middle == pytest.approx(0, abs=0.01)
    assert variance == pytest.approx(expected, rel=0.02)
    # Nothing outside of the circle.
    assert (rise[np.abs(place) > diameter / 2 + pixel] == 0).all()


def random_eia(display, seed=0):
    return np.random.default_rng(seed).random((*display.eia_shape, 3)).astype(np.float32)


def view_light(eia, display, viewpoint, model="thick", *, seed=0, spp=64):
    from inim.render.reconstruct import reconstruct

    return reconstruct(eia, display, viewpoint, model, spp=spp, seed=seed)


@pytest.mark.usefixtures("renderer")
@pytest.mark.parametrize("model", ["pinhole", "thin", "thick"])
def test_no_pupil_is_the_pinhole_to_the_last_bit(model):
    display = small_display()
    eia = random_eia(display)
    plain = Viewpoint("eye", 9, -6, DISTANCE)
    pinhole = Viewpoint("eye", 9, -6, DISTANCE, pupil_mm=0.0, focus_mm=77.0)
    wide = Viewpoint("eye", 9, -6, DISTANCE, pupil_mm=4.0, focus_mm=77.0)
    picture = view_light(eia, display, plain, model)
    assert np.array_equal(view_light(eia, display, pinhole, model), picture)
    assert not np.array_equal(view_light(eia, display, wide, model), picture)


@pytest.mark.usefixtures("renderer")
@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_display_looks_mirrored_from_the_mirrored_eye(axis):
    display = small_display(11, 9)
    eia = random_eia(display)
    x, y = (7.0, 5.0) if axis == 1 else (7.0, -5.0)
    eye = Viewpoint("eye", 7.0, -5.0, DISTANCE, pupil_mm=5.0)
    opposite = Viewpoint("opposite", -x if axis == 1 else x, -y, DISTANCE, pupil_mm=5.0)
    picture = view_light(eia, display, eye, seed=1, spp=256)
    noise = np.abs(picture - view_light(eia, display, eye, seed=2, spp=256)).mean()
    mirrored = np.flip(view_light(np.flip(eia, axis), display, opposite, seed=3, spp=256), axis)
    assert np.abs(picture - mirrored).mean() < 1.1 * noise
    assert np.abs(picture - np.roll(mirrored, 1, axis)).mean() > 2 * noise, "a shift would show"


@pytest.mark.usefixtures("renderer")
@pytest.mark.parametrize("pupil", [0.0, 3.0, 8.0])
@pytest.mark.parametrize("model", ["pinhole", "thin", "thick"])
def test_a_white_display_looks_uniform(model, pupil):
    """No moire of eye samples and lenses; the outermost lenses have rays beside the array."""
    display = small_display()
    white = np.ones((*display.eia_shape, 3), np.float32)
    # The viewer looks from straight ahead: no ray ends beside the panel.
    eye = Viewpoint("eye", 0.0, 0.0, DISTANCE, pupil_mm=pupil)
    inner = view_light(white, display, eye, model)[4:-4, 4:-4]
    if model == "thick":
        # Fresnel's losses grow towards a lens's corners, by 3 parts in 1000 at this lens.
        assert np.ptp(inner) < 0.004 * inner.mean()
    else:
        assert np.ptp(inner) == 0 and inner.max() == 1


@pytest.mark.usefixtures("renderer")
@pytest.mark.parametrize("pupil", [0.0, 4.0])
@pytest.mark.parametrize("model", ["pinhole", "thin", "thick"])
def test_a_view_needs_no_scene(model, pupil):
    """The formula alone and the emitter in a scene, met by traced rays, give one picture."""
    import mitsuba as mi

    from inim.render.trace import FilmCamera, mean_light, scene_light

    display = small_display()
    eia = random_eia(display)
    eye = Viewpoint("eye", 9, -6, DISTANCE, pupil_mm=pupil)
    alone = view_light(eia, display, eye, model, seed=5)
    scene = mi.load_dict({"type": "scene", "display": display_shape(eia, display, model)})
    integrator = mi.load_dict({"type": "path", "max_depth": 1})
    camera = FilmCamera(family(display, eye), np.eye(4))
    composed = mean_light(scene_light(scene, integrator, camera), camera.shape, 64, 5)
    # Rounding moves a few landing points across the border of two panel pixels, one sample in 64
    # of their view pixels each; any other ray would move nearly all.
    differ = np.abs(alone - composed).max(axis=-1) > 1e-5
    assert differ.mean() < 0.01
    assert np.abs(alone - composed).max() < 3 / 64
    elsewhere = view_light(eia, display, Viewpoint("other", -9, 6, DISTANCE, pupil), model, seed=5)
    assert (np.abs(elsewhere - composed).max(axis=-1) > 1e-5).mean() > 0.5


def test_the_pupil_s_edge_stays_in_the_viewing_zone():
    limit = NOMINAL.flip_limit_mm(400.0)[0]
    check_viewpoint(Viewpoint("in", limit - 2 - 1e-6, 0, 400, pupil_mm=4), NOMINAL)
    check_viewpoint(Viewpoint("pinhole", limit - 1e-6, 0, 400), NOMINAL)
    with pytest.raises(ViewpointError, match=r"pupil of 4 mm.*keep \|x\|"):
        check_viewpoint(Viewpoint("out", limit - 2 + 1e-6, 0, 400, pupil_mm=4), NOMINAL)
    with pytest.raises(ViewpointError, match="pupil_mm of at most"):
        check_viewpoint(Viewpoint("wide", 0, 0, 400, pupil_mm=2.1 * limit), NOMINAL)


def test_in_the_next_zone_each_lens_shows_its_neighbour_s_image(renderer):
    from inim.render.reconstruct import reconstruct

    display = small_display()
    eia, pixel_offset = random_eia(display), display.pitch_mm * DISTANCE / display.gap_mm
    next_zone = Viewpoint("next", pixel_offset, 0, DISTANCE)
    with pytest.raises(ViewpointError, match="outside the viewing zone"):
        reconstruct(eia, display, next_zone, "pinhole")
    flipped = reconstruct(eia, display, next_zone, "pinhole", allow_flips=True)
    moved = np.roll(eia, 8, axis=1)  # an elemental image to the right
    expected = reconstruct(moved, display, Viewpoint("here", 0, 0, DISTANCE), "pinhole")
    inner = slice(4, -4)  # the outermost lens would show what is beside the panel
    np.testing.assert_allclose(flipped[:, inner], expected[:, inner], atol=1e-5)
    assert (
        np.abs(flipped - reconstruct(eia, display, Viewpoint("here", 0, 0, DISTANCE))).max() > 0.1
    )


def test_focus_is_the_central_depth_plane_unless_stated():
    eye = Viewpoint("eye", 0, 0, 400, pupil_mm=4)
    assert focus_distance_mm(eye, NOMINAL) == pytest.approx(400 - NOMINAL.central_depth_mm)
    virtual = NOMINAL.replace(focal_length_mm=3.3, gap_mm=3.0)
    assert focus_distance_mm(eye, virtual) == pytest.approx(400 + 33)
    focused = NOMINAL.replace(gap_mm=3.0, depth_min_mm=-10, depth_max_mm=10)
    assert focus_distance_mm(eye, focused) == 400
    stated = Viewpoint("eye", 0, 0, 400, pupil_mm=4, focus_mm=123)
    assert focus_distance_mm(stated, NOMINAL) == 123


def test_an_eye_cannot_focus_behind_itself():
    far = NOMINAL.replace(gap_mm=3.01, depth_min_mm=10, depth_max_mm=30)  # D = 903 mm
    eye = Viewpoint("eye", 0, 0, 500, pupil_mm=2)
    with pytest.raises(ViewpointError, match="set focus_mm"):
        focus_distance_mm(eye, far)
    assert focus_distance_mm(Viewpoint("pinhole", 0, 0, 500), far) == 500
