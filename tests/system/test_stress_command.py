"""A whole quick stress run from the command line.

Expected: every relation holds, every file is there, mistakes cost one line and no folder.
"""

import sys
from pathlib import Path

import pytest

from inim.apps.stress.relation import TOPICS
from inim.display.settings import Settings
from inim.system.errors import EXIT_CHECK_FAILED, EXIT_PASSED
from tests.schemas import read_document
from tests.system.conftest import (
    TINY,
    assert_refused,
    definitions,
    files_in,
    install_metadata,
    nothing_left,
    run_child,
    write_scene,
)

ROOT = Path(__file__).parents[2]
FILES = {"growth.png", "growth.svg", "stress.html", "stress.json", "stress.md"}


def run(module: str, *words: object, folder: Path):
    return run_child([sys.executable, "-m", module, *map(str, words)], timeout=1800, cwd=folder)


def run_stress(*words: object, folder: Path):
    return run("inim", "stress", *words, folder=folder)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stress 鼎")
    ended = run_stress("--quick", "-o", "out", folder=folder)
    assert ended.code == EXIT_PASSED, ended.stderr + ended.stdout
    return ended, folder, read_document(folder / "out" / "stress.json")


def test_every_file_is_there_and_nothing_half_written(finished):
    _, folder, data = finished
    assert files_in(folder / "out") == FILES == set(data["files"])
    assert nothing_left(folder)


def test_data_are_complete_and_every_relation_holds(finished):
    ended, _, data = finished
    assert (data["schema"], data["mode"], data["passed"]) == ("inim.stress/4", "quick", True)
    assert all(r["passed"] and r["cases"] > 0 for r in data["relations"])
    assert {r["topic"] for r in data["relations"]} == set(TOPICS)
    names, models = set(data["algorithms"]), set(data["lens_models"])
    assert names >= {"template", "layered", "gu2020", "wang2024", "li2012"}
    assert models >= {"pinhole", "thin", "thick", "full"}
    assert {r["subject"] for r in data["relations"]} - {""} == names | models
    assert {r["algorithm"] for r in data["jitter"]} == names
    hits = {r["subject"]: r for r in data["relations"] if r["relation"] == "first hits"}
    assert not hits["template"]["explained"] and hits["template"]["worst"] == 0
    assert hits["wang2024"]["explained"] and hits["wang2024"]["broken"] > 0
    assert all(r["growth"] for r in data["relations"] if r["axis"])
    lines = ended.stdout.splitlines()
    assert any(line.startswith("ok") and "wang2024: " in line and "%" in line for line in lines)


@pytest.mark.slow
def test_the_full_run_holds(tmp_path):
    ended = run_stress("-o", "out", folder=tmp_path)
    assert ended.code == EXIT_PASSED, ended.stderr + ended.stdout
    data = read_document(tmp_path / "out" / "stress.json")
    assert data["mode"] == "full" and data["passed"]


@pytest.mark.slow
def test_an_algorithm_that_others_announce_is_run_by_name_and_a_failure_is_its_exit_code(
    tmp_path, monkeypatch
):
    (tmp_path / "planted_eia.py").write_text(
        """
import numpy as np

def prepare(display, shape, pixel_mm):
    return Fickle(display.eia_shape)

class Fickle:
    calls = 0

    def __init__(self, shape):
        self.shape = shape

    def generate(self, rgbd, out=None):
        Fickle.calls += 1
        return np.full((*self.shape, 3), Fickle.calls % 7, np.float32)
"""
    )
    install_metadata(tmp_path, "planted", "[inim.generators]\nplanted = planted_eia:prepare\n")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{ROOT}")
    words = ("--quick", "--algorithms", "planted,gu2020", "--relations", "split panels,mirrored")
    ended = run_stress(*words, "-o", tmp_path / "out", folder=tmp_path)
    assert ended.code == EXIT_CHECK_FAILED, ended.stderr
    lines = ended.stdout.splitlines()
    assert lines[0].startswith("FAILED  planted: 2 relations, ")
    assert any(line.startswith("ok      gu2020: 2 relations, 0 broken") for line in lines)


@pytest.mark.slow
def test_a_scene_s_own_depth_is_jittered(tmp_path):
    scene = write_scene(tmp_path / "scene")
    # On fewer lenses none of the few hundred pixels of the relic lies so near to a cell's exit.
    settings = TINY | {"inim.lens_columns": "24", "inim.lens_rows": "18"}
    words = ("--quick", "--algorithms", "template", "--relations", "moved by a lens", "-o", "out")
    ended = run_stress(scene, *words, *definitions(settings), folder=tmp_path)
    assert ended.code == EXIT_PASSED, ended.stderr + ended.stdout
    data = read_document(tmp_path / "out" / "stress.json")
    assert (data["title"], data["picture"]["name"]) == ("Stress: tiny", str(scene))
    display = Settings.parse(settings, "tiny").make_display("tiny")
    shape = data["picture"]["rows"], data["picture"]["columns"]
    assert shape == display.capture_shape(Settings().capture_pixels_per_pitch)
    changed = {r["jitter"]: r["changed"] for r in data["jitter"] if r["algorithm"] == "template"}
    assert 0 < changed["8 bits"] < 0.2 and changed["+1 ulp"] < 0.01
    assert data["command"].split()[:3] == ["inim", "stress", str(scene)]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("missing.xml",), ["missing.xml"]),
        (("-D", "inim.gap_mm=3"), ["-D", "scene"]),
        (("--algorithms", "nobody"), ["nobody", "template"]),
        (("--lens-models", "nobody"), ["nobody", "thick"]),
        (("--relations", "mirored"), ["mirored", "mirrored"]),
    ],
)
def test_mistakes_cost_one_line_and_no_folder(tmp_path, words, says):
    assert_refused("stress", *words, folder=tmp_path, says=says)
