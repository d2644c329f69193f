"""`inim calibrate` writes the `visual.json` of a photographed lenticular display."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from inim.cli import main
from inim.display.looking_glass import LookingGlass, parse_calibration
from inim.scene.file import choose_display
from reports.calibration.cases import Case, Motion
from reports.calibration.landing import Assembly, Camera, look_at
from reports.calibration.photographs import photograph_case
from reports.lenticular.cases import draw_case
from reports.lenticular.run import view_errors

FILE = LookingGlass(47.6, -5.48, 0.0, 40.0, 338.0, 1000, 800)
HIDDEN = replace(FILE, pitch=47.9, slope=-5.6, center=0.7, view_cone=38.0)
EYES = ((2.0, -3.0, 130.0), (-32.0, 4.0, 140.0), (30.0, 2.0, 145.0))


@pytest.fixture(scope="module")
def photographs(tmp_path_factory) -> Path:
    """`design.json`, and `photos` of another display of three positions."""
    folder = tmp_path_factory.mktemp("lenticular")
    (folder / "design.json").write_text(FILE.text())
    design = str(folder / "design.json")
    assert main(["calibrate", "patterns", "--display", design, "-o", str(folder / "shown")]) == 0
    settings = draw_case(0)
    case = Case(
        0,
        FILE.display(),
        HIDDEN.display().replace(refractive_index=1.50),
        Camera(640, 512, 900.0, 323.0, 254.0, 0.03, -0.02, 2.0),
        tuple(look_at(np.array(eye), np.array([0.5, 0.3, 0.0]), 2.0, 1.0) for eye in EYES),
        settings.sensor,
        Assembly(0.05),
        zooms=(1.0,) * len(EYES),
        motions=(Motion(0.2),) * len(EYES),
    )
    photograph_case(case, folder / "shown", folder / "photos")
    return folder


def calibrate(folder: Path, photos: str, *words: str) -> int:
    return main(
        ["calibrate", str(folder / photos), "--display", str(folder / "design.json"), *words]
    )


def test_the_written_file_has_the_views_of_the_hidden_display(photographs, capsys):
    out = photographs / "visual.json"
    assert calibrate(photographs, "photos", "-o", str(out)) == 0
    printed = capsys.readouterr().out
    assert "viewCone" in printed and "not determined" not in printed
    calibrated = parse_calibration(out.read_bytes(), str(out))
    assert np.abs(view_errors(calibrated.text(), HIDDEN.text())).max() < 0.05, "lenses"
    assert np.abs(view_errors(FILE.text(), HIDDEN.text())).max() > 0.4, "the design would not do"
    assert abs(calibrated.view_cone - HIDDEN.view_cone) < 2
    display, _ = choose_display(str(out))
    assert display.lattice == "lenticular"
    page = (photographs / "visual-calibration" / "calibration.html").read_text("utf-8")
    assert "views, ‰ of a lens" in page


def remove(*numbers: int) -> Callable[[list[Path]], None]:
    return lambda paths: [paths[number].unlink() for number in numbers]


def reverse(paths: list[Path]) -> None:
    for number, path in enumerate(paths):
        path.rename(path.with_name(f"IMG_{99 - number}.jpg"))


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (remove(2, 7), "8 pictures, but there are 10 patterns"),
        (remove(0), "9 pictures, but there are 10 patterns"),
        (lambda paths: paths[0].write_bytes(b""), "the photograph of the white pattern is missing"),
        (reverse, "is darker than the waves; photograph the patterns in their order"),
    ],
)
def test_wrong_photographs_are_one_line(photographs, tmp_path, change, line, capsys):
    folder = tmp_path / "photos" / "position-1"
    folder.mkdir(parents=True)
    for path in (photographs / "photos" / "position-1").iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    change(sorted(folder.iterdir()))
    design = str(photographs / "design.json")
    words = ["--display", design, "-o", str(tmp_path / "visual.json")]
    assert main(["calibrate", str(folder.parent), *words]) == 2
    errors = capsys.readouterr().err
    assert line in errors and errors.count("\n") == 1
    assert not (tmp_path / "visual.json").exists()


def test_photographs_of_patterns_for_another_file_are_refused(photographs, tmp_path, capsys):
    other = tmp_path / "other.json"
    other.write_text(replace(FILE, slope=-5.9).text())
    words = ["--display", str(other), "-o", str(tmp_path / "visual.json")]
    assert main(["calibrate", str(photographs / "photos"), *words]) == 2
    assert "the marks of the white pattern are not those of" in capsys.readouterr().err


def test_a_display_file_of_a_lenticular_is_a_json(photographs, capsys):
    assert calibrate(photographs, "photos", "-o", "mine.xml") == 2
    assert "a display file is a .json; name it mine.json" in capsys.readouterr().err
