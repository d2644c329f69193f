"""The verdict as JUnit XML, for the test tab of a continuous-integration service."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from typing import Any

from inim.report.wording import (
    check_passed,
    check_sentence,
    checks,
    is_number,
    part,
    plain,
    verdict,
)

__all__ = ["render_junit"]

_SUITE = "inim.validate"


def render_junit(data: Mapping[str, Any]) -> str:
    """One test suite, ``inim.validate``, with one test case per check.

    Parameters
    ----------
    data : mapping
        The contents of report.json, schema ``inim.report/1``.

    Returns
    -------
    str
        A well-formed XML document, whatever the names of the checks.
    """
    suite = ET.Element("testsuite")
    failures = sum(_add_case(suite, check) for check in checks(data))
    if verdict(data) == "failed" and not failures:
        # A run that failed must not show as green because no single check says why.
        _add_failure(_case(suite, "verdict"), "the run did not pass, and no check says why")
        failures = 1
    _describe(suite, data, failures)
    ET.indent(suite)
    body = ET.tostring(suite, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{body}\n'


def _describe(suite: ET.Element, data: Mapping[str, Any], failures: int) -> None:
    total = part(data, "timings").get("total")
    suite.set("name", _SUITE)
    suite.set("tests", str(len(suite)))
    suite.set("failures", str(failures))
    suite.set("errors", "0")
    suite.set("skipped", "0")
    suite.set("time", f"{total:.3f}" if is_number(total) else "0")
    if data.get("created"):
        suite.set("timestamp", plain(data["created"]))


def _case(suite: ET.Element, name: object) -> ET.Element:
    attributes = {"classname": _SUITE, "name": plain(name), "time": "0"}
    return ET.SubElement(suite, "testcase", attributes)


def _add_case(suite: ET.Element, check: Mapping[str, Any]) -> bool:
    """Add one check; whether it failed."""
    case = _case(suite, check.get("name", "unnamed check"))
    if check_passed(check):
        return False
    _add_failure(case, check_sentence(check))
    return True


def _add_failure(case: ET.Element, sentence: str) -> None:
    failure = ET.SubElement(case, "failure", {"type": "check", "message": plain(sentence)})
    failure.text = plain(f"{case.get('name')}: {sentence}")
