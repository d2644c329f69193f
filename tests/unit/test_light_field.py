"""Light fields and quilts: which view is whose, and back again without loss."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from inim.display import DISPLAYS
from inim.generators import generate
from inim.image.files.light_field import (
    centre_disparity,
    disparity_step_mm,
    eia_from_views,
    quilt_path,
    read_hci,
    sub_aperture_views,
    write_hci,
    write_quilt,
)
from inim.image.rgbd import RGBD
from inim.system.errors import FileError
from tests.conftest import small_display

COUNTS = [(5, 7, 4), (6, 4, 5), (4, 4, 8), (3, 8, 3)]


def noise(shape, seed=0):
    return np.random.default_rng(seed).integers(0, 256, shape).astype(np.uint8)


@pytest.mark.parametrize(("rows", "columns", "pixels"), COUNTS)
def test_views_are_a_permutation_of_the_eia(rows, columns, pixels):
    display = small_display(columns, rows, pixels)
    eia = noise((*display.eia_shape, 3))
    views = sub_aperture_views(eia, display)
    assert views.shape == (pixels, pixels, rows, columns, 3)
    for (v, u), (m, n) in [((0, 0), (0, 0)), ((1, 2), (2, 1)), ((pixels - 1, 0), (1, 2))]:
        # The leftmost eye looks through a lens at its rightmost pixel, the uppermost at its lowest.
        pixel = eia[m * pixels + pixels - 1 - v, n * pixels + pixels - 1 - u]
        np.testing.assert_array_equal(views[v, u, m, n], pixel)
    np.testing.assert_array_equal(eia_from_views(views, display), eia)


@pytest.mark.parametrize("name", ["phone", "shifted", "pitched"])
def test_without_whole_pixels_each_view_takes_the_nearest_pixel_of_the_lens(name):
    display = {
        "phone": DISPLAYS["phone"].replace(
            lens_columns=9, lens_rows=6, panel_columns=None, panel_rows=None
        ),
        "shifted": small_display(shift_x_mm=0.06, shift_y_mm=-0.04),
        "pitched": small_display(elemental_pitch_mm=1.013),
    }[name]
    rows, columns = display.eia_shape
    # Every pixel says where it is: the views' numbers are places.
    place = np.stack(np.meshgrid(display.columns.position_mm, display.rows.position_mm), axis=-1)
    views = sub_aperture_views(place, display)
    down, across = views.shape[:2]
    cell, half = display.elemental_image_pitch_mm, display.pixel_pitch_mm / 2
    n = np.arange(display.lens_columns) - (display.lens_columns - 1) / 2
    m = (display.lens_rows - 1) / 2 - np.arange(display.lens_rows)
    for k in range(across):
        expected = n * cell + display.shift_x_mm + (0.5 - (k + 0.5) / across) * cell
        assert np.abs(views[0, k, 0, :, 0] - expected).max() <= half * 1.5
    for k in range(down):
        expected = m * cell + display.shift_y_mm + ((k + 0.5) / down - 0.5) * cell
        assert np.abs(views[k, 0, :, 0, 1] - expected).max() <= half * 1.5
    eia = noise((rows, columns, 3))
    back = eia_from_views(sub_aperture_views(eia, display), display)
    again = sub_aperture_views(back, display)
    np.testing.assert_array_equal(again, sub_aperture_views(eia, display))


def test_a_near_point_is_further_right_for_eyes_further_left():
    """Disparity is positive in front of the array: z s / p pixels from view to view."""
    display = small_display(columns=21, rows=21, pixels=9)
    shape, pixel = display.capture_shape(5), 0.2
    depth = np.full(shape, 24.0, np.float32)
    color = np.zeros((*shape, 3), np.float32)
    middle = shape[0] // 2, shape[1] // 2
    color[middle[0] - 7 : middle[0] + 8, middle[1] - 7 : middle[1] + 8] = 1
    rgbd = RGBD(color, depth, np.ones(shape, bool), pixel)
    views = sub_aperture_views(generate(rgbd, display), display)[..., 0]
    lens = np.arange(21)
    columns = [(views[4, k].sum(0) @ lens) / views[4, k].sum() for k in range(2, 7)]
    rows = [(views[k, 4].sum(1) @ lens) / views[k, 4].sum() for k in range(2, 7)]
    expected = 24.0 / disparity_step_mm(display, 9, display.pitch_mm)
    assert expected == pytest.approx(24.0 / 3.3 / 9)
    # Its middle is seen to half a lens at either end of four steps.
    for place in (columns, rows):
        assert (place[0] - place[-1]) / 4 == pytest.approx(expected, abs=0.25)


@pytest.mark.parametrize(("rows", "columns"), [(3, 5), (4, 2), (1, 7), (3, 3)])
def test_an_hci_folder_round_trips(tmp_path, rows, columns):
    views = noise((rows, columns, 6, 9, 3))
    write_hci(tmp_path / "lf", views, small_display(columns=9, rows=6))
    field = read_hci(tmp_path / "lf")
    np.testing.assert_array_equal(field.views, views)
    assert field.disparity is None
    write_hci(tmp_path / "lf", views[:1, :1])  # fewer views leave none of the old ones behind
    assert read_hci(tmp_path / "lf").views.shape == (1, 1, 6, 9, 3)


@pytest.mark.parametrize("per_pitch", [1, 4, 5])
@pytest.mark.parametrize("lenses", [6, 7])
def test_a_centre_view_s_disparity_is_the_depth_behind_each_lens_centre(lenses, per_pitch):
    display = small_display(columns=lenses, rows=5, pixels=9)
    shape, pixel = display.capture_shape(per_pitch), display.capture_pixel_mm(per_pitch)
    x = (np.arange(shape[1]) + 0.5 - shape[1] / 2) * pixel
    y = (shape[0] / 2 - np.arange(shape[0]) - 0.5) * pixel
    depth = (20 + 0.5 * x[None, :] + 0.25 * y[:, None]).astype(np.float32)
    covered = np.broadcast_to(x[None, :] < 1.9, shape)
    rgbd = RGBD(np.zeros((*shape, 3), np.float32), depth, covered, pixel)
    depths = centre_disparity(rgbd, display, 9) * disparity_step_mm(display, 9, display.pitch_mm)
    lens_x = np.arange(lenses) - (lenses - 1) / 2
    lens_y = 2 - np.arange(5)
    expected = 20 + 0.5 * lens_x[None, :] + 0.25 * lens_y[:, None]
    left_part = np.broadcast_to(lens_x[None, :] < 1.9, expected.shape)
    np.testing.assert_array_equal(np.isfinite(depths), left_part)
    # A lens's centre on a border of pixels has the depth half a pixel aside.
    pixel_offset = 0.375 * pixel if per_pitch % 2 == 0 else 0.0
    assert np.abs(depths - expected)[left_part].max() <= pixel_offset + 1e-5


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda d: (d / "input_Cam002.png").unlink(), "input_Cam002.png is missing"),
        (lambda d: [p.unlink() for p in d.glob("*.png")], "contains no input_Cam000.png"),
        (lambda d: (d / "parameters.cfg").write_text("[extrinsics]\nnum_cams_x=4\nnum_cams_y=4"),
         "4 x 4 cameras, but there are 6 views"),
        (lambda d: (d / "parameters.cfg").write_text("x"), "not readable"),
        (lambda d: (d / "parameters.cfg").unlink(), "6 is not a square number"),
        (lambda d: (d / "input_Cam001.png").write_bytes(b"no"), "not a readable picture"),
        (lambda d: Image.new("RGB", (3, 3)).save(d / "input_Cam001.png"), "3 x 3 pixels"),
    ],
)  # fmt: skip
def test_a_damaged_hci_folder_is_one_line(tmp_path, spoil, says):
    write_hci(tmp_path, noise((2, 3, 4, 5, 3)))
    spoil(tmp_path)
    with pytest.raises(FileError, match=says) as raised:
        read_hci(tmp_path)
    assert "\n" not in str(raised.value)


def quilt_views(path: Path, columns: int, rows: int) -> np.ndarray:
    """The tiles of a quilt, (n, H, W, 3), from left to right and then upwards."""
    lines = np.split(np.asarray(Image.open(path)), rows)[::-1]
    return np.stack([tile for line in lines for tile in np.split(line, columns, axis=1)])


@pytest.mark.parametrize(("columns", "rows"), [(4, 3), (5, 1), (3, 7), (2, 2)])
def test_a_quilt_round_trips_and_starts_at_the_bottom_left(tmp_path, columns, rows):
    views = noise((columns * rows, 6, 9, 3))
    path = quilt_path(tmp_path / "relic.png", columns, rows, 1.5)
    assert path.name == f"relic_qs{columns}x{rows}a1.5.png"
    write_quilt(path, views, columns, rows)
    pixels = np.asarray(Image.open(path))
    np.testing.assert_array_equal(pixels[-6:, :9], views[0])
    np.testing.assert_array_equal(pixels[:6, -9:], views[-1])
    np.testing.assert_array_equal(pixels[-6:, -9:], views[columns - 1])
    np.testing.assert_array_equal(quilt_views(path, columns, rows), views)
