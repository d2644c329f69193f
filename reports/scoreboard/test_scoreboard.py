"""Scores of the scoreboard, on a textured plane that has them in closed form."""

import json
import math
import sys

import numpy as np
import pytest
from PIL import Image

from inim.image.files.picture import write_pfm
from reports.scoreboard.field import LightField, of_views, read
from reports.scoreboard.page import NEAREST, page
from reports.scoreboard.rivals import copy, rvs, splat
from reports.scoreboard.run import KINDS, Scores, algorithms, measure, methods

SIDE, ROWS, COLUMNS, RIM = 5, 24, 30, 8
GREY = 90


def plane(disparity: int) -> LightField:
    """A textured plane with a grey rim: a view is the next one, shifted by the disparity."""
    wide = np.full((ROWS + 2 * RIM, COLUMNS + 2 * RIM, 3), GREY, np.uint8)
    inner = 2 * RIM
    texture = np.random.default_rng(5).integers(0, 256, wide[inner:-inner, inner:-inner].shape)
    wide[inner:-inner, inner:-inner] = texture
    views = {}
    for row, column in np.ndindex(SIDE, SIDE):
        top, left = (RIM + disparity * (n - SIDE // 2) for n in (row, column))
        views[row, column] = wide[top : top + ROWS, left : left + COLUMNS]
    return of_views("plane", SIDE, views, np.full((ROWS, COLUMNS), disparity, np.float32))


# Four rays of a panel pixel lie a quarter of a view apart from its own: at disparity 2 they would
# meet the border of the next picture pixel.
@pytest.fixture(scope="module", params=[-1, 1])
def measured(request):
    return request.param, plane(request.param), measure(plane(request.param))


def _is_nearest(method):
    """True if a method copies pixels."""
    return "colour=nearest" in method or not method.startswith(("template", "layered"))


def test_every_algorithm_shows_a_plane_to_the_last_bit_where_the_picture_does(measured):
    _, _, result = measured
    for name in filter(_is_nearest, methods()):
        assert result["methods"][name]["shown_psnr_db"] is None, name
    assert set(algorithms()) <= result["methods"].keys()


def test_filling_continues_the_plane_beyond_the_edge(measured):
    _, _, result = measured
    assert result["pixel_share"]["beyond_edge"] > 0
    filling = ["splat", NEAREST, *(n for n in methods() if "fill=" in n and _is_nearest(n))]
    for name in filling:
        assert result["methods"][name]["psnr_db"] is None, name
        assert result["methods"][name]["ssim"] == pytest.approx(1)


def test_black_holes_are_beyond_the_edge_and_count(measured):
    disparity, _, result = measured
    shares = [1 - (1 - abs(disparity * r) / ROWS) * (1 - abs(disparity * c) / COLUMNS)
              for r in range(-2, 3) for c in range(-2, 3) if (r, c) != (0, 0)]  # fmt: skip
    assert result["pixel_share"]["beyond_edge"] == pytest.approx(np.mean(shares))
    expected = -10 * math.log10(np.mean(shares) * (GREY / 255) ** 2)
    scored = result["methods"]["template:samples=1:colour=nearest"]
    assert scored["psnr_db"] == pytest.approx(expected, abs=1e-3)
    assert scored["error_share"] == pytest.approx(dict(zip(KINDS, (0, 0, 1), strict=True)))


def test_a_copy_has_the_error_of_an_unshifted_plane(measured):
    _, field, result = measured
    middle = field.middle.astype(float)
    squares = {p: np.mean((v - middle) ** 2) / 255**2 for p, v in field.views.items()}
    scored = result["methods"]["copy"]
    assert scored["psnr_db"] == pytest.approx(-10 * math.log10(np.mean(list(squares.values()))))
    next_ones = [s for (r, c), s in squares.items() if max(abs(r - 2), abs(c - 2)) == 1]
    expected = -10 * math.log10(np.mean(next_ones))
    assert scored["by_distance"]["1"]["psnr_db"] == pytest.approx(expected)
    assert squares[tuple(scored["worst_view"]["place"])] == max(squares.values())


def test_a_maker_that_leaves_views_out_is_refused():
    field = plane(1)
    views = list(copy(field))[1:]
    with pytest.raises(ValueError, match="23 views; the light field has 24"):
        Scores(field).of(iter(views))


def test_splat_puts_the_nearest_on_top():
    field = plane(0)
    disparity = field.disparity.copy()
    disparity[10, 10] = 2
    views = dict(field.views) | {(2, 2): field.middle}
    near = of_views("bump", SIDE, views, disparity)
    view = dict(splat(near))[2, 3]  # one view to the right: it moves left by two pixels
    assert np.array_equal(view[10, 8], field.middle[10, 10])


# Instead of a view, where each camera sees what is on the input camera's axis.
_STAND_IN = """import json, sys
from PIL import Image
config = json.load(open(sys.argv[1]))
cameras = {c["Name"]: c for c in json.load(open(config["VirtualCameraParameterFile"]))["cameras"]}
source = cameras[config["InputCameraNames"][0]]
assert source["Position"] == [0, 0, 0]
levels = Image.open(config["DepthMapNames"][0])
near, far = source["Depth_range"]
z = 1 / (1 / far + levels.getpixel((0, 0)) / 65535 * (1 / near - 1 / far))
for name, out in zip(config["VirtualCameraNames"], config["OutputFiles"]):
    camera = cameras[name]
    left, up = camera["Position"][1:]
    # Where a point on the input camera's axis is, from its principal point.
    x = camera["Principle_point"][0] + camera["Focal"][0] * left / z - source["Principle_point"][0]
    y = camera["Principle_point"][1] + camera["Focal"][1] * up / z - source["Principle_point"][1]
    Image.new("RGB", levels.size, (128 + round(20 * x), 128 + round(20 * y), 7)).save(out)
"""


@pytest.mark.parametrize("disparity", [-2, 1])
def test_rvs_is_given_cameras_that_see_the_disparity(tmp_path, disparity):
    program = tmp_path / "rvs"
    program.write_text(f"#!{sys.executable}\n{_STAND_IN}", "utf-8")
    program.chmod(0o755)
    for (row, column), view in rvs(plane(disparity), program):
        moved = (-disparity * (column - 2), -disparity * (row - 2))
        assert view[0, 0].tolist() == [128 + 20 * moved[0], 128 + 20 * moved[1], 7]


def test_a_folder_is_read_with_its_grid_its_rim_and_its_source(tmp_path):
    field = plane(1)
    folder = tmp_path / "plane"
    folder.mkdir()
    views = dict(field.views) | {(2, 2): field.middle}
    del views[0, 3]
    for (row, column), view in views.items():
        Image.fromarray(view).save(folder / f"input_Cam{row * SIDE + column:03}.png")
    (folder / "parameters.cfg").write_text(f"[extrinsics]\nnum_cams_x = {SIDE}\n", "utf-8")
    write_pfm(folder / "gt.pfm", np.ones((ROWS - 4, COLUMNS - 2), np.float32))
    (folder / "source.json").write_text(json.dumps({"source": "s", "licence": "l"}), "utf-8")
    field_read = read(folder)
    assert field_read.side == SIDE and (field_read.source, field_read.licence) == ("s", "l")
    assert field_read.views.keys() == field.views.keys() - {(0, 3)}
    assert np.array_equal(field_read.disparity, field.disparity)
    assert all(np.array_equal(view, field.views[p]) for p, view in field_read.views.items())


def test_the_page_lists_the_worst_first_and_names_the_loser(measured):
    _, _, result = measured
    _, parts = page({"plane": result})
    psnrs = [row[1] for row in parts[1].tables[0].rows]
    numbers = [math.inf if p == "∞" else float(p) for p in psnrs]
    assert len(numbers) == len(result["methods"]) and numbers == sorted(numbers)
    assert "Below naive splat, nearest fill: " in parts[0].claims[1][-1]
