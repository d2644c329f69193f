"""A whole validation of a tiny display, from the command line and from Python.

Expected: every file of the report, finite numbers, one line of results for each algorithm and
viewpoint, a verdict that decides the exit code, and folders that appear whole or not at all.
"""

import math
import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from inim.image.color import srgb_from_linear
from inim.image.files.image import read_exr
from inim.pipeline import validate
from inim.system.errors import EXIT_CHECK_FAILED, EXIT_PASSED, UsageError
from tests.conftest import scene_text, sphere
from tests.schemas import read_document
from tests.system.conftest import SMALLEST, Ended, files_in, nothing_left, write_scene

Run = Callable[..., Ended]
ALGORITHMS = ["template", "wang2024"]  # not in the default's order
VIEWS = ["centre", "mine"]
FILES = {
    "report.html", "report.json", "junit.xml", "summary.md",
    "rgbd.exr", "rgbd_color.png", "rgbd_depth.png",
    "regression/candidate.json", "regression/candidate.npz",
    *(f"truth/relic/{view}.png" for view in VIEWS),
    *(f"{name}.{kind}" for kind in ("png", "exr") for name in (
        "truth/eia", *(f"truth/{view}" for view in VIEWS),
        *(f"eia/{algorithm}" for algorithm in ALGORITHMS),
        *(f"views/{eia}/{view}" for eia in ("reference", *ALGORITHMS) for view in VIEWS),
    )),
}  # fmt: skip
SCORES = {
    f"{name}{on}{to}{unit}"
    for name, unit in (("ssim", ""), ("psnr", "_db"), ("flip", ""))
    for on in ("", "_on_relic")
    for to in ("", "_to_reference")
}


def numbers_in(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every number and null in nested data, with where it stands."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from numbers_in(item, f"{path}/{key}")
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from numbers_in(item, f"{path}/{index}")
    elif value is None or isinstance(value, (int, float)):
        yield path, value


class Finished:
    """One run and where it lies."""

    def __init__(self, ended: Ended, out: Path, data: dict[str, Any]) -> None:
        self.ended, self.out, self.data = ended, out, data


@pytest.fixture(scope="module")
def finished(tmp_path_factory, run_process):
    """The run that most claims below are about: two algorithms, two viewpoints.

    As a shell starts it, in processes of its own.
    """
    folder = tmp_path_factory.mktemp("names with 'quotes' 青铜")
    scene = write_scene(folder, name='a "b" & 鼎.xml')
    options = ("--algorithms", ",".join(ALGORITHMS), "--viewpoints", "centre, mine=3 -2")
    ended = run_process(scene.name, "-o", "deep/o u't", *options, folder=folder)
    out = folder / "deep" / "o u't"
    assert ended.code == EXIT_PASSED, ended.stderr
    return Finished(ended, out, read_document(out / "report.json"))


@pytest.fixture(scope="module")
def replaced(tmp_path_factory, run_inim):
    """Two runs into one folder, the second with fewer pictures and a limit that is not met."""
    folder = tmp_path_factory.mktemp("twice")
    scene = write_scene(folder)
    (folder / "out" / "views" / "wang2024").mkdir(parents=True)
    (folder / "out" / "notes.txt").write_text("mine")
    (folder / "out" / "views" / "wang2024" / "mine.png").write_text("mine")
    words = ("-o", "out", "--viewpoints", "centre", "--algorithms", "wang2024")
    first = run_inim(scene.name, *words, folder=folder)
    assert first.code == EXIT_PASSED, first.stderr
    assert {"eia/wang2024.png", "views/wang2024/centre.png"} <= files_in(folder / "out")
    options = ("--viewpoints", "centre", "--algorithms", "template", "--quiet")
    limit = {"min_ssim_to_reference": "0.9999"}
    second = run_inim(scene.name, "-o", "out", *options, folder=folder, **limit)
    data = read_document(folder / "out" / "report.json")
    return Finished(second, folder / "out", data), folder


# --- What a report holds ------------------------------------------------------------------------


def test_every_file_of_the_report_exists_and_is_listed(finished):
    assert files_in(finished.out) == FILES == set(finished.data["files"])
    assert all((finished.out / name).stat().st_size > 0 for name in FILES)
    assert nothing_left(finished.out.parent.parent)


def test_report_has_the_results_of_its_algorithms_and_viewpoints(finished):
    data = finished.data
    assert data["schema"] == "inim.report/2"
    assert "preview" not in data
    assert list(data["algorithms"]) == ALGORITHMS
    assert [view["name"] for view in data["viewpoints"]] == VIEWS
    assert data["viewpoints"][1]["position_mm"][:2] == [3, -2]
    assert set(data["reference"]["views"]) == set(data["noise_floor"]["views"]) == set(VIEWS)
    for result in data["algorithms"].values():
        assert [result["views"][view].keys() for view in VIEWS] == [SCORES, SCORES]
        for view in VIEWS:
            for key, sure in result["precision"][view].items():
                low, high = sure["interval"]
                assert low < result["views"][view][key] < high
    parameters = data["display"]["parameters"]
    assert (parameters["lens_columns"], parameters["lens_rows"]) == (8, 6)
    assert data["settings"]["algorithms"] == "template,wang2024"
    assert data["verdict"]["passed"] is True
    assert {check["passed"] for check in data["verdict"]["checks"]} == {True}


@pytest.mark.parametrize("part", ["algorithms", "reference", "noise_floor", "timings", "rgbd"])
def test_all_numbers_are_finite(finished, part):
    numbers = dict(numbers_in(finished.data[part], part))
    assert numbers
    assert {k: v for k, v in numbers.items() if v is None or not math.isfinite(v)} == {}


def test_scores_computed_again_from_the_report_s_pictures_are_the_plain_ones(finished):
    from flip_evaluator import evaluate
    from skimage.metrics import structural_similarity

    arguments = finished.data["scoring"]["metrics"]["ssim"]["arguments"]
    border = finished.data["scoring"]["metrics"]["ssim"]["border_px"]
    for view in VIEWS:
        mask = Image.open(finished.out / "truth" / "relic" / f"{view}.png")
        region = np.asarray(mask)[..., 0] > 0
        region[:border] = region[-border:] = False
        region[:, :border] = region[:, -border:] = False
        for place, scores in (
            ("reference", finished.data["reference"]),
            ("template", finished.data["algorithms"]["template"]),
        ):
            pair = (
                srgb_from_linear(read_exr(finished.out / f"{name}.exr")).astype(np.float64)
                for name in (f"truth/{view}", f"views/{place}/{view}")
            )
            first, second = pair
            mean, local = structural_similarity(first, second, full=True, **arguments)
            sure = scores["precision"][view]
            codes = (values.astype(np.float32) for values in (first, second))
            error = evaluate(*codes, "LDR", True, False, False, {"ppd": 67.0})[0]
            assert sure["flip"]["plain"] == pytest.approx(error.mean(dtype=np.float64), abs=1e-6)
            assert sure["ssim"]["plain"] == pytest.approx(mean, abs=1e-6)
            assert sure["ssim_on_relic"]["plain"] == pytest.approx(local[region].mean(), abs=1e-6)


# --- What the terminal shows --------------------------------------------------------------------


# --- A second run into the same folder ----------------------------------------------------------


def test_second_run_replaces_its_own_files_and_keeps_others(replaced):
    """Its limit is not met: exit code 1 and a failed check; --quiet prints nothing even so."""
    second, folder = replaced
    assert (second.ended.code, second.ended.stdout, second.ended.stderr) == (1, "", "")
    failed = [check["name"] for check in second.data["verdict"]["checks"] if not check["passed"]]
    assert failed == ["template/centre: SSIM on the relic, to the reference"]
    others = {"notes.txt", "views/wang2024/mine.png"}
    assert files_in(second.out) == set(second.data["files"]) | others
    assert not any("wang2024" in name for name in second.data["files"])
    assert {(second.out / name).read_text() for name in others} == {"mine"}
    assert nothing_left(folder)


# --- Worlds that are not kind -------------------------------------------------------------------


NAN_LIGHT = '<emitter type="constant"><rgb name="radiance" value="nan nan nan"/></emitter>'


@pytest.mark.parametrize(
    ("text", "names"),
    [
        (
            f'<scene version="3.0.0">{sphere((0, 0, 0), 1)}</scene>',
            {"truth/eia: brightest value", "truth/centre: brightest value"},
        ),
        (scene_text(sphere((0, 0, 0), 1), NAN_LIGHT), {"truth/eia: pixels not finite"}),
    ],
    ids=["none", "nan"],
)
def test_scene_without_sound_light_fails_a_check(tmp_path, run_inim, text, names):
    alone = {"algorithms": "template", "viewpoints": "centre"}
    ended = run_inim(write_scene(tmp_path, text=text), "-o", "out", folder=tmp_path, **alone)
    assert ended.code == EXIT_CHECK_FAILED
    checks = read_document(tmp_path / "out" / "report.json")["verdict"]["checks"]
    assert names <= {check["name"] for check in checks if not check["passed"]}


def test_failed_run_has_ended_its_threads(tmp_path, run_inim, monkeypatch):
    """A thread that writes images after the end of its run would create their folder again."""

    def fail(*_: object, run: object) -> None:
        raise UsageError("after all images were submitted")

    monkeypatch.setattr(validate, "score_reference_views", fail)
    ended = run_inim(write_scene(tmp_path), "-o", "out", folder=tmp_path, **SMALLEST)
    assert ended.stderr.endswith("tiny.xml: after all images were submitted\n")
    assert not {"images_0", "ahead_0"} & {thread.name for thread in threading.enumerate()}
    assert [path.name for path in tmp_path.iterdir()] == ["tiny.xml"]


def test_bare_machine_is_enough(tmp_path, run_process):
    """One CPU, no home to write in, no stdin, a C locale, a display whose sizes do not divide, and
    nobody who reads stdout."""
    scene = write_scene(tmp_path, sphere((0, 0, 0), 1))
    bare = dict.fromkeys(("XDG_CACHE_HOME", "XDG_DATA_HOME", "TERM"))
    bare |= {"HOME": "/dev/null/nowhere"}
    bare |= {"LANG": "C", "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    prefix = ("sh", "-c", '"$@" <&- | true', "sh")
    if hasattr(os, "sched_getaffinity"):
        cpu = min(os.sched_getaffinity(0))
        prefix = ("sh", "-c", f'taskset -c {cpu} "$@" <&- | true', "sh")
    odd = {"lens_columns": "7", "lens_rows": "5", "pixel_pitch_mm": "0.0636", "gap_mm": "2.7"}
    alone = {"algorithms": "template", "viewpoints": "centre"}
    options = ("-o", "out", "--lens-model", "pinhole")
    ended = run_process(
        scene, *options, folder=tmp_path, variables=bare, prefix=prefix, **odd, **alone
    )
    assert ended.stderr == ""
    assert read_document(tmp_path / "out" / "report.json")["verdict"]["passed"] is True


# --- From Python, and without a run -------------------------------------------------------------
