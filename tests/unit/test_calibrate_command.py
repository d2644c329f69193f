"""`inim calibrate` from the command line, with photographs that are decoded already.

Expected: a display file that others take, a report that keeps its schema; code 1 and what to do
where the photographs do not determine everything; one line for each mistake.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from inim.calibration import decode, patterns
from inim.calibration import run as calibration_run
from inim.calibration.model import Intrinsics, Pose
from inim.calibration.photo import simulate
from inim.cli import main
from inim.scene.file import choose_display
from tests.calibration_photographs import look_at, save_light, write_calibrated
from tests.schemas import read_document
from tests.unit.test_calibrate_fit import (
    CAMERA,
    DESIGN,
    EYES,
    HIDDEN,
    photograph_from,
    straight_photograph,
)

GIVEN = [
    word
    for key in ("lens_columns", "lens_rows", "panel_columns", "panel_rows")
    for word in ("-D", f"inim.{key}={getattr(DESIGN, key)}")
]


@pytest.fixture
def photos(monkeypatch, tmp_path):
    """Positions that are there, by name; their focal lengths."""
    by_name = {name: photograph_from(name) for name in EYES}
    stated = dict.fromkeys(by_name)

    def read_positions(folder, display):
        assert folder == tmp_path / "<photos>" and display.eia_shape == DESIGN.eia_shape
        return [SimpleNamespace(name=name, focal_length_px=stated.get(name)) for name in by_name]

    monkeypatch.setattr(calibration_run, "read_positions", read_positions)
    monkeypatch.setattr(calibration_run, "decode", lambda position: by_name[position.name])
    return SimpleNamespace(photographs=by_name, stated=stated, folder=str(tmp_path / "<photos>"))


def run(photos, *words: str) -> int:
    return main(["calibrate", photos.folder, "--display", "phone", *GIVEN, *words])


def test_a_display_file_and_a_report_are_written(photos, tmp_path, capsys):
    out = tmp_path / "mine.xml"
    assert run(photos, "-o", str(out)) == 0
    output = capsys.readouterr()
    assert "pitch_mm" in output.out and "±" in output.out and not output.err
    display, _ = choose_display(str(out))
    assert abs(display.rotation_deg - HIDDEN.rotation_deg) < 0.01
    assert abs(display.gap_mm - HIDDEN.gap_mm) < 0.05
    folder = tmp_path / "mine-calibration"
    document = read_document(folder / "calibration.json")
    assert f"{folder}/calibration.html" in output.out
    assert (
        document["command"].startswith("inim calibrate")
        and "--display phone" in document["command"]
    )
    assert {*document["files"]} == {p.name for p in folder.iterdir() if p.name[0] != "."}
    assert [position["name"] for position in document["positions"]] == [*EYES]
    assert document["parameters"]["gap_mm"]["is_determined"]
    correlation = np.array(document["correlation"]["matrix"])
    assert correlation.shape == (15, 15)
    np.testing.assert_allclose(np.diag(correlation), 1)
    page = (folder / "calibration.html").read_text("utf-8")
    assert "<photos>" not in page and "&lt;photos&gt;" in page
    for words in ("Lens pitch P, mm", "What to photograph next", "data:image/svg+xml", "near"):
        assert words in page
    assert (folder / "residuals.png").stat().st_size > 10_000


@pytest.mark.slow
def test_intrinsics_are_opencv_s(photos, tmp_path):
    x, y = CAMERA.centre
    numbers = (CAMERA.focal, CAMERA.focal, x - 0.5, y - 0.5, CAMERA.k1, CAMERA.k2)
    option = ",".join(f"{n:g}" for n in numbers)
    assert run(photos, "--intrinsics", option, "-o", str(tmp_path / "mine.xml")) == 0
    camera = read_document(tmp_path / "mine-calibration" / "calibration.json")["camera"]
    assert camera["is_given"] and camera["centre_x_px"] == pytest.approx(x)
    assert camera["focal_px"] == CAMERA.focal and camera["standard_errors"]["k1"] is None


@pytest.mark.slow
def test_too_few_positions_name_the_undetermined_parameters(photos, tmp_path, capsys):
    photos.photographs.clear()
    photos.photographs["straight"] = straight_photograph()
    assert run(photos, "-o", str(tmp_path / "mine.xml")) == 1
    output = capsys.readouterr()
    assert "rotation_deg" in output.out and "gap_mm            not determined" in output.out
    assert "not determined by these photographs" in output.err
    assert "photograph from" in output.err
    display, _ = choose_display(str(tmp_path / "mine.xml"))
    assert display.gap_mm == DESIGN.gap_mm
    assert abs(display.rotation_deg - HIDDEN.rotation_deg) < 0.1


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["-o", "mine.png"], "a display file is an .xml; name it mine.xml"),
        (["--intrinsics", "1,2,3"], "write FX,FY,CX,CY,K1,K2"),
        (["--intrinsics", "900,1000,3,4,0,0"], "pixels are assumed to be square"),
        (["--intrinsics", "0,0,3,4,0,0"], "pixels are assumed to be square"),
        (["-D", "inim.lattice=hexagonal"], "lattice = 'hexagonal' cannot be calibrated"),
    ],
)
def test_a_mistake_is_one_line(photos, words, line, capsys):
    assert run(photos, *words) == 2
    errors = capsys.readouterr().err
    assert line in errors and errors.count("\n") == 1


def test_zoom_between_positions_is_refused(photos, capsys):
    photos.stated.update(near=1900.0, far=2500.0)
    assert run(photos) == 2
    assert "focal length differs between positions" in capsys.readouterr().err


def test_the_word_patterns_writes_them(tmp_path, capsys):
    out = tmp_path / "shown"
    assert main(["calibrate", "patterns", "--display", "phone", *GIVEN, "-o", str(out)]) == 0
    assert (out / "patterns.html").is_file() and str(out) in capsys.readouterr().out


@pytest.mark.parametrize("words", [["--steady"], ["--intrinsics", "900,900,3,4,0,0"]])
def test_patterns_take_no_option_of_the_camera(words, tmp_path, capsys):
    out = tmp_path / "shown"
    assert main(["calibrate", "patterns", "--display", "phone", *words, "-o", str(out)]) == 2
    assert f"{words[0]}: patterns have no camera" in capsys.readouterr().err
    assert not out.exists()


def test_patterns_of_a_display_that_cannot_be_calibrated_are_refused(tmp_path, capsys):
    out = tmp_path / "folder"
    display = ["--display", "looking-glass-go-typical", "-D", "inim.refractive_index=1.49"]
    assert main(["calibrate", "patterns", *display, "-o", str(out)]) == 2
    assert "does not reach the aperture's edge" in capsys.readouterr().err
    assert not out.exists()


# -- a photograph from elsewhere ------------------------------------------------------------------


@pytest.fixture
def bench(monkeypatch, tmp_path):
    """A display file, its calibration, an EIA, and a photograph of it from the left."""
    camera = Intrinsics(CAMERA.focal, *CAMERA.centre, CAMERA.k1, CAMERA.k2)
    eia = write_calibrated(tmp_path, HIDDEN, camera, CAMERA.shape)
    eye, target, roll = EYES["left"]
    pose = Pose(look_at(eye, target, roll), np.array(eye))
    light, _ = simulate(eia, HIDDEN, camera, pose, CAMERA.shape)
    save_light(tmp_path / "photo.png", light)
    position = SimpleNamespace(name="again", shape=CAMERA.shape)
    monkeypatch.setattr(patterns, "read_position", lambda folder, display: position)
    monkeypatch.setattr(decode, "decode", lambda position: photograph_from("left"))
    monkeypatch.chdir(tmp_path)
    return position


def photo(*words: str) -> int:
    return main(["photo", "photo.png", "--eia", "eia.png", "--display", "mine.xml", *words])


def test_a_photograph_is_simulated_from_where_the_patterns_were_photographed(bench, tmp_path):
    assert photo("--patterns", "shots/again", "-o", "out") == 0
    data = read_document(tmp_path / "out" / "photo.json")
    geometry = data["geometry"]
    assert abs(geometry["right_px"]) < 0.1 and abs(geometry["down_px"]) < 0.1
    assert geometry["largest_block_px"] < 0.3
    assert data["stages"][0]["scores"]["ssim"] > 0.98
    assert data["position"] == "again" and "--patterns shots/again" in data["command"]


def test_patterns_of_another_camera_are_refused(bench, capsys):
    bench.shape = (100, 200)
    assert photo("--patterns", "again") == 2
    assert "again: 200 x 100 pixels, but the calibration's photographs have 480 x 360" in (
        capsys.readouterr().err
    )
