"""`inim generate` and its kin as their users run them: a camera's picture becomes an EIA.

Expected: near things move against the eye, upright and unmirrored; the EIA knows its size; the
renderer is not loaded; every bad input ends in one line, exit code 2 and nothing written.
"""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from inim.cli.main import main
from inim.display import Display
from inim.image.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.image.files.eia_file import read_eia
from inim.report.virtual_display import still_view
from inim.system.errors import EXIT_PASSED
from tests.conftest import small_display
from tests.system.conftest import assert_refused, definitions
from tests.unit.test_cli import loaded_by

FOCAL, ROWS, COLUMNS = 150.0, 90, 120
CAMERA = ("--intrinsics", f"{FOCAL},{FOCAL},59.5,44.5")
SIZES = {"lens_columns": 40, "lens_rows": 30, "pixel_pitch_mm": 0.03125}
DISPLAY = definitions({f"inim.{name}": str(size) for name, size in SIZES.items()})
FEWER_LENSES = definitions({"inim.lens_columns": "12", "inim.lens_rows": "9"})
#: Rows, columns, distance in mm, colour: red is near and top left, green far and below right.
SQUARES = (
    (slice(20, 40), slice(25, 45), 1000, (255, 0, 0)),
    (slice(50, 75), slice(70, 95), 2000, (0, 255, 0)),
)


@pytest.fixture
def camera(tmp_path):
    """A folder with color.png and depth.png, millimetres, 0 where there is nothing."""
    color, depth = np.zeros((ROWS, COLUMNS, 3), np.uint8), np.zeros((ROWS, COLUMNS), np.uint16)
    for rows, columns, z, rgb in SQUARES:
        color[rows, columns], depth[rows, columns] = rgb, z
    Image.fromarray(color).save(tmp_path / "color.png")
    Image.fromarray(depth).save(tmp_path / "depth.png")
    return tmp_path


def words(folder: Path, *more: str, color="color.png", depth="depth.png", display=DISPLAY):
    files = [str(folder / color), "--depth", str(folder / depth), "--depth-unit", "mm"]
    return ["generate", *files, *display, "-o", str(folder / "eia.png"), *more]


def the_display() -> Display:
    return small_display(columns=40, rows=30, pixels=32)


def place_seen(view: np.ndarray, channel: int, display: Display) -> tuple[float, float]:
    """Centre of a square's colour in a view, mm on the array."""
    light = np.asarray(view[..., channel], float)
    light[light < 0.2] = 0
    rows, columns = view.shape[:2]
    x = (np.arange(columns) + 0.5 - columns / 2) * display.width_mm / columns
    y = (rows / 2 - np.arange(rows) - 0.5) * display.height_mm / rows
    return (light.sum(0) @ x) / light.sum(), (light.sum(1) @ y) / light.sum()


def expected_place(square, eye, frame_at: float, display: Display) -> tuple[float, float]:
    """Point of the array on the line from the eye to the square's middle."""
    rows, columns, z, _ = square
    scale = min(
        display.width_mm * FOCAL / (COLUMNS * frame_at),
        display.height_mm * FOCAL / (ROWS * frame_at),
    )
    x = scale * ((columns.start + columns.stop - 1) / 2 - 59.5) * z / FOCAL
    y = -scale * ((rows.start + rows.stop - 1) / 2 - 44.5) * z / FOCAL
    low, high = display.depth_range_mm
    depth = low + (2000 - z) / 1000 * (high - low)
    ex, ey, ez = eye
    return ex + (x - ex) * ez / (ez - depth), ey + (y - ey) * ez / (ez - depth)


EYES = {"left": (-14.0, 0.0, 400.0), "right": (14.0, 0.0, 400.0), "up": (0.0, 14.0, 400.0)}


def viewed(eia: np.ndarray, display: Display) -> dict[str, np.ndarray]:
    codes = srgb_to_uint8(srgb_from_linear(eia))
    return {
        name: linear_from_srgb(still_view(codes, display, eye, "pinhole") / 255)
        for name, eye in EYES.items()
    }


def check_parallax(views: dict[str, np.ndarray], display: Display) -> None:
    places = {}
    for name, eye in EYES.items():
        for square, channel in zip(SQUARES, (0, 1), strict=True):
            place = place_seen(views[name], channel, display)
            places[name, channel] = place
            # Half a lens, which shows one point, and half an image of a panel pixel.
            voxel = display.depth_range_mm[1] * display.pixel_pitch_mm / display.gap_mm
            expected = expected_place(square, eye, 1800.0, display)
            np.testing.assert_allclose(place, expected, atol=(display.pitch_mm + voxel) / 2)
    near = places["right", 0][0] - places["left", 0][0]
    far = places["right", 1][0] - places["left", 1][0]
    assert near < far < 0  # both in front of the array: against the eye, the nearer more
    assert places["left", 0][0] < 0 < places["left", 1][0]  # red is on the left
    assert places["left", 0][1] > 0 > places["left", 1][1]  # and above


def test_near_things_move_against_the_eye_upright_and_unmirrored(camera, capsys):
    display = the_display()
    more = (*CAMERA, "--depth-unit", "mm", "--frame-at", "1800")
    assert main(words(camera, *more)) == EXIT_PASSED
    eia, covered = read_eia(camera / "eia.png", display)
    assert covered is not None
    assert not eia[~covered].any()
    assert 0.02 < covered.mean() < 0.5
    check_parallax(viewed(eia, display), display)
    output = capsys.readouterr()
    assert "1000 (near) .. 2000 (far) mm, linear, onto" in output.out
    assert "1280 x 960 pixels of 0.03125 mm: 40 x 30 mm" in output.out


def test_it_runs_without_the_renderer(camera):
    loaded = loaded_by(*words(camera, *CAMERA, "--depth-unit", "mm", display=FEWER_LENSES))
    assert loaded.isdisjoint({"mitsuba", "drjit"})
    assert (camera / "eia.png").is_file()


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ((), "--orthographic"),
        ((*CAMERA, "--orthographic"), "exclude each other; give one"),
        ((*CAMERA, "--depth-unit", "m"), "--depth-unit of 1000 mm"),
        ((*CAMERA, "--missing", "x"), "--missing x"),
        ((*CAMERA, "--depth-unit", "mm", "--near", "3000"), "--near 3000"),
        ((*CAMERA, "--near", "nan"), "must be finite"),
        ((*CAMERA, "--depth-unit", "mm", "--near-is-large"), "grow away from the camera"),
        (("--orthographic", "--near-is-large", "--far-is-large"), "not allowed with"),
        (("--orthographic", "--frame-at", "5"), "--frame-at"),
        ((*CAMERA, "--frame-at", "-5", "--depth-unit", "mm"), "--frame-at -5"),
        ((*CAMERA, "--fill", "paint"), "--fill = 'paint': use none or hidden or all"),
        ((*CAMERA, "--fill", "all", "--algorithms", "template:fill=all"), "given twice"),
        ((*CAMERA, "--fit", "zoom"), "--fit: invalid choice: 'zoom' (choose from"),
        ((*CAMERA, "--max-slope", "0"), "--max-slope 0"),
        ((*CAMERA, "--algorithms", "magic"), "algorithm 'magic'"),
        ((*CAMERA, "--display", "watch"), "watch"),
        ((*CAMERA, "-D", "pitch=1"), "-D pitch"),
        ((*CAMERA, "-D", "inim.gap_mm=2.7", "--depth-map", "reciprocal"), "central depth plane"),
        ((*CAMERA, "-o", "eia.jpg"), "-o eia.jpg"),
        ((*CAMERA, "--pdf", "sheet.png"), "--pdf sheet.png"),
        (("--intrinsics", "600,600,319.5,239.5"), "principal point (319.5, 239.5)"),
    ],
)
def test_a_mistake_is_one_line_and_nothing_is_written(camera, more, says):
    assert_refused(*words(camera, *more), folder=camera, says=[says])


def test_an_input_is_never_written_over(camera):
    before = (camera / "color.png").read_bytes()
    more = (*CAMERA, "-o", str(camera / "color.png"))
    assert_refused(*words(camera, *more), folder=camera, says=["choose another name"])
    assert (camera / "color.png").read_bytes() == before


def light_field(folder: Path, across: int = 5, down: int = 3) -> np.ndarray:
    """Views of a textured wall, disparity -1, and a square before it, +1; the views."""
    from inim.image.files.light_field import write_hci

    rng = np.random.default_rng(5)
    wall = rng.integers(0, 128, (70, 100, 3)).astype(np.uint8)
    box = rng.integers(128, 256, (20, 24, 3)).astype(np.uint8)
    views = np.empty((down, across, 30, 40, 3), np.uint8)
    for v in range(down):
        for u in range(across):
            right, below = across // 2 - u, down // 2 - v  # where near things go, per pixel
            top, left = 20 + below, 30 + right  # the wall goes the other way
            views[v, u] = wall[top : top + 30, left : left + 40]
            views[v, u, 5 + below : 25 + below, 8 + right : 32 + right] = box
    write_hci(folder, views)
    disparity = np.full((30, 40), -1, "<f4")
    disparity[5:25, 8:32] = 1
    (folder / "gt_disp_lowres.pfm").write_bytes(b"Pf\n40 30\n-1\n" + disparity[::-1].tobytes())
    return views


def test_the_centre_view_with_its_disparity_agrees_with_the_true_views(tmp_path, capsys):
    light_field(tmp_path / "lf")
    # Of 35 pixels each fifth shows one view; a pixel of disparity is 16.5 mm, half of D = 33 mm.
    display = small_display(columns=40, rows=30, pixels=35, depth_min_mm=10, depth_max_mm=60)
    parameters = {"lens_columns": 40, "lens_rows": 30, "pixel_pitch_mm": repr(1 / 35)}
    parameters |= {"depth_min_mm": 10, "depth_max_mm": 60}
    more = [word for k, v in parameters.items() for word in ("-D", f"inim.{k}={v}")]
    more += [str(tmp_path / "lf")]
    for name, option in (("centre.png", ()), ("true.png", ("--all-views",))):
        assert main(["generate", *more, *option, "-o", str(tmp_path / name)]) == EXIT_PASSED
    output = capsys.readouterr()
    assert "5 x 3 of 40 x 30 pixels" in output.out
    assert "1 pixel is 16.5 mm of depth; +2 pixels added" in output.out
    centre, covered = read_eia(tmp_path / "centre.png", display)
    true, seen_by_all = read_eia(tmp_path / "true.png", display)
    # The pixels in the middle of each view's share of a lens look exactly its way.
    exact = np.tile(np.arange(35) % 7 == 3, 40)
    grid = np.tile(np.arange(35) % 7 == 3, 30)[:, None] & exact[None, :]
    # Three views down take three fifths of a lens; nothing says what lies beyond.
    lens_row = np.arange(30 * 35) % 35
    assert not seen_by_all[(lens_row < 7) | (lens_row >= 28)].any()
    in_both = covered & seen_by_all & grid
    assert in_both.sum() > 8000
    same = (np.abs(centre - true).max(axis=-1) < 0.02)[in_both]
    middle = in_both & (np.arange(1400) % 35 == 17)[None, :] & (lens_row == 17)[:, None]
    assert (np.abs(centre - true)[middle] < 0.02).all()
    # They part only where the centre view did not see: beside the square, and at its flanks.
    assert same.mean() > 0.9


def test_an_upright_picture_turns_a_wide_display_and_fills_it(camera, capsys, monkeypatch):
    """One command: the EIA is upright, and `inim view` accepts it with the same display."""
    rows, columns = np.mgrid[0:120, 0:90]
    color = np.stack([rows * 2, columns * 2, np.full_like(rows, 99)], -1).astype(np.uint8)
    depth = (1000 + 500 * (np.hypot(rows - 60, columns - 45) > 25)).astype(np.uint16)
    Image.fromarray(color).save(camera / "upright.png")
    Image.fromarray(depth).save(camera / "upright-depth.png")
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    files = {"color": "upright.png", "depth": "upright-depth.png"}
    wide = definitions({"inim.lens_columns": "40", "inim.lens_rows": "20"})
    more = ["--depth-unit", "mm", "--orthographic", "--open"]
    assert main(words(camera, *more, display=wide, **files)) == EXIT_PASSED
    output = capsys.readouterr()
    assert "turned" in output.out and "empty      0.0%" in output.out and output.err == ""
    with Image.open(camera / "eia.png") as eia:
        assert eia.size == (20 * 17, 40 * 17)
    assert opened == [(camera / "eia-view.html").as_uri()]
    assert (
        main(["view", str(camera / "eia.png"), *wide, "-o", str(camera / "v.html")]) == EXIT_PASSED
    )
    assert main(["export", str(camera / "eia.png"), *wide, "--pdf", str(camera / "a.pdf")]) == 0
