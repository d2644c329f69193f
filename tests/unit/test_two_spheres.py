"""Two spheres in closed form: picture, EIA and view agree with one another and with geometry."""

import numpy as np
import pytest

from inim.display import Viewpoint
from inim.generators import colour_of, find_sources
from inim.pipeline.timing import linear_picture
from inim.render.scene_files.two_spheres import two_spheres, two_spheres_eia, two_spheres_view
from tests.conftest import small_display


def picture_of(display, pixels_per_pitch):
    shape = display.capture_shape(pixels_per_pitch)
    return two_spheres(display, shape, display.pitch_mm / pixels_per_pitch)


def test_depths_lie_inside_the_range_and_both_spheres_are_there():
    display = small_display(12, 12)
    rgbd = picture_of(display, 5)
    low, high = display.depth_range_mm
    depth = rgbd.depth_mm[rgbd.covered]
    assert low < depth.min() < (low + high) / 2 < depth.max() < high
    assert rgbd.color.dtype == np.uint8
    assert (rgbd.color[..., 3] == 255 * rgbd.covered).all()


def test_nearest_point_of_the_front_sphere_is_where_its_centre_is():
    display = small_display(20, 20)
    rgbd = two_spheres(display, (400, 400), display.width_mm / 400)
    row, column = np.unravel_index(np.argmax(rgbd.depth_mm), rgbd.shape)
    # Centre (0.30, -0.16) half widths from the axis; y points up, rows down.
    assert column == pytest.approx(200 + 0.30 * 200, abs=1)
    assert row == pytest.approx(200 + 0.16 * 200, abs=1)
    low, high = display.depth_range_mm
    middle, half = (low + high) / 2, (high - low) / 2
    assert rgbd.depth_mm.max() == pytest.approx(middle + (0.40 + 0.55) * half, abs=0.01)


def test_a_finer_picture_is_the_same_scene():
    display = small_display(8, 8)
    coarse, fine = (two_spheres(display, (n, n), 8 / n) for n in (25, 75))
    assert (coarse.covered == fine.covered[1::3, 1::3]).all()
    assert np.allclose(coarse.depth_mm, fine.depth_mm[1::3, 1::3], atol=1e-4)


def test_the_true_eia_equals_the_exact_generator_on_a_fine_picture():
    display = small_display(columns=10, rows=8, pixels=8)
    eias = {}
    for count in (2, 16):
        rgbd = picture_of(display, count)
        eias[count] = linear_picture(colour_of(find_sources(rgbd, display), rgbd))
    truth = two_spheres_eia(display)
    error = {count: float(np.abs(eia - truth).mean()) for count, eia in eias.items()}
    assert error[16] < error[2]
    assert truth.shape == (*display.eia_shape, 3)


def test_a_view_from_afar_is_the_picture_itself():
    display = small_display(10, 10)
    view = two_spheres_view(display, Viewpoint("far", 0, 0, 1e9), 4)
    rgbd = two_spheres(display, (160, 160), display.width_mm / 160)
    flat = linear_picture(rgbd.color).reshape(40, 4, 40, 4, 3).mean(axis=(1, 3))
    assert np.abs(view - flat).max() < 0.02  # 8-bit codes
