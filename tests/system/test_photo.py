"""`inim photo`: what was done to a photograph on purpose is found, each in its own row."""

from __future__ import annotations

import json
import re
import shutil

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter, shift

from inim.calibration.model import Intrinsics, Pose
from inim.calibration.photo import simulate
from inim.files.image import write_exr
from tests.calibration_photographs import save_light, write_calibrated
from tests.conftest import small_display
from tests.schemas import read_document
from tests.system.conftest import assert_refused, run_here

DISPLAY = small_display(24, 18, 17, rotation_deg=0.7, gap_mm=3.2)
CAMERA = Intrinsics(3000.0, 201.0, 148.0, 0.01)
POSE = Pose(np.diag([1.0, -1.0, -1.0]), np.array([3.0, -2.0, 210.0]))
SHAPE = (300, 400)
MOVED, BLUR, GAMMA = (0.5, -0.25), 0.9, 1.2


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with a display file, its calibration, an EIA and a photograph of it."""
    folder = tmp_path_factory.mktemp("photo")
    place = {"eye_mm": POSE.eye_mm.tolist(), "turn": POSE.turn.tolist()}
    positions = [place | {"name": name} for name in ("front", "side")]
    linear = write_calibrated(folder, DISPLAY, CAMERA, SHAPE, positions)
    read_document(folder / "mine-calibration" / "calibration.json")
    light, _ = simulate(linear, DISPLAY, CAMERA, POSE, SHAPE)
    soft = gaussian_filter(shift(light, (MOVED[1], MOVED[0], 0), order=3), (BLUR, BLUR, 0))
    noise = np.random.default_rng(5).normal(0, 0.002, light.shape)
    save_light(folder / "photo.png", 0.01 + 0.9 * np.maximum(soft, 0) ** GAMMA + noise)
    return folder


def words_of(*more: str, photograph="photo.png", eia="eia.png", display="mine.xml") -> list[str]:
    """Command line of `inim photo`."""
    return ["photo", photograph, "--eia", eia, "--display", display, *more]


def test_shift_blur_and_gamma_are_found_each_in_its_row(bench):
    ended = run_here(*words_of("--position", "front", "-o", "out"), folder=bench)
    assert (ended.code, ended.stderr) == (0, "")
    data = read_document(bench / "out" / "photo.json")
    geometry = data["geometry"]
    assert (geometry["right_px"], geometry["down_px"]) == pytest.approx(MOVED, abs=0.03)
    assert geometry["lens_px"] == pytest.approx(3000 / 210, rel=1e-3)
    assert data["blur_sigma_px"] == pytest.approx(BLUR, abs=0.1)
    for tone in data["tone"].values():
        assert tone["gamma"] == pytest.approx(GAMMA, abs=0.05)
        assert tone["black"] == pytest.approx(0.01, abs=0.01)
    ssim = [stage["scores"]["ssim"] for stage in data["stages"]]
    assert ssim[-1] == max(ssim) > ssim[0] + 0.005
    assert data["stages"][-1]["error_share"] < 0.1
    page = (bench / "out" / "photo.html").read_text("utf-8")
    assert re.search(r"0\.\d+ right, −0\.\d+ down", page)
    assert set(data["files"]) >= {"photograph.png", "simulation.png", "matched.png", "flow.svg"}
    assert "geometry  +0." in ended.stdout and "out/photo.html" in ended.stdout


@pytest.mark.parametrize(
    ("more", "display", "words"),
    [
        ([], "mine.xml", ["--position", "front or side"]),
        (["--position", "frnt"], "mine.xml", ["frnt", "did you mean front?"]),
        (["--position", "front", "--patterns", "p"], "mine.xml", ["--patterns", "not allowed"]),
        (["--patterns", "p"], "mine.xml", ["p: ", "0 pictures"]),
        (["--position", "front"], "nominal", ["--display", "inim calibrate"]),
        (["--position", "front"], "other.xml", ["calibration.json", "no such file"]),
    ],
)
def test_missing_inputs_are_named(bench, more, display, words):
    (bench / "other.xml").write_text((bench / "mine.xml").read_text())
    (bench / "p").mkdir(exist_ok=True)
    assert_refused(*words_of(*more, display=display), folder=bench, says=words)


def test_names_with_superscript_digits_are_names(bench):
    (bench / "p²").mkdir()
    for name in ("²1.png", "①.png"):
        (bench / "p²" / name).write_bytes(b"no picture")
    assert_refused(*words_of("--patterns", "p²"), folder=bench, says=["p²"])


def test_a_photograph_of_another_size_is_refused(bench):
    Image.new("RGB", (200, 100)).save(bench / "small.png")
    words = words_of("--position", "side", photograph="small.png")
    assert_refused(*words, folder=bench, says=["small.png", "200 x 100", "400 x 300"])


@pytest.mark.parametrize("change", ["inverted", "mirrored"])
def test_a_photograph_of_something_else_is_refused(bench, change):
    codes = np.asarray(Image.open(bench / "photo.png"))
    other = {"inverted": 255 - codes, "mirrored": codes[:, ::-1]}[change]
    Image.fromarray(other).save(bench / "other.png")
    words = words_of("--position", "front", "-o", "refused", photograph="other.png")
    says = ["other.png", "does not resemble", "mirrored nor inverted"]
    assert_refused(*words, folder=bench, says=says)


def test_eia_that_no_panel_shows_is_refused(bench):
    for name, value in (("nan", np.nan), ("inf", np.inf), ("negative", -0.1)):
        eia = np.full((*DISPLAY.eia_shape, 3), 0.5, np.float32)
        eia[3, 4] = value
        write_exr(bench / f"{name}.exr", eia)
        words = words_of("--position", "front", eia=f"{name}.exr")
        assert_refused(*words, folder=bench, says=[f"{name}.exr", "not finite"])


@pytest.mark.parametrize(
    ("part", "name", "value", "words"),
    [
        ("camera", "focal_px", 0, ["focal_px = 0"]),
        ("camera", "k1", 1e300, ["k1 = 1e+300"]),
        ("positions", "turn", [[1, 0, 0], [0, 1, 0], [0, 0.5, 1]], ["side", "not a rotation"]),
        ("positions", "eye_mm", [0, 0, 0], ["side", "in front of the display"]),
    ],
)
def test_impossible_calibration_is_refused(bench, tmp_path, part, name, value, words):
    folder = shutil.copytree(bench, tmp_path / "copy")
    path = folder / "mine-calibration" / "calibration.json"
    data = json.loads(path.read_text())
    (data["positions"][1] if part == "positions" else data[part])[name] = value
    path.write_text(json.dumps(data))
    says = ["calibration.json", *words]
    assert_refused(*words_of("--position", "front"), folder=folder, says=says)
