"""`inim tolerate` on a tiny display: drawn, swept, and said.

Expected: what is computed once is not computed again, and another criterion computes nothing;
scores are those of misaligned validations; mistakes are one line.
"""

from __future__ import annotations

import json
import shutil

import pytest

import inim
from inim.errors import EXIT_CHECK_FAILED, EXIT_PASSED
from tests.schemas import completed, read_document
from tests.system.conftest import (
    TINY,
    assert_refused,
    definitions,
    nothing_left,
    run_here,
    worker_here,
    write_scene,
)

pytestmark = pytest.mark.usefixtures("no_page")
STUDY = """
[study]
alone = 5
together = 2
reach = 4
[errors]
shift_x_mm = { normal = 0.02 }
"""
COMMAND = ("tolerate", "tiny.xml", "--study", "errors.toml", "-o", "out", "--viewpoints", "centre")


@pytest.fixture(scope="module")
def tolerance_run(no_page, tmp_path_factory):
    folder = tmp_path_factory.mktemp("tolerate 鼎")
    write_scene(folder)
    (folder / "errors.toml").write_text(STUDY)
    ended = run_here(*COMMAND, *definitions(TINY), folder=folder)
    assert ended.code == EXIT_PASSED, ended.stderr + ended.stdout
    return folder, ended


def pages(folder):
    return {p: p.stat().st_mtime_ns for p in folder.glob("out/units/*/*.json")}


def test_all_displays_are_drawn_and_listed(tolerance_run):
    folder, ended = tolerance_run
    data = read_document(folder / "out" / "tolerate.json")
    (row,) = data["parameters"]
    assert (row["name"], len(row["draws"])) == ("shift_x_mm", 5)
    assert len(data["together"]["draws"]) == 2
    assert data["failed"] == []
    # Farther off is worse.
    near, *_, far = sorted(row["draws"], key=lambda draw: abs(draw["error"]))
    assert far["score"] < near["score"] <= data["aligned"] + 0.01
    lines = ended.stdout.splitlines()
    assert any("1 validations of 1 algorithms; 0 of 1 results" in line for line in lines)
    assert any("8 validations of 1 algorithms; 1 of 8 results" in line for line in lines)
    (sentence,) = [line for line in lines if "shift x" in line and line.startswith("With")]
    assert f"{row['tolerance']:.3g}" in sentence
    assert sentence in (folder / "out" / "tolerate.html").read_text("utf-8")
    assert nothing_left(folder)


def test_scores_are_those_of_validations_of_misaligned_displays(tolerance_run, tmp_path):
    folder = tolerance_run[0]
    data = read_document(folder / "out" / "tolerate.json")
    draw = data["together"]["draws"][1]
    with worker_here():
        report = inim.validate(
            folder / "tiny.xml", tmp_path / "alone", algorithms="pickup", viewpoints="centre",
            misalign=draw["errors"], definitions=TINY,
        )  # fmt: skip
    score = report.data.algorithms["pickup"].views["centre"]["ssim_on_relic_to_reference"]
    assert draw["score"] == score


def test_another_criterion_computes_nothing(tolerance_run, tmp_path):
    folder = tmp_path / "copy"  # other tests read the first run's
    shutil.copytree(tolerance_run[0], folder)
    before = pages(folder)
    words = (*COMMAND, *definitions(TINY), "--criterion", "0.03")
    planned = run_here(*words, "--dry-run", folder=folder)
    assert planned.stdout.endswith("8 of 8 results exist, 0 validations to run\n")
    strict = read_document(folder / "out" / "tolerate.json")
    reached = {"parameters": {"shift_x_mm": {"standard_error": 0.001}}}
    (folder / "calibration.json").write_text(json.dumps(completed("calibration", reached)))
    ended = run_here(*words, "--calibration", "calibration.json", folder=folder)
    assert ended.code == EXIT_PASSED, ended.stderr
    assert pages(folder) == before
    loose = read_document(folder / "out" / "tolerate.json")
    shift, shift_before = loose["parameters"][0], strict["parameters"][0]
    assert shift["draws"] == shift_before["draws"]
    assert shift["tolerance"] > shift_before["tolerance"]
    assert "A calibration reaches" in ended.stdout
    assert loose["together"]["share"] >= strict["together"]["share"]


def test_a_display_that_cannot_be_mounted_is_named_and_the_others_count(tmp_path):
    write_scene(tmp_path)
    # The gap is 3.3 mm: the farthest draws bring the lenses into the panel.
    (tmp_path / "errors.toml").write_text(
        "[study]\nalone = 6\ntogether = 0\nreach = 2\n[errors]\ngap_mm = { normal = 2.5 }\n"
    )
    ended = run_here(*COMMAND, *definitions(TINY), "--quiet", folder=tmp_path)
    assert ended.code == EXIT_CHECK_FAILED
    assert ended.stdout == ""
    data = read_document(tmp_path / "out" / "tolerate.json")
    assert 0 < len(data["failed"]) < 6
    assert len(data["failed"]) + len(data["parameters"][0]["draws"]) == 6
    for line, failure in zip(ended.stderr.splitlines(), data["failed"], strict=True):
        assert line == f"inim: failed: {failure['display']}: {failure['error']}"
        assert " · gap_mm=-" in failure["display"]
        assert "gap" in failure["error"]
    assert data["together"] is None


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--criterion", "0"), ["--criterion 0", "between 0 and 1"]),
        (("--algorithms", "template,gu2020"), ["--algorithms template,gu2020", "single algorithm"]),
        (("--algorithms", "templat"), ["did you mean template"]),
        (("-D", "inim.misalign=gap_mm=1"), ["misalign", "leave it out"]),
        (("--display", "phnoe"), ["did you mean phone"]),
        (("--calibration", "tiny.xml"), ["tiny.xml", "not a JSON document"]),
        (("--workers", "0"), ["--workers 0"]),
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing(tmp_path, words, says):
    write_scene(tmp_path)
    (tmp_path / "errors.toml").write_text(STUDY)
    assert_refused(*COMMAND, *words, folder=tmp_path, says=says)
