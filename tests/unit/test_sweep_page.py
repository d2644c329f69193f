"""The page of a sweep: means, rankings and the plot against hand-made tables."""

import re

import pytest

from inim.apps.sweep.document import SweepDocument
from inim.apps.sweep.page import (
    depth_front,
    rank_displays,
    results_of,
    sweep_page,
    write_page,
)
from inim.apps.sweep.table import DEPTH, DEPTH_SHARE
from inim.report.plots import on_front
from tests.schemas import read_document


def row(scene="jade", display="wide", algorithm="template", viewpoint="centre", **values):
    parameters = {
        "status": "ok", "error": None, "ssim": 0.5, "ssim_to_reference": 0.8,
        "ssim_on_relic": 0.5, "ssim_on_relic_to_reference": 0.75, "reference_ssim_on_relic": 0.7,
        "noise_floor_ssim_on_relic": 0.99, "psnr_db": 30.0, "flip": 0.1, "seconds": 1.0,
        "yardsticks": None, "unit_seconds": 9.0, "passed": True, "failed_checks": None,
        "lens_model": "thick",
    }  # fmt: skip
    names = {"scene": scene, "display": display, "algorithm": algorithm, "viewpoint": viewpoint}
    return names | parameters | values


def test_a_result_is_the_mean_over_its_viewpoints():
    rows = [row(ssim=0.4), row(viewpoint="left", ssim=0.8), row(algorithm="gu2020", ssim=0.1)]
    first, second = results_of(rows)
    assert first.scores["ssim"] == pytest.approx(0.6)
    assert second.scores["ssim"] == pytest.approx(0.1)
    assert not first.failed


def test_the_front_is_the_undominated_set():
    points = {"fast": (1, 9), "good": (9, 1), "both": (2, 2), "beaten": (3, 3), "tied": (1, 10)}
    assert on_front(points) == {"fast", "good", "both"}
    assert on_front({"one": (1, 1), "same": (1, 1)}) == {"one", "same"}


def table_of(rows, name):
    """Cells of a table of the page, row by row, under its heads."""
    (part,) = [part for part in sweep_page(about(rows), rows).parts if part.name == name]
    (table,) = part.tables
    return [dict(zip(table.heads, cells, strict=True)) for cells in table.rows]


def about(rows, **values):
    values = {"passed": all(row["passed"] for row in rows), "failed": {}} | values
    return SweepDocument(
        title="T <b>&",
        command="inim sweep s.toml",
        created="2026",
        inim_version="1",
        validations=len(rows),
        computed=0,
        rows=len(rows),
        **values,
    )


def test_displays_are_ranked_for_each_relic_by_their_best_algorithm():
    rows = [
        row(display="wide", ssim_on_relic=0.7), row(display="fine", ssim_on_relic=0.7),
        # The best is the best to the reference, whatever else.
        row(
            display="wide", algorithm="gu2020", ssim_on_relic=0.6, ssim_on_relic_to_reference=0.8
        ),
        row(display="fine", algorithm="gu2020", ssim_on_relic=0.9, ssim_on_relic_to_reference=0.6),
        row("tripod", "wide", ssim_on_relic=0.9), row("tripod", "fine", ssim_on_relic=0.8),
        row("tripod", "bad", status="failed", error="why", ssim_on_relic=None),
    ]  # fmt: skip
    heads = ("Relic", "Display", "Best algorithm on it", "SSIM on the relic to ground truth")
    assert [tuple(cells[h] for h in heads) for cells in table_of(rows, "displays")] == [
        ("jade", "fine", "template", "0.7000"),
        ("jade", "wide", "gu2020", "0.6000"),
        ("tripod", "wide", "template", "0.9000"),
        ("tripod", "fine", "template", "0.8000"),
    ]  # what failed is not ranked


def test_scores_have_a_row_for_each_algorithm_and_times_in_kernel_times_if_all_have_them():
    timed = row(yardsticks=2.0, ssim_on_relic_to_reference=0.4321)
    (cells,) = table_of([timed], "scores")
    assert cells["SSIM on the relic to reference"] == "0.4321"
    assert cells["Kernel times"] == "2.000"
    first, other = table_of([timed, row(algorithm="gu2020", seconds=3.0)], "scores")
    assert (first["Seconds"], other["Seconds"]) == ("1.000", "3.000")


def test_the_page_needs_no_other_file_and_shows_both_tables(tmp_path):
    rows = [row(scene="<i>jade", ssim_on_relic_to_reference=0.4321), row("tripod")]
    write_page(about(rows), rows, tmp_path)
    page = (tmp_path / "sweep.html").read_text("utf-8")
    assert not re.search(r"(src|href)=\"(?!#|data:)", page)
    assert "&lt;i&gt;jade" in page
    assert "<i>jade" not in page
    assert "T &lt;b&gt;&amp;" in page
    assert page.count("0.4321") == 1
    assert "inim sweep s.toml" in page
    assert page.count("<table") == 3  # one of them of versions
    assert read_document(tmp_path / "sweep.json")["files"] == [
        "sweep.html", "sweep.json", "sweep.md",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([row()], "ran clean; no criteria set"),
        ([row(min_ssim_to_reference=0.7)], "Verdict: passed."),
        ([row(min_ssim_to_reference=0.7, passed=False)], "Verdict: failed."),
    ],
)
def test_verdict_is_passed_only_with_a_criterion(rows, words):
    assert words in sweep_page(about(rows), rows).remarks[0]


def test_displays_of_unequal_depth_are_compared_with_a_notice_and_a_front(tmp_path):
    depths = {"deep": (38.8, 0.68), "middle": (14.8, 0.60), "flat": (4.2, 0.94)}
    rows = [
        row(display=name, **{DEPTH: depth, DEPTH_SHARE: depth / 50}, ssim_on_relic=score)
        for name, (depth, score) in depths.items()
    ]
    points, front = depth_front(rank_displays(results_of(rows))["jade"])
    assert points == depths
    assert front == {"deep", "flat"}
    (notice,) = sweep_page(about(rows), rows).warnings
    assert "different depths, 4.2\xa0mm to 38.8\xa0mm" in notice
    write_page(about(rows), rows, tmp_path)
    drawing = (tmp_path / "depth.svg").read_text("utf-8")
    assert ">deep<" in drawing and ">flat<" in drawing and ">middle<" not in drawing
    equal = [row | {DEPTH: 10.0} for row in rows]
    page = sweep_page(about(equal), equal)
    assert not page.warnings
    assert all(part.figure is None for part in page.parts)


def test_failures_are_warnings_with_their_reasons():
    rows = [row(), row("tripod", status="failed", error="no <such> lens", passed=None)]
    rows.append(row("coin", passed=False, failed_checks="template: 0 shown"))
    assert sweep_page(about(rows), rows).warnings == [
        "tripod · wide: no <such> lens",
        "coin · wide · template: template: 0 shown",
    ]


def test_a_study_of_failures_has_a_page(tmp_path):
    rows = [row(status="failed", error="why", ssim=None, ssim_to_reference=None, passed=None)]
    write_page(about(rows), rows, tmp_path)
    page = (tmp_path / "sweep.html").read_text("utf-8")
    assert "why" in page
    assert "Best display" not in page
