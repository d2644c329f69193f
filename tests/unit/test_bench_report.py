"""Files of a bench: the tables agree with the data, and the page needs no other file."""

import json
import re
from xml.etree import ElementTree

from inim.apps.bench.document import (
    BenchAlgorithm,
    BenchDocument,
    BenchRounds,
    BenchScene,
    Load,
    TimingRecord,
)
from inim.apps.bench.evaluate import bench_scores
from inim.apps.bench.page import bench_page, scene_parts, write_bench
from inim.display import DISPLAYS
from inim.scores.document_parts import BackendRecord, DisplayRecord, PictureShape

SCORED = ("eia_ssim", "eia_psnr_db", "view_ssim_to_reference")


def timing(ms, **more):
    return {
        "cold_s": 0.5, "median_ms": ms, "min_ms": 0.9 * ms, "spread": 0.01, "runs": 9,
        "slow": False, **more,
    }  # fmt: skip


def method(name, ms, wrong=0.0, psnr=30.0, view=0.9, **more):
    """Times and errors of an algorithm in one mapping, as in a study."""
    return {
        "name": name, "prepare_s": 0.1, **timing(ms), "mpx_per_s": 1 / ms, "ratio": ms / 2,
        "ratio_min": ms / 2, "wrong_source": wrong, "hole_fraction": 0.5, "eia_ssim": 0.8,
        "eia_psnr_db": psnr, "view_ssim_to_reference": view, **more,
    }  # fmt: skip


def algorithm(name, ms, wrong, scores, fronts=("wrong_source",)):
    return BenchAlgorithm(
        name=name, prepare_s=0.1, **timing(ms), mpx_per_s=1 / ms, ratio=ms / 2, ratio_min=ms / 2,
        wrong_source=wrong, hole_fraction=0.5, averaged_share=None, scores=scores,
        fronts=list(fronts), pareto=bool(fronts),
    )  # fmt: skip


def bench(scene=None, **study):
    return BenchDocument(
        title="Bench: <b>|", created="2024-01-01T00:00:00+00:00", inim_version="0",
        versions={"python": "3"}, command="inim bench x",
        backend=BackendRecord(variant="llvm", libllvm="22", device="cpu"), threads=2,
        threading_layer="default", rounds=BenchRounds(runs=9, warmups=2),
        load=Load(start=0.1, end=0.2, cores=2), warnings=[], notes=[], scene=scene, study=study,
        files=[],
    )  # fmt: skip


def scene_bench(scores=(), **values):
    """A scene with two algorithms; `scores` and their `values` are added to the usual ones."""
    usual = {"eia_ssim": 0.8, "eia_psnr_db": 30.0, "view_ssim_to_reference": 0.9}
    scene = BenchScene(
        path="x.xml",
        sha256="0" * 64,
        display=DisplayRecord.of(DISPLAYS["nominal"]),
        viewpoints=["centre"],
        picture=PictureShape(rows=4, columns=4, pixel_mm=0.2),
        yardstick=TimingRecord(**timing(2.0)),
        algorithms=[
            algorithm("template", 3.0, 0.0, usual | values),
            algorithm("mix|er:a=b", 40.0, None, usual | {"eia_psnr_db": None} | values, ()),
        ],
        noise_floor={"eia_ssim": 0.99, "eia_psnr_db": 50.0, "view_ssim_to_reference": 0.999},
        scores=[*(score for score in bench_scores() if score.key in SCORED), *scores],
        captured_layers=None,
    )
    return bench(scene)


def test_every_form_is_written_and_listed(tmp_path):
    write_bench(scene_bench(), tmp_path)
    document = json.loads((tmp_path / "bench.json").read_text("utf-8"))
    assert {p.name for p in tmp_path.iterdir()} == set(document["files"])
    assert document["schema"] == "inim.bench/2"
    for svg in tmp_path.glob("*.svg"):
        ElementTree.parse(svg)


def assert_tables_are_whole(data, parts):
    """Every row of every Markdown table has as many cells as the table's head."""
    expected = [len(t.heads) for part in parts for t in part.tables for _ in range(len(t.rows) + 2)]
    rows = [x for x in bench_page(data, parts).markdown(data).splitlines() if x.startswith("|")]
    assert expected
    assert [len(re.findall(r"(?<!\\)\|", row)) - 1 for row in rows] == expected


def test_markdown_tables_have_as_many_cells_in_every_row():
    data = scene_bench()
    assert_tables_are_whole(data, scene_parts(data))
