"""A whole bench of a tiny scene, from the command line.

Expected: every method is timed and evaluated in kernel times, files appear whole or not at all, and
mistakes are reported before rendering. The tests never check durations.
"""

import math
import shutil
from pathlib import Path

import pytest

from inim.apps.bench.evaluate import choose_algorithms
from inim.system.errors import EXIT_PASSED
from tests.schemas import read_document
from tests.system.conftest import (
    TINY,
    Ended,
    assert_refused,
    definitions,
    files_in,
    install_metadata,
    nothing_left,
    run_here,
    without_pauses,
    write_scene,
)

ALGORITHMS = ["template", "wang2024:matching=ray", "gu2020", "example", "own_place"]
FILES = {"bench.json", "bench.md", "bench.html", "pareto.svg", "pareto.png"}

#: Other packages' algorithms: one that returns a picture of its own, one that cannot be timed.
OTHERS = """
import inim_example

class OwnPlace:
    def __init__(self, made): self.made = made
    def generate(self, rgbd, out=None): return self.made.generate(rgbd)

class LinearOnly:
    def generate(self, rgbd, out=None): raise ValueError("needs float32")

def own_place(display, shape, pixel_mm):
    return OwnPlace(inim_example.prepare(display, shape, pixel_mm))

def linear_only(display, shape, pixel_mm):
    return LinearOnly()
"""
POINTS = """[inim.generators]
example = inim_example:prepare
own_place = bench_others:own_place
linear_only = bench_others:linear_only
"""


def run_bench(*words: object, folder: Path, site: Path | None = None) -> Ended:
    """`inim bench` in this process, without the pauses that make times comparable."""
    variables = {"PYTHONPATH": str(site or "")}
    with without_pauses():
        return run_here("bench", *map(str, words), folder=folder, variables=variables)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder in which the algorithms of other packages are installed."""
    folder = tmp_path_factory.mktemp("site")
    install_metadata(folder, "bench_others", POINTS)
    (folder / "bench_others.py").write_text(OTHERS)
    shutil.copy(Path(__file__).parents[1] / "example_package" / "inim_example.py", folder)
    return folder


@pytest.fixture(scope="module")
def finished(tmp_path_factory, site):
    """One bench, other packages' algorithms included, into a folder with a stranger's file."""
    folder = tmp_path_factory.mktemp("bench 鼎")
    scene = write_scene(folder)
    (folder / "out").mkdir()
    (folder / "out" / "notes.txt").write_text("mine")
    ended = run_bench(
        scene.name, "-o", "out", "--algorithms", ",".join(ALGORITHMS), "--runs", "3",
        "--threads", "1", *definitions(TINY), folder=folder, site=site,
    )  # fmt: skip
    assert ended.code == EXIT_PASSED, ended.stderr
    return ended, folder, read_document(folder / "out" / "bench.json")


def test_every_file_is_there_and_the_stranger_s_too(finished):
    _, folder, data = finished
    assert files_in(folder / "out") == FILES | {"notes.txt"}
    assert set(data["files"]) == FILES
    assert nothing_left(folder)


def test_data_are_complete(finished):
    data = finished[2]
    assert data["schema"] == "inim.bench/2"
    assert (data["threads"], data["rounds"]) == (1, {"runs": 3, "warmups": 2})
    assert [c["name"] for c in data["scene"]["algorithms"]] == ALGORITHMS
    for method in data["scene"]["algorithms"]:
        values = [*method.values(), *method["scores"].values()]
        numbers = [v for v in values if isinstance(v, float)]
        assert all(map(math.isfinite, numbers)), method
        assert method["runs"] == 3
        assert method["min_ms"] <= method["median_ms"]


def test_exact_sources_are_never_wrong_and_others_sometimes(finished):
    wrong = {c["name"]: c["wrong_source"] for c in finished[2]["scene"]["algorithms"]}
    assert wrong["template"] == 0
    shares = {name: share for name, share in wrong.items() if share is not None}
    assert shares.keys() == set(ALGORITHMS[:3])
    assert all(0 < share < 1 for name, share in shares.items() if name != "template")


def test_another_package_s_algorithm_is_scored_wherever_it_writes(finished):
    rows = {m["name"]: m for m in finished[2]["scene"]["algorithms"]}
    keys = [score["key"] for score in finished[2]["scene"]["scores"]]
    assert [rows["example"]["scores"][k] for k in keys] == [
        rows["own_place"]["scores"][k] for k in keys
    ]
    assert rows["example"]["scores"]["eia_ssim"] > 0.1  # a picture, not the black it started from
    assert rows["example"]["hole_fraction"] < 1


def test_all_algorithms_take_part_unless_some_are_named(monkeypatch, site):
    monkeypatch.syspath_prepend(str(site))
    names, notes = choose_algorithms(None)
    assert names[0] == "template"
    assert {"example", "own_place"} <= set(names)
    assert "linear_only" not in names
    assert [n for n in notes if "linear_only" in n and "needs float32" in n]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((), ["scene"]),
        (("tiny.xml", "--scaling"), ["--scaling"]),
        (("tiny.xml", "--runs", "0"), ["--runs 0"]),
        (("tiny.xml", "--threads", "0"), ["--threads 0"]),
        (("missing.xml",), ["missing.xml"]),
        (("tiny.xml", "--algorithms", "nonesuch"), ["nonesuch"]),
        (("tiny.xml", "--algorithms", ","), ["none given"]),
    ],
)
def test_mistakes_cost_one_line_and_no_folder(tmp_path, words, says):
    write_scene(tmp_path)
    assert_refused("bench", *words, folder=tmp_path, says=says)
