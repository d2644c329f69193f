"""RGB-D from several cameras: their pictures, their merge, and a user's own files."""

import json
from functools import cache

import numpy as np
import pytest
from PIL import Image

from inim.apps.own_picture.cameras import read_cameras
from inim.apps.own_picture.picture import CameraPicture
from inim.display import DISPLAYS
from inim.generators import merge_cameras
from inim.image.rgbd import Camera, CameraRGBD, CameraRGBDs, LayeredRGBD, camera_directions
from inim.system.errors import FileError, UsageError
from tests.conftest import small_display

DISPLAY = small_display()
LOW, HIGH = DISPLAY.depth_range_mm
SHAPE, PIXEL_MM = DISPLAY.capture_shape(5), DISPLAY.capture_pixel_mm(5)
STEEPEST = max(DISPLAY.steepest_slopes)
NEAR, FAR = HIGH - 2, LOW + 2
RED, GREEN, BLUE = (0.8, 0.1, 0.1), (0.1, 0.6, 0.2), (0.1, 0.2, 0.9)
HALF_MM = 2.5


def places(slopes=(0.0, 0.0)):
    """Crossings of an orthographic camera's rays with the array's plane; x and y at depth z."""
    rows, columns = SHAPE
    u = (np.arange(columns) - (columns - 1) / 2) * PIXEL_MM
    v = ((rows - 1) / 2 - np.arange(rows)) * PIXEL_MM
    return lambda z: np.broadcast_arrays(u[None] + slopes[0] * z, v[:, None] + slopes[1] * z)


def square_before_wall(slopes=(0.0, 0.0)):
    """Depth and colour of a square in front of an unbounded wall, which is blue behind it."""
    is_square, is_behind = (
        ((np.abs(x) < HALF_MM) & (np.abs(y) < HALF_MM))[..., None]
        for x, y in map(places(slopes), (NEAR, FAR))
    )
    color = np.where(is_square, RED, np.where(is_behind, BLUE, GREEN))
    return np.where(is_square[..., 0], NEAR, FAR), color


def ball(slopes=(0.0, 0.0), radius=3.0):
    """Depth and colour of a sphere on nothing; the colour is a function of the point."""
    at = places(slopes)
    u, v = at(0.0)
    middle = (LOW + HIGH) / 2
    # |(u, v, 0) + z (slopes, 1) - centre| = radius
    a = 1 + slopes[0] ** 2 + slopes[1] ** 2
    b = u * slopes[0] + v * slopes[1] - middle
    c = u**2 + v**2 + middle**2 - radius**2
    inside = b * b - a * c > 0
    z = np.where(inside, (-b + np.sqrt(np.maximum(b * b - a * c, 0))) / a, np.inf)
    x, y = at(np.where(inside, z, 0))
    return z, np.stack([0.5 + x / 8, 0.5 + y / 8, np.full(SHAPE, 0.3)], -1) * inside[..., None]


def pictures(scene, arrangement):
    """A scene from an arrangement of cameras."""
    shots = []
    for x, y in camera_directions(arrangement):
        slopes = x * STEEPEST, y * STEEPEST
        depth, color = scene(slopes)
        camera = Camera.orthographic(slopes, SHAPE, PIXEL_MM)
        shots.append(CameraRGBD(color, depth, camera, f"{x:+g} {y:+g}"))
    return CameraRGBDs(tuple(shots))


@cache
def merged_of(scene, arrangement):
    return merge_cameras(pictures(scene, arrangement), DISPLAY)


def test_the_front_of_several_cameras_is_that_of_the_centre_camera():
    depth, _ = square_before_wall()
    merged = merged_of(square_before_wall, "5")
    assert isinstance(merged, LayeredRGBD) and merged.covered.all()
    assert merged.depth_mm == pytest.approx(depth, abs=1e-4)


def test_a_hidden_plane_is_the_second_layer_at_its_exact_depth_and_colour():
    merged = merged_of(square_before_wall, "5")
    x, y = places()(NEAR)
    # A camera at the slope s sees past the square's edge down to the wall, by s (near - far).
    reach = STEEPEST * (NEAR - FAR)
    inside = HALF_MM - np.maximum(np.abs(x), np.abs(y))
    corner = HALF_MM - np.minimum(np.abs(x), np.abs(y)) < reach - 2 * PIXEL_MM
    in_view = (inside > PIXEL_MM) & (inside < reach - 2 * PIXEL_MM) & corner
    walls = [layer.covered & (np.abs(layer.front_mm - FAR) < 1e-3) for layer in merged.layers]
    assert np.any(walls[1:], axis=0)[in_view].all()
    for layer, is_wall in zip(merged.layers[1:], walls[1:], strict=True):
        expected = is_wall & in_view
        assert layer.color[expected] == pytest.approx(np.tile(BLUE, (expected.sum(), 1)), abs=0.02)
    # Nothing is known of the middle of the wall, and nothing is invented.
    unseen = inside > reach + 2 * PIXEL_MM
    assert not np.any(walls[1:], axis=0)[unseen].any()


def test_a_sphere_from_five_cameras_has_its_depth_and_colour():
    depth, color = ball()
    merged = merged_of(ball, "5")
    covered = np.isfinite(depth)
    # At the rim, where the slope has no limit, a column may be missed.
    rim = np.abs(np.hypot(*places()(0.0)) - 3.0) < PIXEL_MM
    assert not (merged.covered & ~covered).any() and (merged.covered | rim)[covered].all()
    in_both = merged.covered & covered
    assert np.abs(merged.depth_mm - depth)[in_both].max() < 0.2 * PIXEL_MM
    # Half a pixel at the steep rim, where colours of other cameras are interpolated.
    assert np.abs(merged.color - color)[in_both].max() < 0.5 * PIXEL_MM
    for layer in merged.layers:
        assert (layer.back_mm <= layer.front_mm)[layer.covered].all()


def tapered_block(lean):
    """An endless block on nothing, narrower by `lean` per depth; its sides face away from z."""
    front, back = NEAR, NEAR - 25

    def scene(slopes=(0.0, 0.0)):
        at, slope = places(slopes), slopes[0]
        z = np.full(SHAPE, np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            for side in (-1, 1):
                # u + slope z = side (HALF_MM - lean (front - z))
                wall = (side * (HALF_MM - lean * front) - at(0.0)[0]) / (slope - side * lean)
                is_hit = (side * slope > lean) & (wall < front) & (wall > back)
                z = np.where(is_hit, wall, z)
        z = np.where(np.abs(at(front)[0]) < HALF_MM, front, z)
        return z, np.isfinite(z)[..., None] * np.array(RED)

    return scene


@pytest.mark.parametrize("lean", [0.03, 0.1])
def test_a_block_ends_at_its_undercut_side_where_a_camera_sees_it(lean):
    """Also where the side is so steep that its pixels are a depth step apart (0.1)."""
    merged = merge_cameras(pictures(tapered_block(lean), "5"), DISPLAY)
    back = np.min([np.where(m.covered, m.back_mm, np.inf) for m in merged.layers], axis=0)
    inside = HALF_MM - np.abs(places()(0.0)[0])
    is_undercut = (inside > PIXEL_MM) & (inside < 25 * lean - PIXEL_MM)
    is_undercut[:60] = is_undercut[-60:] = False  # the edge of the pictures
    assert is_undercut.any()
    error = back[is_undercut] - (NEAR - inside[is_undercut] / lean)
    assert np.abs(error).max() < PIXEL_MM / lean


def test_exact_pictures_of_thin_posts_do_not_contradict_each_other():
    """A post covers the centres of other pixels in each picture."""

    def posts(slopes=(0.0, 0.0)):
        x = places(slopes)(NEAR)[0]
        z = np.where(np.mod(x, 5 * PIXEL_MM) < 2.3 * PIXEL_MM, NEAR, np.inf)
        return z, np.isfinite(z)[..., None] * np.array(RED)

    merged = merge_cameras(pictures(posts, "5"), DISPLAY)
    assert merged.depth_mm[merged.covered] == pytest.approx(NEAR, abs=0.01)


def test_cameras_and_pictures_are_checked():
    depth, color = ball()
    camera = Camera.orthographic((0, 0), SHAPE, PIXEL_MM)
    with pytest.raises(UsageError, match="color is"):
        CameraRGBD(color[1:], depth, camera)
    flat = Camera(np.zeros((3, 4)), False, (1.0, 0.0))
    with pytest.raises(UsageError, match="no inverse; correct its pose"):
        CameraRGBD(color, depth, flat)
    with pytest.raises(UsageError, match="0 cameras; give 1 to 9"):
        CameraRGBDs(())


# A user's own files: a ball in front of a wall, photographed from several positions, in mm.
FOCAL_PX, COLUMNS, ROWS = 300.0, 240, 180


def photograph(position_mm):
    """Colour and depth of a pinhole camera that looks along z."""
    j, i = np.meshgrid(np.arange(COLUMNS), np.arange(ROWS))
    ray = np.stack([(j - 119.5) / FOCAL_PX, (i - 89.5) / FOCAL_PX, np.ones((ROWS, COLUMNS))], -1)
    start = np.array(position_mm, np.float64)
    centre = start - (0, 0, 600)
    a, b = (ray**2).sum(-1), (ray * centre).sum(-1)
    root = b * b - a * ((centre**2).sum() - 120**2)
    ball_mm = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)
    wall_mm = 700 - start[2]
    color = np.where((ball_mm < wall_mm)[..., None], (200, 60, 40), (40, 160, 60))
    return color.astype(np.uint8), np.minimum(ball_mm, wall_mm).round().astype(np.uint16)


def write_document(folder, positions, **changes):
    """Files of photographs, and their document; positions by number may be written wrongly."""
    placed = []
    for n, position in enumerate(positions):
        color, depth = photograph(position)
        Image.fromarray(color).save(folder / f"{n}.png")
        Image.fromarray(depth).save(folder / f"{n}-depth.png")
        placed.append({"color": f"{n}.png", "depth": f"{n}-depth.png", "position_mm": position})
    intrinsics = [FOCAL_PX, FOCAL_PX, 119.5, 89.5]
    document = {"schema": "inim.cameras/1", "intrinsics": intrinsics, "pictures": placed}
    path = folder / "cameras.json"
    path.write_text(json.dumps(document | changes))
    return path, document


POSITIONS = [(0, 0, 0), (-80, -60, 0), (80, -60, 0), (-80, 60, 0), (80, 60, 20)]
OPTIONS = CameraPicture(depth_unit="mm", near=450, far=720)


def test_own_pictures_merge_into_one_ball_and_a_wall(tmp_path):
    """And a camera that is upside down, with its picture turned, sees the same scene."""
    path, document = write_document(tmp_path, POSITIONS[::2])
    display = DISPLAYS["nominal"].replace(lens_columns=12, lens_rows=9)
    merged = merge_cameras(read_cameras(path, OPTIONS, display).pictures, display)
    low, high = display.depth_range_mm
    wall = low + (720 - 700) / (720 - 450) * (high - low)
    top = low + (720 - 480) / (720 - 450) * (high - low)
    assert merged.depth_mm[merged.covered].max() == pytest.approx(top, abs=0.2)
    assert np.median(merged.depth_mm[merged.covered]) == pytest.approx(wall, abs=0.1)
    assert len(merged.layers) > 1 and merged.layers[1].covered.any()
    for name in ("1.png", "1-depth.png"):
        turned = np.asarray(Image.open(tmp_path / name))[::-1, ::-1].copy()
        Image.fromarray(turned).save(tmp_path / name)
    document["pictures"][1]["rotation"] = [[-1, 0, 0], [0, -1, 0], [0, 0, 1]]
    path.write_text(json.dumps(document))
    again = merge_cameras(read_cameras(path, OPTIONS, display).pictures, display)
    for layer, same in zip(merged.layers, again.layers, strict=True):
        np.testing.assert_array_equal(layer.covered, same.covered)
        np.testing.assert_array_equal(layer.color, same.color)


def test_a_wrong_position_names_the_file(tmp_path):
    path, document = write_document(tmp_path, POSITIONS)
    document["pictures"][2]["position_mm"] = (80, -60, 40)
    path.write_text(json.dumps(document))
    display = DISPLAYS["nominal"]
    cameras = read_cameras(path, OPTIONS, display)
    with pytest.raises(
        FileError, match=r"2-depth.png: \d+% of its surface contradict.*mm.*pose"
    ) as caught:
        merge_cameras(cameras.pictures, display)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["../1.png", "{absolute}", "link.png"])
def test_a_document_names_no_file_outside_its_folder(tmp_path, name):
    folder = tmp_path / "document"
    folder.mkdir()
    path, document = write_document(folder, POSITIONS[:2])
    outside = (folder / "1.png").rename(tmp_path / "1.png")
    (folder / "link.png").symlink_to(outside)
    document["pictures"][1]["color"] = name.format(absolute=outside)
    path.write_text(json.dumps(document))
    with pytest.raises(FileError, match=r"cameras\.json: '.*png' is outside the document's folder"):
        read_cameras(path, OPTIONS, DISPLAYS["nominal"])


def test_invalid_documents_are_refused(tmp_path):
    path, document = write_document(tmp_path, POSITIONS[:2])
    display = DISPLAYS["nominal"]

    def refused(change, message, options=OPTIONS):
        path.write_text(json.dumps(document | change))
        with pytest.raises((FileError, UsageError), match=message):
            read_cameras(path, options, display)

    first, second = document["pictures"]
    refused({"pictures": [first]}, "1 pictures; give 2 to 9")
    refused({"intrinsics": None}, "has no intrinsics; add")
    refused({"pictures": [first, second | {"pose": 1}]}, "pose")
    refused({"pictures": [first, second | {"color": "1\0.png"}]}, "is no file name; correct it")
    mirrored = [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]
    refused({"pictures": [first, second | {"rotation": mirrored}]}, "no rotation matrix")
    refused({}, "need distances in a known unit", CameraPicture(depth_unit="none", near=1, far=2))
    refused({}, "--fit auto", CameraPicture(fit="auto"))
