"""Files of a bench: the tables agree with the data, and the page needs no other file."""

import csv
import io
import json
import re
from xml.etree import ElementTree

from inim.apps.bench.document import (
    BenchAlgorithm,
    BenchDocument,
    BenchScene,
    Estimate,
    TimingRecord,
)
from inim.apps.bench.evaluate import bench_errors
from inim.apps.bench.front import WRONG_SOURCE
from inim.apps.bench.page import FILES, bench_csv, bench_page, scene_lines, write_bench
from inim.display import DISPLAYS
from inim.scores.document_parts import BackendRecord, DisplayRecord, PictureShape
from inim.scores.metrics import HEADLINE


def timing(ms, **more):
    return {
        "cold_s": 0.5, "median_ms": ms, "min_ms": 0.9 * ms, "spread": 0.01, "runs": 9,
        "slow": False, "times_ms": [ms] * 9, **more,
    }  # fmt: skip


def method(name, ms, wrong=0.0, psnr=30.0, view=0.9, **more):
    """Times and errors of an algorithm in one mapping, as in a study."""
    return {
        "name": name, "prepare_s": 0.1, **timing(ms), "mpx_per_s": 1 / ms, "ratio": ms / 2,
        "ratio_min": ms / 2, "wrong_source": wrong, "hole_fraction": 0.5, "eia_ssim": 0.8,
        "eia_psnr_db": psnr, "view_ssim_to_reference": view, **more,
    }  # fmt: skip


def estimate(value, width):
    return Estimate(value=value, interval=(value - width, value + width))


def algorithm(name, ms, errors, fronts=(HEADLINE,), is_equal=True):
    return BenchAlgorithm(
        name=name, terms="1 ray, nearest", is_equal=is_equal, prepare_s=0.1, **timing(ms),
        time_ms=estimate(ms, 0.1 * ms), kernel_times=estimate(ms / 2, 0.01), memory_bytes=2**20,
        hole_fraction=0.5, eia={"ssim": 0.8, "psnr_db": None}, errors=errors, fronts=list(fronts),
    )  # fmt: skip


def scene(name="x", size=""):
    """A scene with two algorithms."""
    wrong = Estimate(value=0.0, interval=(0.0, 0.002))
    return BenchScene(
        path=f"{name}.xml", sha256="0" * 64, name=f"{name} {size}", size=size,
        display=DisplayRecord.of(DISPLAYS["nominal"]), viewpoints=["centre"],
        picture=PictureShape(rows=4, columns=4, pixel_mm=0.2), samples={"eia_spp": 8},
        checked_pixels=2000, yardstick=TimingRecord(**timing(2.0)),
        algorithms=[
            algorithm("template", 3.0, {WRONG_SOURCE: wrong, HEADLINE: estimate(0.9, 0.01)}),
            algorithm("mix|er:a=b", 40.0, {HEADLINE: estimate(0.8, 0.01)}, (), False),
        ],
        others=0.01, warnings=["unequal: mix|er:a=b"],
    )  # fmt: skip


def bench(*scenes):
    return BenchDocument(
        title="Bench: <b>|", created="2024-01-01T00:00:00+00:00", inim_version="0",
        versions={"python": "3"}, command="inim bench x", cores=2,
        backend=BackendRecord(variant="llvm", libllvm="22", device="cpu"), threads=2,
        threading_layer="default", runs=9, warmups=2, errors=bench_errors(),
        scenes=list(scenes), files=[],
    )  # fmt: skip


def test_every_form_is_written_and_listed(tmp_path):
    write_bench(bench(scene(), scene(size="lens_columns=8")), tmp_path)
    document = json.loads((tmp_path / "bench.json").read_text("utf-8"))
    assert {p.name for p in tmp_path.iterdir()} == set(document["files"]) == set(FILES)
    assert document["schema"] == "inim.bench/3"
    for svg in tmp_path.glob("*.svg"):
        ElementTree.parse(svg)


def test_markdown_tables_have_as_many_cells_in_every_row_and_mark_what_is_unequal():
    data = bench(scene(), scene("y"))
    text = bench_page(data).markdown(data)
    rows = [re.findall(r"(?<!\\)\|", line) for line in text.splitlines() if line.startswith("|")]
    assert len(rows) == 2 * 5 and len({len(cells) for cells in rows}) == 1
    assert text.count("1 ray, nearest ≠ |") == 2 and "⚠ x : unequal: mix" in text
    assert "| 0.9000 ± 0.0100 * |" in text and "| 0.8000 ± 0.0100 |" in text
    assert "| 3.00 ± 0.30 |" in text and "| 0.00 [0.00, 0.20] |" in text


def test_csv_has_a_line_for_each_scene_size_and_algorithm():
    rows = list(csv.DictReader(io.StringIO(bench_csv(bench(scene(), scene(size="a=1,b=2"))))))
    assert [(row["size"], row["algorithm"]) for row in rows] == [
        ("", "template"), ("", "mix|er:a=b"), ("a=1,b=2", "template"), ("a=1,b=2", "mix|er:a=b"),
    ]  # fmt: skip
    first = rows[0]
    values = [float(first[f"{HEADLINE}{end}"]) for end in ("_low", "", "_high")]
    assert values == [0.89, 0.9, 0.91] and first[f"on_front_{HEADLINE}"] == "True"
    assert rows[1][WRONG_SOURCE] == "" and rows[1]["is_equal"] == "False"


def test_lines_of_the_terminal_have_intervals_fronts_and_warnings():
    name, heads, first, *_, warning = scene_lines(bench_errors(), scene())
    assert (name.strip(), heads.split()[0]) == ("x", "algorithm")
    assert "3.00 ± 0.30" in first and "0.9000 ± 0.0100 *" in first
    assert warning == "warning: x : unequal: mix|er:a=b"
