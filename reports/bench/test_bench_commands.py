"""The study of whole commands on a tiny scene: what each found, traced and scored.

Expected: reruns read what they can and say the same; what is changed is made anew. How long
anything takes is never checked.
"""

from __future__ import annotations

import copy
import os
import sys
from pathlib import Path

import pytest

from inim.system.document import read_document
from inim.system.errors import EXIT_PASSED
from reports.bench.commands.same_scores import EVERYTHING, SCORES, VIEWS, differences, samples_of
from reports.study import ROOT, StudyDocument
from tests.system.conftest import TINY, Ended, definitions, files_in, run_child, write_scene

SMALL = TINY | {"inim.lens_model": "thin", "inim.viewpoints": "centre,left"}
CASES = [
    "--help", "cold", "unchanged", "another folder", "one algorithm changed", "one viewpoint added",
    "one light changed", "nine viewpoints", "nine viewpoints, --lazy", "--no-skip", "first run",
    "--preview",
]  # fmt: skip


def run_study(name: str, *words: object, folder: Path, timeout: float = 120) -> Ended:
    """Run a study of ``reports/bench`` to its end in a folder."""
    paths = [str(ROOT), os.environ.get("PYTHONPATH", "")]
    variables = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    study = [sys.executable, "-m", f"reports.bench.{name}.run", *map(str, words)]
    return run_child(study, timeout, cwd=folder, env=variables)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    scene = write_scene(folder)
    words = [scene.name, "-o", "results", "--runs", "1", "--warmups", "1", *definitions(SMALL)]
    ended = run_study("commands", *words, folder=folder, timeout=1200)
    assert ended.code == EXIT_PASSED, ended.stderr
    return folder, read_document(folder / "results" / "bench.json", "", StudyDocument)


@pytest.fixture(scope="module")
def cases(finished):
    return {case["name"]: case for case in finished[1].results["commands"]["cases"]}


def test_every_case_is_timed_and_measured(cases):
    assert list(cases) == CASES
    for case in cases.values():
        beside = cases[case["beside"]]
        assert case["share"] == pytest.approx(case["median_s"] / beside["median_s"])
        assert len(case["times_s"]) == 1
    renderer, text = cases["cold"]["peak_bytes"], cases["--help"]["peak_bytes"]
    assert text < 64 * 2**20 < renderer, "a help text needs neither numpy nor the renderer"


def test_cached_results_are_not_traced_again(cases):
    cold = cases["cold"]
    assert 0 < cold["traced"] <= cold["whole"]
    cached = ("unchanged", "another folder", "one algorithm changed")
    assert [cases[name]["traced"] for name in cached] == [0, 0, 0]
    assert 0 < cases["one viewpoint added"]["traced"] < cold["traced"]
    assert cases["one light changed"]["traced"] == cold["traced"]
    assert cases["--no-skip"]["traced"] == cases["--no-skip"]["whole"] == cold["whole"]
    nine = [case["traced"] for name, case in cases.items() if name.startswith("nine")]
    assert nine[1] < nine[0]


def test_scores_are_compared_and_equal(cases):
    compared = {name: case["same"] for name, case in cases.items() if case["same"]}
    assert compared == {
        "unchanged": EVERYTHING,
        "another folder": EVERYTHING,
        "one algorithm changed": SCORES,
        "one viewpoint added": VIEWS,
        "nine viewpoints, --lazy": VIEWS,
        "--no-skip": EVERYTHING,
    }
    assert not [name for name in compared if cases[name]["unlike"]]


def test_viewpoints_observe_a_part_of_the_panel(finished):
    generation = finished[1].results["commands"]["generation"]
    assert len(generation["viewpoints"]) == 9
    shares = {c["name"]: c["observed_share"] for c in generation["algorithms"]}
    assert list(shares) == ["pinhole", "thin", "thick"]
    assert all(0 < share < 1 for share in shares.values())


def test_page_and_command(finished):
    folder, document = finished
    assert files_in(folder / "results") == {"bench.html", "bench.json", "bench.md"}
    assert document.command.startswith("python -m reports.bench.commands.run tiny.xml")
    page = (folder / "results" / "bench.html").read_text("utf-8")
    assert all(word in page for word in ("Whole commands on", "yes, all except times"))


REPORT = {
    "created": "today",
    "title": "t",
    "reference": {"views": {"centre": {"ssim": 0.5}}},
    "algorithms": {
        "a": {"seconds": 1.0, "eia": {"ssim": 0.25}, "views": {"centre": {"ssim": 0.75}}}
    },
}


@pytest.mark.parametrize(
    ("path", "found_in"),
    [
        (("created",), ()),
        (("algorithms", "a", "seconds"), ()),
        (("title",), (EVERYTHING,)),
        (("algorithms", "a", "eia", "ssim"), (EVERYTHING, SCORES)),
        (("algorithms", "a", "views", "centre", "ssim"), (EVERYTHING, SCORES, VIEWS)),
        (("reference", "views", "centre", "ssim"), (EVERYTHING, SCORES, VIEWS)),
    ],
)
def test_a_difference_is_found_where_it_counts(path, found_in):
    other = copy.deepcopy(REPORT)
    place = other
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = "another"
    for extent in (EVERYTHING, SCORES, VIEWS):
        assert differences(REPORT, REPORT, extent) == []
        assert differences(REPORT, other, extent) == (
            ["/".join(path)] if extent in found_in else []
        )


def test_reports_without_common_rows_are_not_equal():
    assert differences(REPORT, {"algorithms": {"b": {"eia": {"ssim": 1.0}}}}, SCORES)


def test_samples_are_counted_once_for_each_view_of_a_row():
    def row(work, count, skipped):
        return {"step": work, "performed": count, "skipped": skipped, "why": ""}

    cold = [
        row("ground-truth EIA", "1.5 million samples traced (not made before)", "40000 samples"),
        row("ground-truth view: a, b", "100 samples traced (not made before)", "20 samples"),
        row("view of template: a", "reconstructed", "nothing"),
    ]
    assert samples_of(cold, cold) == (1_500_200, 1_540_240)
    again = [
        row("ground-truth EIA", "read from the cache", "all of it"),
        row("ground-truth view: a, b", "read from the cache", "all of it"),
        row("ground-truth view: c", "90 samples traced (not made before)", "30 samples"),
    ]
    assert samples_of(again, cold) == (90, 1_540_360)
