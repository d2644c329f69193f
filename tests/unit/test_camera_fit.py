"""A stream of a depth camera: one fit for all frames, missing depth, and as many threads as any."""

import numpy as np
import pytest

import inim
from inim.apps.own_picture.depth_values import DepthValues
from inim.apps.own_picture.fit import Pinhole, fit_picture, map_depth
from inim.apps.own_picture.missing_depth import fill_missing_depth
from inim.image.color import to_srgb
from inim.system.backend.kernels import limited_threads
from inim.system.errors import FileError, UsageError
from tests.conftest import small_display

DISPLAY = small_display(columns=24, rows=18)
INTRINSICS = 200.0, 200.0, 79.5, 59.5
ENDS = {"near_mm": 1000.0, "far_mm": 2000.0}


def frame(square_mm=1200, wall_mm=2000):
    """A grey wall, and a red square of 40 x 40 pixels in its middle."""
    depth, color = np.full((120, 160), wall_mm, np.uint16), np.full((120, 160, 3), 90, np.uint8)
    depth[40:80, 60:100], color[40:80, 60:100] = square_mm, (255, 0, 0)
    return color, depth


def noisy_frame():
    random, (color, depth) = np.random.default_rng(3), frame()
    depth = depth + random.integers(-40, 40, depth.shape)
    depth[random.random(depth.shape) < 0.1] = 0
    return random.integers(0, 256, color.shape, np.uint8), depth.astype(np.uint16)


@pytest.mark.parametrize("intrinsics", [None, INTRINSICS])
def test_all_frames_have_the_scale_and_the_depths_of_the_first(intrinsics):
    low, high = DISPLAY.depth_range_mm
    fit = inim.CameraFit(DISPLAY, frame()[1], intrinsics=intrinsics)  # from 1200 to 2000 mm
    for square_mm in (1200, 1600, 1900, 900):
        rgbd = fit.picture(*frame(square_mm))
        red = rgbd.color[..., 1] == 0
        expected = low + (2000 - max(square_mm, 1200)) / 800 * (high - low)
        np.testing.assert_allclose(rgbd.depth_mm[red & rgbd.covered], expected, rtol=1e-5)
        # The wall, at the first frame's median, covers the array: 24 mm, 160 pixels.
        distance = 1 if intrinsics is None else max(square_mm, 1200) / 2000
        width = (red & rgbd.covered).any(axis=0).sum() * rgbd.pixel_mm
        assert width == pytest.approx(40 * 24 / 160 * distance, abs=1.01 * rgbd.pixel_mm)


@pytest.mark.parametrize("intrinsics", [None, INTRINSICS])
def test_a_picture_is_that_of_inim_generate_in_codes(intrinsics):
    color, depth = noisy_frame()
    camera = None if intrinsics is None else Pinhole(*intrinsics)
    filled = fill_missing_depth(np.where(depth > 0, depth, np.float32(np.nan)), "behind")
    values = DepthValues(filled, False, True, 1.0, ())
    depth_map = map_depth("linear", values, (1000.0, 2000.0), DISPLAY)
    single = fit_picture(
        color, values, depth_map, DISPLAY, camera=camera, fit="cover",
        pixels_per_pitch=3, frame_at=float(np.median(depth[depth > 0])),
    ).rgbd  # fmt: skip
    fit = inim.CameraFit(DISPLAY, depth, intrinsics=intrinsics, pixels_per_pitch=3, **ENDS)
    rgbd = fit.picture(color, depth)
    np.testing.assert_array_equal(rgbd.covered, single.covered)
    np.testing.assert_array_equal(rgbd.depth_mm, single.depth_mm)
    codes = to_srgb(single.color).astype(int)
    difference = np.abs(rgbd.color[..., :3] - codes)[single.covered]
    assert difference.max() <= 1
    assert (difference > 0).mean() < 0.01  # light between two codes
    np.testing.assert_array_equal(rgbd.color[..., 3], np.where(single.covered, 255, 0))


@pytest.mark.parametrize("intrinsics", [None, INTRINSICS])
def test_the_number_of_threads_changes_no_bit(intrinsics):
    color, depth = noisy_frame()
    fit = inim.CameraFit(DISPLAY, depth, intrinsics=intrinsics, **ENDS)
    pictures = []
    for count in (1, 3):
        with limited_threads(count):
            pictures.append(fit.picture(color, depth))
    for name in ("color", "depth_mm", "covered"):
        np.testing.assert_array_equal(*(getattr(rgbd, name) for rgbd in pictures))


def test_missing_depth_behind_is_that_of_the_farther_neighbour_in_the_row():
    nan = np.nan
    depth = np.float32([[nan, 2, nan, nan, 5, nan], [nan] * 6, [3, nan, 1, 4, nan, nan]])
    behind = np.float32([[2, 2, 5, 5, 5, 5], [nan] * 6, [3, 3, 1, 4, 4, 4]])
    np.testing.assert_array_equal(fill_missing_depth(depth, "behind"), behind)
    lower = np.float32([[2, 2, 2, 2, 5, 5], [nan] * 6, [3, 1, 1, 4, 4, 4]])
    filled = fill_missing_depth(depth, "behind", near_is_large=True)
    np.testing.assert_array_equal(filled, lower)


def test_missing_depth_is_a_hole_only_on_request():
    color, depth = frame()
    depth[:, :30] = 0
    for rule, hole in (("behind", False), ("none", True)):
        rgbd = inim.CameraFit(DISPLAY, depth, missing_depth=rule).picture(color, depth)
        rows, columns = rgbd.shape
        assert rgbd.covered[rows // 2, columns // 2]
        assert rgbd.covered[rows // 2, columns // 2 - 20] == (not hole)  # 10 mm left of the middle


def test_impossible_frames_are_errors_of_one_line():
    color, depth = frame()
    with pytest.raises(FileError, match="implausible distances"):
        inim.CameraFit(DISPLAY, depth / 1000)
    with pytest.raises(UsageError, match="principal point"):
        inim.CameraFit(DISPLAY, depth, intrinsics=(200, 200, 700, 60))
    fit = inim.CameraFit(DISPLAY, depth)
    for pair in ((color[:60], depth), (color, depth[:60]), (color / 255, depth)):
        with pytest.raises(UsageError, match="the first depth picture has shape"):
            fit.picture(*pair)
    for intrinsics in (None, INTRINSICS):
        fit = inim.CameraFit(DISPLAY, depth, intrinsics=intrinsics)
        with pytest.raises(UsageError, match="no part of the picture"):
            fit.picture(color, np.zeros_like(depth))
