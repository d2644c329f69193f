"""A camera's picture in the display frame: places against closed forms, surfaces, holes."""

import numpy as np
import pytest

from inim.apps.own_picture.depth_values import DepthValues
from inim.apps.own_picture.fit import Pinhole, fit_picture, map_depth
from tests.conftest import small_display

FOCAL = 200.0
CAMERA = Pinhole(FOCAL, FOCAL, 79.5, 59.5)
SHAPE = (120, 160)
DISPLAY = small_display(columns=24, rows=18)


def values(depth, near_is_large=False, step=0.0):
    return DepthValues(np.asarray(depth, np.float32), near_is_large, True, step, ())


def two_squares():
    """A wall at 2 m, a red square at 1 m, a green one at 1.6 m; rows and columns of each."""
    depth, color = np.full(SHAPE, 2000.0), np.zeros((*SHAPE, 3), np.uint8)
    color[:] = 50, 50, 50
    squares = {"red": (slice(31, 51), slice(40, 60), 1000.0)}
    squares["green"] = (slice(70, 100), slice(95, 120), 1600.0)
    for name, (rows, columns, z) in squares.items():
        depth[rows, columns] = z
        color[rows, columns] = (255, 0, 0) if name == "red" else (0, 255, 0)
    return color, depth, squares


def fitted(color, depth, camera=CAMERA, name="linear", ends=(1000.0, 2000.0), **options):
    depths = values(depth)
    depth_map = map_depth(name, depths, ends, DISPLAY)
    return fit_picture(color, depths, depth_map, DISPLAY, camera=camera, **options)


def cell_centres(rgbd):
    rows, columns = rgbd.shape
    x = (np.arange(columns) + 0.5 - columns / 2) * rgbd.pixel_mm
    y = (rows / 2 - np.arange(rows) - 0.5) * rgbd.pixel_mm
    return np.meshgrid(x, y)


@pytest.mark.parametrize("frame_at", [1037.0, 1713.0])
@pytest.mark.parametrize("principal", [(79.5, 59.5), (70.25, 66.0)])
def test_squares_are_at_the_places_of_the_pinhole_formula(frame_at, principal):
    camera = Pinhole(FOCAL, FOCAL, *principal)
    color, depth, squares = two_squares()
    rgbd = fitted(color, depth, camera, frame_at=frame_at).rgbd
    x, y = cell_centres(rgbd)
    # The frame at `frame_at` is 160 / 200 of it wide and fills the array's 24 mm (or 18 mm).
    scale = min(24.0 / (160 / FOCAL * frame_at), 18.0 / (120 / FOCAL * frame_at))
    low, high = DISPLAY.depth_range_mm
    middle = (79.5 - principal[0], 59.5 - principal[1])
    for channel, (rows, columns, z) in zip((0, 1), squares.values(), strict=True):

        def place(pixel, centre, off, z=z):
            return scale * ((pixel - centre) * z - off * frame_at) / FOCAL

        left, right = (
            place(edge - 0.5, principal[0], middle[0]) for edge in (columns.start, columns.stop)
        )
        top, bottom = (
            -place(edge - 0.5, principal[1], middle[1]) for edge in (rows.start, rows.stop)
        )
        inside = (x > left) & (x < right) & (y > bottom) & (y < top)
        in_square = rgbd.color[..., channel] > 0.9
        assert inside.sum() > 50
        np.testing.assert_array_equal(in_square, inside)
        expected = low + (2000 - z) / 1000 * (high - low)
        np.testing.assert_allclose(rgbd.depth_mm[inside], expected, rtol=1e-6)


def test_the_wall_behind_a_square_keeps_a_hole_where_the_camera_did_not_see_it():
    color, depth, squares = two_squares()
    rgbd = fitted(color, depth, frame_at=2000.0).rgbd
    # Orthographically the square at 1 m is half as wide as its shadow on the wall at 2 m.
    x, y = cell_centres(rgbd)
    scale = 24.0 / (160 / FOCAL * 2000)
    rows, columns, _ = squares["red"]
    edges = [scale * (e - 0.5 - 79.5) * 2000 / FOCAL for e in (columns.start, columns.stop)]
    heights = [-scale * (e - 0.5 - 59.5) * 2000 / FOCAL for e in (rows.start, rows.stop)]
    shadow = (x > edges[0]) & (x < edges[1]) & (y < heights[0]) & (y > heights[1])
    red = rgbd.color[..., 0] > 0.9
    assert (shadow & ~rgbd.covered).sum() > 100
    np.testing.assert_array_equal(rgbd.covered[shadow], red[shadow])


@pytest.mark.parametrize("slope", [0.0, 0.5, 2.0])
def test_a_tilted_plane_has_no_crack_and_keeps_its_depths(slope):
    """Z = 1500 + slope X, magnified: neighbouring samples are several cells apart."""
    display = small_display(columns=60, rows=60)
    rows, columns = 40, 50
    camera = Pinhole(100.0, 100.0, 24.5, 19.5)
    j = np.arange(columns)
    depth = np.tile(1500 / (1 - slope * (j - 24.5) / 100), (rows, 1))
    depths = values(depth)
    ends = float(depth.min()), float(depth.max()) + 100.0
    depth_map = map_depth("linear", depths, ends, display)
    picture = fit_picture(
        np.zeros((rows, columns, 3), np.uint8), depths, depth_map, display, camera=camera,
        frame_at=1500.0, pixels_per_pitch=7,
    )  # fmt: skip
    rgbd = picture.rgbd
    x, y = cell_centres(rgbd)
    space = 1500 + slope * x / picture.scale  # the plane again, from the cell's place
    expected = depth_map.offset_mm + depth_map.slope * space
    # The outermost half samples have a neighbour on one side only.
    u, v = x / picture.scale / space * 100, y / picture.scale / space * 100
    inside = (np.abs(u) < 24) & (np.abs(v) < 19)
    assert inside.sum() > 2000
    assert rgbd.covered[inside].all()
    np.testing.assert_allclose(rgbd.depth_mm[inside], expected[inside], atol=2e-4)


def test_an_orthographic_picture_fills_the_array_at_every_depth():
    color, depth, squares = two_squares()
    rgbd = fitted(color, depth, camera=None).rgbd
    x, y = cell_centres(rgbd)
    on_array = (np.abs(x) < 12) & (np.abs(y) < 9)
    assert rgbd.covered[on_array].all()
    assert not rgbd.covered[~on_array].any()
    rows, columns, _ = squares["red"]
    inside = (x > columns.start * 0.15 - 12) & (x < columns.stop * 0.15 - 12)
    inside &= (y < 9 - rows.start * 0.15) & (y > 9 - rows.stop * 0.15)
    in_square = rgbd.color[..., 0] > 0.9
    np.testing.assert_array_equal(in_square, inside)


def test_two_surfaces_in_a_cell_do_not_mix():
    rows, columns = 18 * 5 * 8, 24 * 5 * 8
    depth = np.full((rows, columns), 2000.0)
    color = np.zeros((rows, columns, 3), np.uint8)
    depth[:, : columns // 2 + 5], color[:, : columns // 2 + 5] = 1000.0, 255
    rgbd = fitted(color, depth, camera=None).rgbd
    red = rgbd.color[rgbd.covered][:, 0]
    assert set(np.unique(red)) == {np.float32(0), np.float32(1)}
    depths = np.unique(rgbd.depth_mm[rgbd.covered])
    assert len(depths) == 2


def test_linear_map_takes_near_to_the_front_and_far_to_the_back():
    low, high = DISPLAY.depth_range_mm
    for ends, large in (((1000.0, 3000.0), False), ((3000.0, 1000.0), True)):
        mapping = map_depth("linear", values([[ends[0], ends[1]]], large), ends, DISPLAY)
        assert mapping.z_mm(np.array(ends)) == pytest.approx([high, low])
        assert mapping.z_mm(np.array([2000.0])) == pytest.approx([(low + high) / 2])


def test_reciprocal_map_keeps_proportions_and_clips_beyond_its_ratio():
    """L = D (near + far) / 2d; whole up to far / near = 1 + span / D, clipped beyond."""
    low, high = DISPLAY.depth_range_mm
    d = DISPLAY.central_depth_mm
    whole = 1 + DISPLAY.depth_span_mm / d
    for ratio, clips in ((whole * 0.999, False), (whole * 1.01, True)):
        near, far = 1000.0, 1000.0 * ratio
        picture = map_depth("reciprocal", values([[near, far]]), (near, far), DISPLAY)
        exact = d * (near + far) / (2 * np.array([near, far]))
        assert (exact[0] > high) == clips
        np.testing.assert_allclose(picture.z_mm(np.array([near, far])), np.clip(exact, low, high))
    depth = np.full(SHAPE, 2000.0)
    depth[:, :40] = 500.0
    picture = fitted(np.zeros((*SHAPE, 3), np.uint8), depth, None, "reciprocal", (500.0, 2000.0))
    assert picture.clipped == pytest.approx(1 / 4)


def test_eq_4_as_printed_maps_in_front_of_the_displayable_depth_and_is_clipped_there():
    """z_max + (h - h_min) / (h_max - h_min) (z_max - z_min), numbers as they are."""
    color, depth, _ = two_squares()
    depths = values(depth, near_is_large=True)
    low, high = DISPLAY.depth_range_mm
    mapping = map_depth("printed", depths, (2000.0, 1000.0), DISPLAY)
    picture = fit_picture(color, depths, mapping, DISPLAY, camera=None)
    assert picture.clipped == pytest.approx(np.mean(depth > 1000))  # all but d_min, at z_max
    assert set(picture.rgbd.depth_mm[picture.rgbd.covered]) == {np.float32(high)}
    (warning,) = mapping.warnings(picture.clipped)
    assert f"{high:.6g} .. {2 * high - low:.6g} mm" in warning
    assert f"{picture.clipped:.1%} of the samples" in warning
    assert "in front" not in warning
