"""The bench of layers on a tiny scene: at equal samples, and what was captured and left out."""

from __future__ import annotations

import json

import pytest

from inim.errors import EXIT_PASSED, EXIT_USAGE
from tests.conftest import sphere
from tests.system.conftest import TINY, assert_one_line, definitions, write_scene
from tests.system.test_bench import run_bench
from tests.unit.test_depth_peeling import cube

NAMES = ["template", "layered:samples=1", "template:samples=4", "layered:samples=4"]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    plates = [cube((0, 0, z), (half, half, 0.4)) for z, half in ((0, 4), (1, 3.5))]
    closely = (*plates, sphere((0, 0, 6), 0.5))
    scenes = [
        write_scene(folder, name="a.xml").name, write_scene(folder, *closely, name="b.xml").name
    ]  # fmt: skip
    words = ["--layers", *scenes, "-o", "out", "--runs", "2", *definitions(TINY)]
    ended = run_bench(*words, folder=folder)
    assert ended.returncode == EXIT_PASSED, ended.stderr
    return folder, json.loads((folder / "out" / "bench.json").read_text("utf-8"))


def test_each_scene_compares_one_layer_with_all_at_equal_samples(finished):
    scenes = finished[1]["layers"]
    assert [found["title"] for found in scenes] == ["a", "b"]
    for found in scenes:
        assert [c["name"] for c in found["contenders"]] == NAMES
        floor = found["noise_floor"]["eia_psnr_db"]
        for c, base in zip(found["contenders"], [0, 0, 2, 2], strict=True):
            with_as_many = found["contenders"][base]["median_ms"]
            assert c["template_ratio"] == pytest.approx(c["median_ms"] / with_as_many)
            assert c["to_floor_db"] == pytest.approx(c["eia_psnr_db"] - floor)
            several = c["name"].endswith("4")
            assert (c["averaged_share"] is not None) == several
            assert not several or 0 < c["averaged_share"] < 1


def test_what_is_captured_is_told(finished):
    """In b a plate is closely behind another: but for its rim no ray gets there."""
    apart, closely = (found["captured_layers"] for found in finished[1]["layers"])
    for captured in (apart, closely):
        front, behind, *_ = captured["covered_shares"]
        assert front > behind > 0
    assert apart["hidden_share"] < 0.1 < closely["hidden_share"] < 1


def test_page_plot_and_command(finished):
    folder, data = finished
    assert {p.name for p in (folder / "out").iterdir()} == {
        "bench.html", "bench.json", "bench.md", "layers.png", "layers.svg",
    }  # fmt: skip
    assert "--layers a.xml b.xml" in data["command"]
    page = (folder / "out" / "bench.html").read_text("utf-8")
    assert "One layer and all, at equal samples" in page
    assert "What the capture found" in page


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--layers", "missing.xml"), ["missing.xml"]),
        (("--layers", "tiny.xml", "--algorithms", "gu2020"), ["--algorithms", "scene"]),
    ],
)
def test_mistakes_cost_one_line(tmp_path, words, says):
    write_scene(tmp_path)
    ended = run_bench(*words, folder=tmp_path)
    assert ended.returncode == EXIT_USAGE
    assert_one_line(ended.stderr, says)
