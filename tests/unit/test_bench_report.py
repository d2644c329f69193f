"""What a bench writes: the tables say what the data say, and the page needs nothing else."""

from __future__ import annotations

import json
import re
from xml.etree import ElementTree

import pytest

from inim.bench.paper_claims import claims
from inim.report.bench import SCHEMA, write_bench
from inim.report.bench.cells import milliseconds, times
from inim.report.bench.tables import render_markdown, tables_of


def timing(ms, **more):
    return {
        "cold_s": 0.5, "median_ms": ms, "min_ms": 0.9 * ms, "spread": 0.01, "runs": 9,
        "slow": False, **more,
    }  # fmt: skip


def contender(name, ms, wrong=0.0, psnr=30.0, view=0.9, **more):
    return {
        "name": name, "prepare_s": 0.1, **timing(ms), "mpx_per_s": 1 / ms, "ratio": ms / 2,
        "ratio_min": ms / 2, "wrong_source": wrong, "hole_fraction": 0.5, "eia_ssim": 0.8,
        "eia_psnr_db": psnr, "view_ssim_to_ceiling": view, "fronts": ["wrong_source"],
        "pareto": True, **more,
    }  # fmt: skip


def bench(**more):
    return {
        "schema": SCHEMA, "title": "Bench: <b>|", "created": "2024-01-01T00:00:00+00:00",
        "inim_version": "0", "versions": {"python": "3"}, "command": "python -m inim.bench x",
        "backend": {"device": "cpu"}, "threads": 2, "rounds": {"runs": 9, "warmups": 2},
        "load": {"start": 0.1, "end": 0.2, "cores": 2}, "warnings": [], "notes": [],
        "contenders": [], "scaling": None, "paper": None, **more,
    }  # fmt: skip


def scene_bench():
    contenders = [
        contender("template", 3.0),
        contender("mix|er:a=b", 40.0, wrong=None, psnr=None, fronts=[], pareto=False),
    ]
    floor = {"eia_ssim": 0.99, "eia_psnr_db": 50.0, "view_ssim_to_ceiling": 0.999}
    return bench(contenders=contenders, yardstick=timing(2.0), noise_floor=floor)


def paper_bench():
    def point(size):
        names = ["gu2020:implementation=python", "wang2024:implementation=python", "template"]
        ms = dict(zip(names, (6000.0, 3000.0, 1.5), strict=True))
        found = [contender(n, size * v) for n, v in ms.items()]
        sizes = {"scene_pixels": 100 * size, "lenses": size, "elemental_pixels": 289}
        return {**sizes, "yardstick": timing(1.0), "contenders": found}

    experiments = [
        {
            "name": size,
            "figure": "Fig. 12",
            "kept": "x",
            "size": size,
            "points": [point(1), point(4)],
        }
        for size in ("scene_pixels", "lenses")
    ]
    last = [{**c, "middle_view_ssim": 0.5, "published_ssim": None} for c in point(1)["contenders"]]
    last[1] |= {"wrong_source": 0.4, "eia_psnr_db": 20.0}
    same = {
        "lenses": 4, "display_pixels": 100, "scene_pixels": 50, "ceiling_ssim": 0.9,
        "yardstick": timing(1.0), "contenders": last,
    }  # fmt: skip
    found = claims(experiments, same)
    return bench(
        paper={"experiments": experiments, "same_input": same, "claims": found, "notes": []}
    )


@pytest.mark.parametrize("data", [scene_bench(), paper_bench()], ids=["scene", "paper"])
def test_every_form_is_written_and_listed(tmp_path, data):
    write_bench(data, tmp_path)
    read = json.loads((tmp_path / "bench.json").read_text("utf-8"))
    assert {p.name for p in tmp_path.iterdir()} == set(read["files"])
    assert read["schema"] == "inim.bench/1"
    for svg in tmp_path.glob("*.svg"):
        ElementTree.parse(svg)


def test_equal_data_make_equal_files(tmp_path):
    folders = [tmp_path / "a", tmp_path / "b"]
    for folder in folders:
        folder.mkdir()
        write_bench(scene_bench(), folder)
    for file in folders[0].iterdir():
        assert file.read_bytes() == (folders[1] / file.name).read_bytes(), file.name


def test_the_page_needs_nothing_else_and_escapes(tmp_path):
    write_bench(scene_bench(), tmp_path)
    page = (tmp_path / "bench.html").read_text("utf-8")
    assert "<script" not in page
    assert not re.findall(r'(?:src|href)="(?!#|data:)', page)
    assert "<b>|" not in page
    assert "&lt;b&gt;|" in page
    assert page.count("data:image/svg+xml;base64,") == 1


def test_markdown_tables_have_as_many_cells_in_every_row():
    for data in (scene_bench(), paper_bench()):
        rows = [x for x in render_markdown(data).splitlines() if x.startswith("|")]
        counts, heads = [], []
        for row in rows:
            cells = len(re.findall(r"(?<!\\)\|", row))
            counts.append(cells)
            heads.append(cells if "--" not in row else counts[-2])
        assert counts
        for table in tables_of(data):
            assert {len(row) for row in table.rows} == {len(table.heads)}, table.caption


def test_ratios_in_the_paper_s_tables_are_those_of_the_medians():
    table = tables_of(paper_bench())[0]
    first = dict(zip(table.heads, table.rows[0], strict=True))
    assert first["gu2020 / wang2024, Python"] == times(6000 / 3000) == "2.00 ×"
    assert first["wang2024, Python / template"] == times(3000 / 1.5) == "2000 ×"
    assert first["gu2020 / wang2024"] == "–"  # compiled forms took no part
    assert first["template"] == milliseconds(1.5) == "1.50"


def test_claims_follow_the_measured_times():
    paper = paper_bench()["paper"]
    twice, growth, _, thousand = _by_words(paper["claims"])
    assert twice["holds"] is False  # exactly twice is not more than twice
    assert twice["why"]
    assert growth["holds"] is False  # both grow alike
    assert thousand["holds"] is True
    assert thousand["why"] == ""
    same = paper["same_input"]
    same["contenders"][0]["median_ms"] *= 1.01
    same["contenders"][2]["median_ms"] *= 2.01
    twice, _, _, thousand = _by_words(claims(paper["experiments"], same))
    assert twice["holds"] is True
    assert thousand["holds"] is False


def _by_words(found):
    words = ("twice as fast as gu2020", "grows slowly", "middle view", "1000 times")
    return [next((c for c in found if word in c["claim"]), None) for word in words]


def test_without_a_rival_its_claim_is_left_out():
    paper = paper_bench()["paper"]
    assert not [c for c in paper["claims"] if "li2012" in c["claim"].split(",")[0]]
