"""The page of a sweep: means, fronts and rankings against hand-made tables."""

import base64
import re
from itertools import product

import pytest

from inim.apps.sweep.document import SweepTable
from inim.apps.sweep.page import (
    best_displays,
    render_sweep,
    results_of,
    write_page,
)
from inim.report.plots import on_front

ABOUT = SweepTable(title="T <b>&", command="inim sweep s.toml", created="2026", inim_version="1")


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
    cells = re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", best_displays(results_of(rows)))
    texts = [re.sub("<[^>]*>", "", cell) for cell in cells]
    assert texts[:9] == [
        "Relic", "Display", "Best algorithm on it", "SSIM on the relic to ground truth",
        "Its reference", "Depth, mm", "Share of its own depth", "PSNR", "FLIP",
    ]  # fmt: skip
    table = [tuple(texts[i : i + 4]) for i in range(9, len(texts), 9)]
    assert table == [
        ("jade", "fine", "template", "0.7000"),
        ("", "wide", "gu2020", "0.6000"),
        ("tripod", "wide", "template", "0.9000"),
        ("", "fine", "template", "0.8000"),
    ]
    assert len(texts) == 45  # what failed is not ranked


def test_the_page_needs_no_other_file_and_shows_the_table(tmp_path):
    rows = [row(scene="<i>jade", ssim_on_relic_to_reference=0.4321), row("tripod")]
    write_page(tmp_path / "page.html", rows, ABOUT)
    page = (tmp_path / "page.html").read_text("utf-8")
    assert not re.search(r"(src|href)=\"(?!#|data:)", page)
    assert "&lt;i&gt;jade" in page
    assert "<i>jade" not in page
    assert "T &lt;b&gt;&amp;" in page
    assert "0.4321" in page
    assert "inim sweep s.toml" in page
    assert "Failures" not in page
    assert "Ran clean" in page
    assert "no criteria set" in page
    assert "Scores by two parameters" not in page


def test_verdict_is_passed_only_with_a_criterion():
    page = render_sweep([row(min_ssim_to_reference=0.7), row("tripod")], ABOUT)
    assert "Passed" in page
    assert "no criteria set" not in page


def test_displays_of_unequal_depth_are_compared_with_a_notice_and_a_front():
    depths = {"deep": (38.8, 0.68), "middle": (14.8, 0.60), "flat": (4.2, 0.94)}
    rows = [
        row(display=name, relic_depth_mm=depth, relic_depth_share=depth / 50, ssim_on_relic=score)
        for name, (depth, score) in depths.items()
    ]
    page = best_displays(results_of(rows))
    assert "different depths, 4.2\xa0mm to 38.8\xa0mm" in page
    assert set(re.findall(r"<b>(\w+)</b>", page)) == {"deep", "flat"}
    assert "Score against depth" in page
    equal = [row | {"relic_depth_mm": 10.0} for row in rows]
    assert "different depths" not in best_displays(results_of(equal))


def test_each_lens_model_has_its_own_map():
    """Values of words are not on an axis: two maps of 2 x 2, not one with two scores in a cell."""
    rows = [
        row(pitch_mm=pitch, gap_mm=gap, lens_model=model, ssim_on_relic=score)
        for model, score in (("thin", 0.4), ("thick", 0.6))
        for pitch, gap in product((0.5, 1.0), (3.3, 3.4))
    ]
    page = render_sweep(rows, ABOUT)
    sources = re.findall(r'base64,([^"]*)" alt="Scores by two parameters"', page)
    (drawing,) = (base64.b64decode(source).decode() for source in sources)
    assert (drawing.count(">0.400<"), drawing.count(">0.600<")) == (4, 4)
    for title in ("lens_model = thick", "lens_model = thin"):
        assert drawing.count(title) >= 1


def test_failures_come_first_with_their_reasons():
    rows = [row(), row("tripod", status="failed", error="no <such> lens", passed=None)]
    rows.append(row("coin", passed=False, failed_checks="template: 0 shown"))
    page = render_sweep(rows, ABOUT)
    assert page.index("Failures") < page.index("Time against error")
    assert "no &lt;such&gt; lens" in page
    assert "template: 0 shown" in page
    assert "Failed" in page
