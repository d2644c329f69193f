"""The summary and JUnit output of a report: honest about gaps, and well-formed whatever the names.

Expected: a short summary, safe to paste into a comment; a JUnit case for each check, and red
whenever the run is.
"""

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest

from inim.report import Report
from inim.report.document import ReportDocument
from inim.report.images import ENCODINGS, ReportImages
from inim.report.labels import (
    suggested_criteria,
    verdict_words,
)
from inim.report.sections.overview import scores_section
from inim.report.summary import (
    markdown_text,
    render_junit,
    render_summary,
    render_table,
    render_text,
)
from tests.schemas import report_document

HOSTILE = "<script>alert(1)</script> | `x` *b* [a](b)\n# 双耳陶罐 \x00"


def report(**changes: Any) -> ReportDocument:
    return report_document(report_data(**changes))


def report_data(**changes: Any) -> dict[str, Any]:
    views = {
        name: {
            "ssim": whole, "ssim_to_reference": whole + 0.1,
            "ssim_on_relic": whole - 0.1, "ssim_on_relic_to_reference": fraction,
        }
        for name, whole, fraction in (("centre", 0.86, 0.9731), ("left", 0.84, 0.9612))
    }  # fmt: skip
    eia = {"ssim": 0.9712, "hole_fraction": 0.6}
    return {
        "title": "Painted amphora",
        "inim_version": "0.1.0",
        "viewpoints": [{"name": "centre"}, {"name": "left"}],
        "noise_floor": {"eia": {"ssim": 0.9931}, "views": {"centre": {"ssim": 0.9962}}},
        "reference": {"views": {"centre": {"ssim": 0.881}, "left": {"ssim": 0.875}}},
        "algorithms": {
            "template": {"seconds": 0.42, "unlit_fraction": 0.0142, "eia": eia, "views": views}
        },
        "verdict": {"passed": True, "checks": [check()]},
        "warnings": [],
        **changes,
    }


def check(**changes: Any) -> dict[str, Any]:
    usual = {"name": "SSIM", "value": 0.97, "limit": 0.9, "relation": ">=", "passed": True}
    usual |= {"detail": "", "criterion": True}
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
    assert table["*reference*"][:2] == ["(–); (0.8810)", "(–); (0.8750)"]
    assert table["*noise floor*"] == ["(–); (0.9962)", "(–); (–)", "0.9931", "–", "–"]
    assert "The table of scores in report.html also has the other metrics, such as PSNR" in summary


def test_summary_of_a_picture_has_the_columns_of_its_page():
    template = report_data()["algorithms"]["template"] | {"wrong_source": 0.0125}
    data = report(scene=None, picture={}, algorithms={"template": template})
    table = rows(render_summary(data))
    assert table["algorithm"] == ["centre", "left", "wrong source", "holes", "seconds"]
    assert table["template"][2:] == ["1.25\u00a0%", "60.00\u00a0%", "0.42"]
    page = scores_section(data, ReportImages(Path(), ENCODINGS[0]))
    heads = re.findall("([A-Z][a-z ]+)</abbr>", page)
    assert heads == [head.capitalize() for head in table["algorithm"][2:]]


def test_unequal_rays_are_named_below_every_table_of_scores():
    def forms(**terms: str) -> list[str]:
        views = report_data()["algorithms"]["template"]
        data = report(algorithms={name: views | {"terms": t} for name, t in terms.items()})
        page = scores_section(data, ReportImages(Path(), ENCODINGS[0]))
        return [page, render_text(data), render_table(data, ""), render_summary(data)]

    smooth, nearest = "4 rays, smooth", "1 ray, nearest"
    line = f"unequal: template ({smooth}); all others have {nearest}"
    *plain, summary = forms(gu2020=nearest, template=smooth, wang2024=nearest, mine="")
    assert all(line in text for text in plain)
    assert markdown_text(line) in summary
    assert "unequal" not in "".join(forms(gu2020=nearest, wang2024=nearest, mine=""))


def test_hostile_names_neither_format_nor_break_the_table():
    name = "".join(c for c in HOSTILE if c.isprintable() and c != "/")  # names files
    data = report_data(title=HOSTILE, viewpoints=[{"name": name}], algorithms={name: {}})
    del data["reference"], data["noise_floor"]
    checks = [check(name=HOSTILE, value=None, passed=False)]
    data["verdict"] = {"passed": False, "checks": checks}
    summary = render_summary(report_document(data))
    assert "<script>" not in summary
    assert "\x00" not in summary
    assert "双耳陶罐" in summary
    assert "\\`x\\` \\*b\\* \\[a\\]\\(b\\)" in summary
    bars = {
        line.replace("\\|", "").count("|") for line in summary.splitlines() if line.startswith("| ")
    }
    assert len(bars) == 1


def test_verdict_fails_with_any_check_that_failed():
    assert report().verdict.word == "passed"
    with pytest.raises(ValueError, match="one of the checks failed"):
        report(verdict={"passed": True, "checks": [check(), check(passed=False)]})
    assert report(verdict={"passed": True, "checks": []}).verdict.word == "no verdict"
    assert report(verdict={"passed": False, "checks": []}).verdict.word == "failed"


def test_run_without_criteria_ran_clean_and_suggests_some():
    clean = {"passed": True, "checks": [check(criterion=False)]}
    data = report(verdict=clean)
    assert verdict_words(data) == "ran clean; no criteria set"
    assert Report(Path(), data).passed
    assert suggested_criteria(data) == "template:0.95"  # 0.9612 less 0.005, rounded down
    assert "min_ssim_to_reference=template:0.95" in render_summary(data)
    assert "min_ssim_to_reference" not in render_summary(report())
    noisy = {"centre": {"ssim_on_relic_to_reference": {"plain": 0.9, "interval": [0.9, 1.0]}}}
    noisy_data = report_data(verdict=clean)
    noisy_data["algorithms"]["template"]["precision"] = noisy
    assert suggested_criteria(report_document(noisy_data)) == "template:0.90"
    assert suggested_criteria(report(algorithms={"template": {}})) == ""


def test_comparison_with_a_baseline_is_a_criterion():
    compared = [check(kind="score", criterion=False)]
    assert report(verdict={"passed": True, "checks": compared}).verdict.word == "passed"


def test_the_command_that_accepts_names_the_folder_of_the_report():
    data = report(regression={"verdict": "worse", "inputs": []})
    assert "To accept: `inim accept 'my out' --reason TEXT`" in render_summary(data, Path("my out"))


# -- JUnit -----------------------------------------------------------------------------------------


def suite(*checks: dict[str, Any], passed: bool = True) -> ET.Element:
    data = {"verdict": {"passed": passed, "checks": list(checks)}, "timings": {"total": 20.8}}
    return ET.fromstring(render_junit(report_document(data)).encode("utf-8"))


def test_one_case_per_check_in_a_suite_named_after_the_job():
    root = suite(check(name="a"), check(name="b"))
    assert root.tag == "testsuite"
    assert root.get("name") == "inim.validate"
    names = [case.get("name") for case in root.iter("testcase")]
    assert names == ["a", "b", "start"]
    assert (root.get("tests"), root.get("failures"), root.get("errors")) == ("3", "0", "0")
    assert root.get("time") == "20.800"
    assert root.find(".//failure") is None


@pytest.mark.parametrize(("value", "digits"), [(0.85, 4), (0.8999996, 7)])
def test_a_failure_states_value_and_limit(value, digits):
    """A value just short of its limit is not printed as equal to it."""
    root = suite(
        check(name="a"), check(name="b", value=value, passed=False, detail="why"), passed=False
    )
    failure = root.find("testcase[@name='b']/failure")
    assert failure is not None
    message = f"{value:.{digits}f}, required ≥ {0.9:.{digits}f}. why"
    assert failure.get("message") == message
    assert root.get("failures") == "1"
    assert root.find("testcase[@name='a']/failure") is None


@pytest.mark.parametrize(
    "name",
    ["<script>alert(1)</script>", "\"quoted\" & 'single'", "two\nlines\ttab", "双耳陶罐", "]]>", "",
     "null \x00", "bell \x07", "lone \ud800", "\ufffe"],
)  # fmt: skip
def test_any_name_survives_but_for_characters_that_xml_cannot_hold(name):
    root = suite(check(name=name, passed=False, detail=name), passed=False)
    printable = name.translate(dict.fromkeys([0, 7, 0xD800, 0xFFFE], "\ufffd"))
    assert root[0].get("name") == printable


def test_failed_run_without_a_failed_check_is_still_red():
    root = suite(check(name="a"), passed=False)
    assert root.get("failures") == "1"
    assert root.find("testcase[@name='verdict']/failure") is not None
