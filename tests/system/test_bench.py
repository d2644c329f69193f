"""A whole bench of a tiny scene, from the command line.

Expected: every method is timed and evaluated in kernel times, files appear whole or not at all,
unequal conditions are warned of, and mistakes are reported before rendering. The tests never check
durations.
"""

import shutil
import sys
from pathlib import Path

import pytest

from inim.apps.bench import evaluate
from inim.apps.bench.memory import peak_memory
from inim.apps.bench.run import BenchRequest
from inim.pipeline.request import Request
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

ALGORITHMS = [
    "template:samples=1:colour=nearest", "wang2024:matching=ray", "gu2020", "template", "example",
    "own_place", "half",
]  # fmt: skip
#: Each measurement of memory takes a process of its own.
MEASURED = ("template", "example")
FILES = {"bench.json", "bench.csv", "bench.md", "bench.html", "time.svg", "time.png"}

#: Other packages' algorithms: one that returns a picture of its own, and one that traces half of
#: its samples in display-ready pictures, which are timed.
OTHERS = """
import numpy as np
import inim_example
from inim.generators import parse_algorithm, prepare

class OwnPlace:
    def __init__(self, made): self.made = made
    def generate(self, rgbd, out=None): return self.made.generate(rgbd)

class Half:
    def __init__(self, *made): self.made = made
    def generate(self, rgbd, out=None):
        return self.made[rgbd.color.dtype == np.uint8].generate(rgbd, out)

def own_place(display, shape, pixel_mm):
    return OwnPlace(inim_example.prepare(display, shape, pixel_mm))

def half(display, shape, pixel_mm):
    names = ("template:samples=4", "template:samples=2")
    return Half(*(prepare(display, n, shape=shape, pixel_mm=pixel_mm) for n in names))
"""
POINTS = """[inim.generators]
example = inim_example:prepare
own_place = bench_others:own_place
half = bench_others:half
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
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            evaluate, "peak_memory", lambda n, *job: peak_memory(n, *job) if n in MEASURED else None
        )
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


def rows_of(finished):
    (scene,) = finished[2]["scenes"]
    return {row["name"]: row for row in scene["algorithms"]}


def test_data_are_complete(finished):
    data = finished[2]
    assert data["schema"] == "inim.bench/3"
    assert (data["threads"], data["runs"], data["warmups"]) == (1, 3, 2)
    keys = [error["key"] for error in data["errors"]]
    assert list(rows_of(finished)) == ALGORITHMS
    for method in rows_of(finished).values():
        assert len(method["times_ms"]) == method["runs"] == 3
        assert method["min_ms"] <= method["median_ms"]
        assert method["errors"].keys() >= set(keys[1:])
        for estimate in (method["time_ms"], method["kernel_times"], *method["errors"].values()):
            low, high = estimate["interval"]
            assert (low or -1) <= estimate["value"] <= (high or 1e9)


def test_exact_sources_are_never_wrong_and_others_sometimes(finished):
    rows = rows_of(finished)
    wrong = {
        n: row["errors"]["wrong_source"]
        for n, row in rows.items()
        if "wrong_source" in row["errors"]
    }
    assert list(wrong) == ALGORITHMS[:4]
    for name, estimate in wrong.items():
        assert (estimate["value"] == 0) == name.startswith("template")
        assert 0 < estimate["interval"][1] < 1  # of a sample


def test_memory_is_that_of_the_algorithm_alone(finished):
    """The EIA of 8 x 6 lenses has 55 kB; imports and kernels take more than 100 MB."""
    for name, row in rows_of(finished).items():
        assert (row["memory_bytes"] is not None) == (name in MEASURED and sys.platform == "linux")
        assert (row["memory_bytes"] or 0) < 10 * 2**20


def test_unequal_conditions_are_warned_of(finished):
    """Three of the four that state it trace one ray per pixel, with the nearest colour."""
    rows, warnings = rows_of(finished), finished[2]["scenes"][0]["warnings"]
    assert [name for name, row in rows.items() if row["is_equal"]] == ALGORITHMS[:3]
    (unequal,) = [text for text in warnings if text.startswith("unequal: ")]
    assert "template (4 rays, smooth)" in unequal and "example (rays not stated)" in unequal
    (other_work,) = [text for text in warnings if "other work" in text]
    assert other_work.startswith("half: ")


def test_another_package_s_algorithm_is_scored_wherever_it_writes(finished):
    rows = rows_of(finished)
    assert rows["example"]["errors"] == rows["own_place"]["errors"]
    assert rows["example"]["eia"]["ssim"] > 0.1  # a picture, not the black it started from


def test_scenes_and_sizes_are_multiplied(tmp_path):
    sizes = ("lens_columns=3,inim.lens_rows=3", "lattice=hexagonal")
    scenes = [write_scene(tmp_path), tmp_path / "other.xml"]
    shutil.copy(*scenes)
    validations = [Request(scene, tmp_path, definitions=TINY) for scene in scenes]
    plans = BenchRequest(tuple(validations), sizes).plans()
    assert [(plan.file.path, size) for size, plan in plans] == [
        (scene, size) for scene in scenes for size in sizes
    ]
    assert [plan.display.lens_columns for _, plan in plans] == [3, 8] * 2
    assert [plan.display.lattice for _, plan in plans] == ["square", "hexagonal"] * 2


def test_without_an_oracle_wrong_sources_are_unknown_and_said_to_be(tmp_path, monkeypatch):
    """Hexagonal lenses form no columns, which the oracle needs."""
    monkeypatch.setattr(evaluate, "peak_memory", lambda *_: None)
    write_scene(tmp_path)
    ended = run_bench(
        "tiny.xml", "-o", "out", "--algorithms", "gu2020", "--runs", "2", "--size",
        "lattice=hexagonal", *definitions(TINY), folder=tmp_path,
    )  # fmt: skip
    assert ended.code == EXIT_PASSED, ended.stderr
    (scene,) = read_document(tmp_path / "out" / "bench.json")["scenes"]
    (row,) = scene["algorithms"]
    assert "wrong_source" not in row["errors"] and row["memory_bytes"] is None
    assert (scene["size"], scene["checked_pixels"]) == ("lattice=hexagonal", 0)
    assert any("not counted" in text for text in scene["warnings"])


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((), ["SCENE"]),
        (("tiny.xml", "--scaling"), ["--scaling"]),
        (("tiny.xml", "--runs", "0"), ["--runs 0"]),
        (("tiny.xml", "--threads", "0"), ["--threads 0"]),
        (("missing.xml",), ["missing.xml"]),
        (("tiny.xml", "--algorithms", "nonesuch"), ["nonesuch"]),
        (("tiny.xml", "--algorithms", "pickup"), ["pickup", "needs the scene"]),
        (("tiny.xml", "--size", "lens_columns"), ["--size 'lens_columns'"]),
        (("tiny.xml", "--size", "lens_column=3"), ["lens_column"]),
        (("tiny.xml", "--algorithms", ","), ["none given"]),
    ],
)
def test_mistakes_cost_one_line_and_no_folder(tmp_path, words, says):
    write_scene(tmp_path)
    assert_refused("bench", *words, folder=tmp_path, says=says)
