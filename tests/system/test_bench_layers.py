"""The study of layers on a tiny scene: at equal samples, and what was captured and left out."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import pytest

from inim.errors import EXIT_PASSED, EXIT_USAGE
from tests.conftest import sphere
from tests.schemas import read_document
from tests.system.conftest import TINY, Ended, definitions, files_in, run_child, write_scene
from tests.unit.test_depth_peeling import cube

ROOT = Path(__file__).parents[2]


def run_study(name: str, *words: object, folder: Path, timeout: float = 120) -> Ended:
    """Run a study of ``reports/bench`` to its end in a folder."""
    paths = [str(ROOT), os.environ.get("PYTHONPATH", "")]
    variables = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    study = [sys.executable, "-m", f"reports.bench.{name}.run", *map(str, words)]
    return run_child(study, timeout, cwd=folder, env=variables)


def assert_study(folder: Path, data: dict[str, Any], plot: str, command: str, *words: str) -> None:
    """Assert that a study has its files and its command, and that its page has these words."""
    plots = {f"{plot}.png", f"{plot}.svg"}
    assert files_in(folder / "out") == {"bench.html", "bench.json", "bench.md"} | plots
    assert f"reports.bench.{command}" in data["command"]
    page = (folder / "out" / "bench.html").read_text("utf-8")
    assert all(word in page for word in words)


NAMES = ["template", "layered:samples=1", "template:samples=4", "layered:samples=4"]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    plates = [cube((0, 0, z), (half, half, 0.4)) for z, half in ((0, 4), (1, 3.5))]
    closely = (*plates, sphere((0, 0, 6), 0.5))
    scenes = [
        write_scene(folder, name="a.xml").name, write_scene(folder, *closely, name="b.xml").name
    ]  # fmt: skip
    words = [*scenes, "-o", "out", "--runs", "2", *definitions(TINY)]
    ended = run_study("layered", *words, folder=folder)
    assert ended.code == EXIT_PASSED, ended.stderr
    return folder, read_document(folder / "out" / "bench.json")


@pytest.mark.slow
def test_each_scene_compares_one_layer_with_all_at_equal_samples(finished):
    scenes = finished[1]["study"]["layers"]
    assert [scene["title"] for scene in scenes] == ["a", "b"]
    for scene in scenes:
        assert [c["name"] for c in scene["algorithms"]] == NAMES
        floor = scene["noise_floor"]["eia_psnr_db"]
        for c, base in zip(scene["algorithms"], [0, 0, 2, 2], strict=True):
            with_as_many = scene["algorithms"][base]["median_ms"]
            assert c["template_ratio"] == pytest.approx(c["median_ms"] / with_as_many)
            assert c["to_floor_db"] == pytest.approx(c["eia_psnr_db"] - floor)
            copies = c["name"] == "layered:samples=1"  # the others average, as `smooth` does
            assert (c["averaged_share"] is None) == copies
            assert copies or 0 < c["averaged_share"] < 1


@pytest.mark.slow
def test_shares_of_the_captured_layers(finished):
    """Scene b has a plate closely behind another: but for its rim no ray gets there."""
    apart, closely = (entry["captured_layers"] for entry in finished[1]["study"]["layers"])
    for captured in (apart, closely):
        front, behind, *_ = captured["covered_shares"]
        assert front > behind > 0
    assert apart["hidden_share"] < 0.1 < closely["hidden_share"] < 1


@pytest.mark.slow
def test_page_plot_and_command(finished):
    words = ("One layer and all layers, with equal samples", "Captured surfaces")
    assert_study(*finished, "layers", "layered.run a.xml b.xml", *words)


@pytest.mark.slow
def test_a_missing_scene_costs_one_line(tmp_path):
    ended = run_study("layered", "missing.xml", folder=tmp_path)
    assert ended.code == EXIT_USAGE
    assert ended.stderr.count("\n") == 1
    assert "missing.xml" in ended.stderr
    assert not list(tmp_path.iterdir())
