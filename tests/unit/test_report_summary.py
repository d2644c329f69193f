"""The Markdown summary: short, honest about gaps, and safe to paste into a comment."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from inim.report import Report
from inim.report.summary import render_summary
from inim.report.wording import (
    best_algorithm,
    check_passed,
    check_value,
    number,
    score,
    suggested_criteria,
    verdict,
    verdict_words,
)

HOSTILE = "<script>alert(1)</script> | `x` *b* [a](b)\n# 双耳陶罐 \x00"


def report(**changes: Any) -> dict[str, Any]:
    views = {
        name: {
            "ssim": whole, "ssim_to_ceiling": whole + 0.1,
            "ssim_on_relic": whole - 0.1, "ssim_on_relic_to_ceiling": kept,
        }
        for name, whole, kept in (("centre", 0.86, 0.9731), ("left", 0.84, 0.9612))
    }  # fmt: skip
    eia = {"ssim": 0.9712, "hole_fraction": 0.0142}
    return {
        "title": "Painted amphora",
        "inim_version": "0.1.0",
        "viewpoints": [{"name": "centre"}, {"name": "left"}],
        "noise_floor": {"eia": {"ssim": 0.9931}, "views": {"centre": {"ssim": 0.9962}}},
        "ceiling": {"views": {"centre": {"ssim": 0.881}, "left": {"ssim": 0.875}}},
        "algorithms": {"template": {"seconds": 0.42, "eia": eia, "views": views}},
        "verdict": {"passed": True, "checks": [check()]},
        "warnings": [],
        **changes,
    }


def check(**changes: Any) -> dict[str, Any]:
    usual = {"name": "SSIM", "value": 0.97, "limit": 0.9, "relation": ">=", "passed": True}
    usual["criterion"] = True
    return {**usual, **changes}


def rows(summary: str) -> dict[str, list[str]]:
    lines = [line for line in summary.splitlines() if line.startswith("| ")]
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]
    return {row[0]: row[1:] for row in cells}


def test_summary_has_the_verdict_and_a_row_for_each_reference():
    summary = render_summary(report())
    assert "✅ **Passed**: 1 of 1 checks passed." in summary
    table = rows(summary)
    assert table["template"] == [
        "0.9731 (0.7600); 0.9600 (0.8600)",
        "0.9612 (0.7400); 0.9400 (0.8400)",
        "0.9712",
        "1.42\u00a0%",
        "0.42",
    ]
    assert table["*ceiling*"][:2] == ["(–); (0.8810)", "(–); (0.8750)"]
    assert table["*noise floor*"] == ["(–); (0.9962)", "(–); (–)", "0.9931", "–", "–"]


def test_failed_checks_are_listed_with_what_was_asked():
    data = report(verdict={"passed": False, "checks": [check(value=0.85, passed=False)]})
    summary = render_summary(data)
    assert "❌ **Failed**: 0 of 1 checks passed." in summary
    assert "* SSIM: 0.8500, required ≥ 0.9000" in summary


def test_hostile_names_neither_format_nor_break_the_table():
    data = report(title=HOSTILE, viewpoints=[{"name": HOSTILE}], algorithms={HOSTILE: {}})
    data["verdict"] = {"passed": False, "checks": [check(name=HOSTILE, value=None)]}
    summary = render_summary(data)
    assert "<script>" not in summary
    assert "\x00" not in summary
    assert "双耳陶罐" in summary
    assert "\\`x\\` \\*b\\* \\[a\\]\\(b\\)" in summary
    bars = {
        line.replace("\\|", "").count("|") for line in summary.splitlines() if line.startswith("| ")
    }
    assert len(bars) == 1


def test_summary_of_a_huge_report_stays_small():
    many = [check(name="x" * 10_000, detail="y" * 10_000, value=0.1, passed=False)] * 500
    data = report(verdict={"passed": False, "checks": many}, warnings=["w" * 100_000] * 50)
    summary = render_summary(data)
    assert len(summary.encode()) < 32_000
    assert "and 480 more" in summary
    assert "50 warnings" in summary


@pytest.mark.parametrize("data", [{}, {"verdict": None, "viewpoints": None, "algorithms": [1]}])
def test_damaged_report_is_summed_up_as_failed(data):
    assert "**Failed**" in render_summary(data)


@pytest.mark.parametrize(
    ("value", "shown"),
    [(0.97314, "0.9731"), (-0.5, "−0.5000"), (None, "–"), (math.nan, "–"), (math.inf, "∞"),
     (-math.inf, "−∞"), (True, "–"), ("0.9", "–"), (1, "1.0000")],
)  # fmt: skip
def test_numbers_have_fixed_digits_and_gaps_are_dashes(value, shown):
    assert number(value, 4) == shown


def test_null_psnr_is_infinite_but_an_absent_one_and_a_null_ssim_are_not():
    assert score({"psnr_db": None}, "psnr_db") == "∞"
    assert score({"psnr_to_ceiling_db": None}, "psnr_to_ceiling_db") == "∞"
    assert score({}, "psnr_db") == "–"
    assert score({"psnr_db": math.nan}, "psnr_db") == "–"
    assert score({"ssim": None}, "ssim") == "–"
    assert score({"psnr_db": 31.256}, "psnr_db") == "31.26"


def test_check_counts_as_passed_only_when_said_so_about_two_numbers():
    assert check_passed(check())
    assert check_passed(check(name="PSNR", value=None))
    assert not check_passed(check(passed=None))
    assert not check_passed(check(passed=1))
    assert not check_passed(check(value=None))
    assert not check_passed(check(value=math.nan))
    assert not check_passed(check(limit=None))


def test_small_limit_is_not_printed_as_zero():
    tiny = check(value=0.201025, limit=1e-6)
    assert check_value(tiny, "limit") == "0.000001"
    assert check_value(tiny) == "0.2010"
    assert check_value(check(value=0.0), "value") == "0.0000"
    assert check_value(check(value=1e-300), "value") == "0.000000000000"


def test_limit_of_a_psnr_check_is_never_infinite():
    assert check_value(check(name="PSNR", limit=None), "limit") == "–"


def test_verdict_fails_with_any_check_that_does_not_count():
    assert verdict(report()) == "passed"
    checks = [check(), check(value=None)]
    assert verdict(report(verdict={"passed": True, "checks": checks})) == "failed"
    assert verdict(report(verdict={"passed": True, "checks": []})) == "no verdict"
    assert verdict(report(verdict={"passed": False, "checks": []})) == "failed"


def test_run_without_criteria_ran_clean_and_suggests_some():
    own = check()
    del own["criterion"]
    data = report(verdict={"passed": True, "checks": [own]})
    assert verdict_words(data) == "ran clean; no criteria set"
    assert Report(Path(), data).passed
    assert suggested_criteria(data) == "template:0.95"  # 0.9612 less 0.005, rounded down
    assert "min_ssim_to_ceiling=template:0.95" in render_summary(data)
    assert "min_ssim_to_ceiling" not in render_summary(report())
    noisy = {"centre": {"ssim_on_relic_to_ceiling": {"plain": 0.9, "interval": [0.9, 1.0]}}}
    data["algorithms"]["template"]["precision"] = noisy
    assert suggested_criteria(data) == "template:0.90"
    assert suggested_criteria(report(viewpoints=[{"name": "nowhere"}])) == ""


def test_comparison_with_a_baseline_is_a_criterion():
    data = report(verdict={"passed": True, "checks": [check(kind="score")]})
    del data["verdict"]["checks"][0]["criterion"]
    assert verdict(data) == "passed"


def test_best_algorithm_has_the_highest_mean_over_all_viewpoints():
    def run(*values: float | None) -> dict[str, Any]:
        names = ("centre", "left")
        views = {n: {"ssim_on_relic_to_ceiling": v} for n, v in zip(names, values, strict=True)}
        return {"views": views}

    algorithms = {"a": run(0.9, 0.8), "b": run(0.89, 0.9), "c": run(0.99, None), "d": {}}
    assert best_algorithm(report(algorithms=algorithms)) == "b"
    assert best_algorithm(report(algorithms={})) is None
    assert best_algorithm(report(algorithms={"d": {}})) is None


def test_a_report_prints_as_a_small_table() -> None:
    data = report()
    data["ceiling"] = {"views": {"centre": {"ssim_on_relic": 0.891}, "left": {}}}
    printed = str(Report(Path("out/amphora"), data))
    assert printed.splitlines() == [
        "Painted amphora: passed",
        "SSIM on the relic to the ceiling, in brackets to the scene",
        "                   centre             left",
        "template  0.9731 (0.7600)  0.9612 (0.7400)",
        "ceiling          (0.8910)              (–)",
    ]
    assert repr(Report(Path("out/amphora"), data)) == "Report('out/amphora': passed)"


def test_what_is_missing_prints_too() -> None:
    assert "\x00" not in str(Report(Path(), report(title=HOSTILE)))
    assert str(Report(Path(), {})).startswith("Untitled: failed")
