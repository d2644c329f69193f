"""A whole bench of a tiny scene, from the command line.

Expected: every contender timed and judged, everything in yardsticks, files that appear whole or not
at all, mistakes found before anything is rendered. How long anything takes is never checked.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

from inim.bench.paper import Sizes, bench_paper
from inim.bench.scaling import bench_scaling
from inim.errors import EXIT_PASSED, EXIT_USAGE
from inim.observer import Observer
from inim.pipeline.timing import Rounds
from inim.report.bench import write_bench
from tests.system.conftest import TINY, assert_one_line, definitions, nothing_left, write_scene

ALGORITHMS = ["template", "wang2024:matching=ray", "gu2020:implementation=python"]
FILES = {"bench.json", "bench.md", "bench.html", "pareto.svg", "pareto.png"}
KEYS = {
    "schema", "scene", "display", "backend", "threads", "load", "versions", "command", "yardstick",
    "contenders", "noise_floor", "scaling", "paper", "rounds", "warnings", "notes", "files",
}  # fmt: skip
CONTENDER = {
    "name", "prepare_s", "cold_s", "median_ms", "min_ms", "spread", "runs", "mpx_per_s", "ratio",
    "ratio_min", "wrong_source", "hole_fraction", "eia_ssim", "eia_psnr_db", "view_ssim_to_ceiling",
    "pareto",
}  # fmt: skip


def run_bench(*words: object, folder: Path, timeout: float = 120):
    return subprocess.run(
        [sys.executable, "-m", "inim.bench", *map(str, words)],
        cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, encoding="utf-8",
        timeout=timeout,
    )  # fmt: skip


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """One bench of three contenders, into a folder with a stranger's file."""
    folder = tmp_path_factory.mktemp("bench 鼎")
    scene = write_scene(folder)
    (folder / "out").mkdir()
    (folder / "out" / "notes.txt").write_text("mine")
    ended = run_bench(
        scene.name, "-o", "out", "--algorithms", ",".join(ALGORITHMS), "--runs", "3",
        "--threads", "1", *definitions(TINY), folder=folder,
    )  # fmt: skip
    assert ended.returncode == EXIT_PASSED, ended.stderr
    return ended, folder, json.loads((folder / "out" / "bench.json").read_text("utf-8"))


def test_every_file_is_there_and_the_stranger_s_too(finished):
    _, folder, data = finished
    names = {p.name for p in (folder / "out").iterdir()}
    assert names == FILES | {"notes.txt"}
    assert set(data["files"]) == FILES
    assert nothing_left(folder)


def test_data_are_complete(finished):
    data = finished[2]
    assert data["schema"] == "inim.bench/1"
    assert data.keys() >= KEYS
    assert (data["threads"], data["rounds"]) == (1, {"runs": 3, "warmups": 2})
    assert data["yardstick"].keys() >= {"median_ms", "min_ms"}
    assert [c["name"] for c in data["contenders"]] == ALGORITHMS
    for contender in data["contenders"]:
        assert contender.keys() >= CONTENDER
        numbers = [v for v in contender.values() if isinstance(v, float)]
        assert all(map(math.isfinite, numbers)), contender
        assert contender["runs"] == 3
        assert contender["min_ms"] <= contender["median_ms"]


def test_times_and_ratios_agree(finished):
    data = finished[2]
    pixels = data["display"]["derived"]["eia_rows"] * data["display"]["derived"]["eia_columns"]
    for c in data["contenders"]:
        assert c["ratio"] == pytest.approx(c["median_ms"] / data["yardstick"]["median_ms"])
        assert c["ratio_min"] == pytest.approx(c["min_ms"] / data["yardstick"]["min_ms"])
        assert c["mpx_per_s"] == pytest.approx(pixels / 1e3 / c["median_ms"])


def test_exact_sources_are_never_wrong_and_others_sometimes(finished):
    wrong = {c["name"]: c["wrong_source"] for c in finished[2]["contenders"]}
    assert wrong["template"] == 0
    assert all(0 < share < 1 for name, share in wrong.items() if name != "template")


def test_a_line_for_each_contender_and_where_the_page_lies(finished):
    lines = finished[0].stdout.splitlines()
    assert [line.split()[0] for line in lines[:-1]] == ALGORITHMS
    assert lines[-1] == f"bench: {Path('out') / 'bench.html'}"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((), ["--scaling"]),
        (("--scaling", "--display", "phone"), ["--display", "scene"]),
        (("--paper", "--runs", "0"), ["--runs 0"]),
        (("--paper", "--threads", "0"), ["--threads 0"]),
        (("missing.xml",), ["missing.xml"]),
        (("tiny.xml", "--algorithms", "nonesuch"), ["nonesuch"]),
        (("tiny.xml", "--algorithms", ","), ["none given"]),
    ],
)
def test_mistakes_cost_one_line_and_no_folder(tmp_path, words, says):
    write_scene(tmp_path)
    ended = run_bench(*words, folder=tmp_path)
    assert ended.returncode == EXIT_USAGE
    assert_one_line(ended.stderr, says)
    assert [p.name for p in tmp_path.iterdir()] == ["tiny.xml"]


def test_scaling_and_paper_at_small_sizes(tmp_path, renderer):
    rounds, listener = Rounds(runs=2, warmups=1), Observer()
    scaling = bench_scaling(rounds, listener, (1, 4), (1, 3), 2)
    sizes = Sizes(2, (1, 2), (3, 5), (1, 2), 3, 2)
    paper = bench_paper(rounds, listener, sizes)
    assert [p["display_pixels"] for p in scaling["display"]] == [17**2, 68**2]
    assert len({p["display_pixels"] for p in scaling["scene"]}) == 1
    memory = scaling["memory"]
    assert memory["imported_bytes"] + memory["eia_bytes"] < memory["peak_bytes"]
    assert [p["lenses"] for p in paper["experiments"][2]["points"]] == [1, 4]
    assert [p["elemental_pixels"] for p in paper["experiments"][1]["points"]] == [9, 25]
    forms = {c["name"]: c for c in paper["same_input"]["contenders"]}
    for name in ("li2012", "gu2020", "wang2024"):
        # Compiled or not, it is the same algorithm.
        python, compiled = forms[f"{name}:implementation=python"], forms[name]
        same = ("wrong_source", "eia_psnr_db", "middle_view_ssim")
        assert [python[k] for k in same] == [compiled[k] for k in same]
    data = {"title": "t", "schema": "s", "scaling": scaling, "paper": paper}
    write_bench(data, tmp_path)
    assert {p.stem for p in tmp_path.glob("*.svg")} == {"scaling", "paper"}
