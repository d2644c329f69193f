"""JUnit output: always well-formed, one case per check, and red whenever the run is."""

import xml.etree.ElementTree as ET
from typing import Any

import pytest

from inim.report.summary import render_junit
from tests.schemas import report_document


def check(name: str = "template/centre: SSIM to ceiling", **changes: Any) -> dict[str, Any]:
    usual = {"value": 0.97, "limit": 0.9, "relation": ">=", "passed": True, "detail": "why"}
    return {"name": name, **usual, **changes}


def suite(*checks: dict[str, Any], passed: bool = True) -> ET.Element:
    data = {"verdict": {"passed": passed, "checks": list(checks)}, "timings": {"total": 20.8}}
    return ET.fromstring(render_junit(report_document(data)).encode("utf-8"))


def test_one_case_per_check_in_a_suite_named_after_the_job():
    root = suite(check("a"), check("b"))
    assert root.tag == "testsuite"
    assert root.get("name") == "inim.validate"
    assert [case.get("name") for case in root.iter("testcase")] == ["a", "b"]
    assert (root.get("tests"), root.get("failures"), root.get("errors")) == ("2", "0", "0")
    assert root.get("time") == "20.800"
    assert root.find(".//failure") is None


def test_failure_says_what_was_found_and_what_was_asked():
    root = suite(check("a"), check("b", value=0.85, passed=False), passed=False)
    failure = root.find("testcase[@name='b']/failure")
    assert failure is not None
    assert failure.get("message") == "0.8500, required ≥ 0.9000. why"
    assert root.get("failures") == "1"
    assert root.find("testcase[@name='a']/failure") is None


def test_value_just_short_of_its_limit_is_not_printed_as_equal_to_it():
    root = suite(check("a", value=0.8999996, passed=False), passed=False)
    failure = root.find(".//failure")
    assert failure is not None
    assert failure.get("message") == "0.8999996, required ≥ 0.9000000. why"


@pytest.mark.parametrize(
    "name",
    [
        "<script>alert(1)</script>",
        "\"quoted\" & 'single'",
        "two\nlines\ttab",
        "双耳陶罐",
        "]]>",
        "",
    ],
)
def test_any_name_survives_unchanged(name):
    root = suite(check(name, passed=False, detail=name), passed=False)
    assert root[0].get("name") == name


@pytest.mark.parametrize("name", ["null \x00", "bell \x07", "lone \ud800", "\ufffe"])
def test_characters_xml_cannot_hold_are_replaced(name):
    root = suite(check(name, passed=False, detail=name), passed=False)
    assert "\ufffd" in root[0].get("name", "")


def test_failed_run_without_a_failed_check_is_still_red():
    root = suite(check("a"), passed=False)
    assert root.get("failures") == "1"
    assert root.find("testcase[@name='verdict']/failure") is not None
