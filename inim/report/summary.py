"""A report for continuous integration: short Markdown for a comment box, and JUnit XML."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from typing import Any

from inim.metrics.headline import HEADLINE, HEADLINE_TO_SCENE, MAIN
from inim.report.wording import (
    MISSING,
    PREVIEW_WORDS,
    best_algorithm,
    check_passed,
    check_sentence,
    check_value,
    checks,
    full_command,
    is_number,
    items,
    number,
    part,
    plain,
    relation,
    score,
    suggested_criteria,
    verdict,
    verdict_words,
    viewpoint_names,
)

_SUITE = "inim.validate"

# Long names and long lists stay in report.json: a summary is read in a comment box.
_LONGEST_NAME = 80
_LONGEST_SENTENCE = 300
_MOST_FAILURES = 20


def render_summary(data: Mapping[str, Any]) -> str:
    """The report in a few lines of Markdown: verdict, scores, what they are measured against.

    Parameters
    ----------
    data : mapping
        The contents of report.json, schema ``inim.report/1``.
    """
    blocks = [
        f"## {markdown_text(data.get('title', 'Untitled'))}: {verdict_words(data)}",
        _verdict_line(data),
        *_preview(data),
        _scores_table(data),
        "SSIM on the relic to the ceiling, in brackets to the scene; then both of the whole "
        "picture, all free of noise but the EIA's and the noise floor. The ceiling is what perfect "
        "elemental images would show.",
        *_criteria(data),
        *_regression(data),
        *_failures(data),
        *_warnings(data),
    ]
    return "\n\n".join(blocks) + "\n"


def render_text(data: Mapping[str, Any]) -> str:
    """The headline scores as a table of plain text, for a terminal.

    Parameters
    ----------
    data : mapping
        The contents of report.json, schema ``inim.report/1``.
    """
    names = viewpoint_names(data)
    rows = [["", *names]]
    for name, run in part(data, "algorithms").items():
        views = [part(run, "views", view) for view in names]
        rows.append(
            [name, *(f"{score(v, HEADLINE)} ({score(v, HEADLINE_TO_SCENE)})" for v in views)]
        )
    views = [part(data, "ceiling", "views", view) for view in names]
    rows.append(["ceiling", *(f"({score(v, HEADLINE_TO_SCENE)})" for v in views)])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join(cell.ljust(w) if i == 0 else cell.rjust(w) for i, (cell, w) in enumerate(cells))
        for cells in (zip(row, widths, strict=True) for row in rows)
    ]
    head = f"{data.get('title', 'Untitled')}: {verdict_words(data)}"
    of = f"{MAIN.label} on the relic to the ceiling, in brackets to the scene"
    return plain("\n".join([head, of, *(line.rstrip() for line in lines)]))


def render_checks(data: Mapping[str, Any]) -> str:
    """A comparison of two runs in a few lines of Markdown.

    Parameters
    ----------
    data : mapping
        The contents of compare.json, schema ``inim.compare/1``.
    """
    passed = sum(map(check_passed, checks(data)))
    head = f"## {markdown_text(data.get('title', 'Untitled'))}: {verdict(data)}"
    line = f"{_sign(data)} {passed} of {len(checks(data))} comparisons passed."
    return "\n\n".join([head, line, *_regression(data), *_failures(data)]) + "\n"


def _criteria(data: Mapping[str, Any]) -> list[str]:
    """What to ask of later runs, where nothing was asked of this one."""
    wanted = suggested_criteria(data) if verdict(data) == "ran clean" else ""
    return [f"To set criteria: `-D 'inim.min_ssim_to_ceiling={wanted}'`."] if wanted else []


_KINDS = {
    "picture": "pictures, tile by tile",
    "noise": "noise of the ground truth",
    "score": "scores",
    "pixels": "EIAs of the reference input",
    "time": "times in yardsticks",
}


def _regression(data: Mapping[str, Any]) -> list[str]:
    """Against the baseline: for each kind of comparison, how many, and the one nearest to failing.

    So drift shows, also where all is well.
    """
    found = part(data, "regression")
    if not found:
        return []
    title = f"**Against {markdown_text(found.get('baseline', MISSING))}**"
    if found.get("reason"):
        title += f" ({markdown_text(found['reason'], _LONGEST_SENTENCE)})"
    heads = ["comparison", "changed", "nearest to its limit", "value", "limit"]
    rows = []
    for kind, label in _KINDS.items():
        of_kind = [check for check in checks(data) if check.get("kind") == kind]
        if of_kind:
            rows.append([label, *_kind_row(of_kind)])
    return [title, markdown_table(heads, rows, words=(0, 2))]


def _kind_row(of_kind: list[Mapping[str, Any]]) -> list[str]:
    changed = sum(not check_passed(check) for check in of_kind)
    worst = max(of_kind, key=_strain)
    limit = f"{relation(worst)} {check_value(worst, 'limit')}"
    counted = f"{changed} of {len(of_kind)}"
    name = markdown_text(str(worst.get("name", MISSING)).replace(" against the baseline", ""))
    return [counted, name, markdown_text(check_value(worst)), markdown_text(limit)]


def _strain(check: Mapping[str, Any]) -> float:
    """How much of what is allowed a comparison takes up; most of all if it failed."""
    value, limit = check.get("value"), check.get("limit")
    if not (is_number(value) and is_number(limit)):
        return float("inf")
    strain = abs(value) / limit if limit > 0 else abs(value)
    return strain + (0.0 if check_passed(check) else 1e9)


def _verdict_line(data: Mapping[str, Any]) -> str:
    passed = sum(map(check_passed, checks(data)))
    parts = [
        f"Display {markdown_text(part(data, 'display', 'given').get('name', MISSING))}",
        f"lens model {markdown_text(data.get('lens_model', MISSING))}",
        markdown_text(part(data, "backend").get("variant", MISSING)),
        f"inim {markdown_text(data.get('inim_version', MISSING))}",
    ]
    counted = f"{passed} of {len(checks(data))} checks passed."
    return f"{_sign(data)} **{verdict(data).capitalize()}**: {counted} {', '.join(parts)}."


def _sign(data: Mapping[str, Any]) -> str:
    return {"passed": "✅", "failed": "❌"}.get(verdict(data), "⚪")


def _scores_table(data: Mapping[str, Any]) -> str:
    names = viewpoint_names(data)
    heads = ["algorithm", *map(markdown_text, names), f"EIA {MAIN.label}", "holes", "seconds"]
    rows = [_algorithm_row(data, name, names) for name in part(data, "algorithms")]
    rows.append(_reference_row("*ceiling*", part(data, "ceiling"), names))
    rows.append(_reference_row("*noise floor*", part(data, "noise_floor"), names))
    return markdown_table(heads, rows)


def _algorithm_row(data: Mapping[str, Any], name: str, names: list[str]) -> list[str]:
    run = part(data, "algorithms", name)
    views = [part(run, "views", v) for v in names]
    cells = [
        f"{score(v, HEADLINE)} ({score(v, HEADLINE_TO_SCENE)}); "
        f"{score(v, MAIN.to_ceiling_key)} ({score(v, MAIN.key)})"
        for v in views
    ]
    label = markdown_text(name)
    if name == best_algorithm(data) and len(part(data, "algorithms")) > 1:
        label += ", best"
    eia = part(run, "eia")
    last = [score(eia, MAIN.key), score(eia, "hole_fraction"), number(run.get("seconds"), 2)]
    return [label, *cells, *last]


def _reference_row(label: str, scores: Mapping[str, Any], names: list[str]) -> list[str]:
    views = [part(scores, "views", name) for name in names]
    cells = [f"({score(v, HEADLINE_TO_SCENE)}); ({score(v, MAIN.key)})" for v in views]
    return [label, *cells, score(part(scores, "eia"), MAIN.key), MISSING, MISSING]


def _failures(data: Mapping[str, Any]) -> list[str]:
    failed = [check for check in checks(data) if not check_passed(check)]
    lines = [_failure_line(check) for check in failed[:_MOST_FAILURES]]
    if len(failed) > _MOST_FAILURES:
        lines.append(f"* and {len(failed) - _MOST_FAILURES} more, in report.json")
    return ["**Failed checks**\n\n" + "\n".join(lines)] if lines else []


def _failure_line(check: Mapping[str, Any]) -> str:
    sentence = markdown_text(check_sentence(check), _LONGEST_SENTENCE)
    return f"* {markdown_text(check.get('name', MISSING))}: {sentence}"


def _warnings(data: Mapping[str, Any]) -> list[str]:
    count = len(items(data, "warnings"))
    return [f"{count} warning{'s' if count > 1 else ''}: see the report."] if count else []


def markdown_table(
    heads: Sequence[str], rows: Sequence[Sequence[str]], words: Sequence[int] = (0,)
) -> str:
    """A table of Markdown cells: columns of `words` to the left, the others to the right."""
    rule = [":--" if column in words else "--:" for column in range(len(heads))]
    return "\n".join(f"| {' | '.join(row)} |" for row in (heads, rule, *rows))


def markdown_text(value: object, longest: int = _LONGEST_NAME) -> str:
    """`value` as one line of Markdown text that cannot format, link or break a table."""
    line = " ".join(plain(value).split())
    if len(line) > longest:
        line = line[: longest - 1] + "…"
    line = line.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return re.sub(r"([\\`*_{}\[\]()#|~!])", r"\\\1", line)


def markdown_section(caption: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of plain texts, however long, under its caption."""
    cells = [[markdown_line(cell) for cell in row] for row in (heads, *rows)]
    return f"### {markdown_line(caption)}\n\n{markdown_table(cells[0], cells[1:])}"


def markdown_line(value: object) -> str:
    """`value` as one line, however long, that cannot break a table."""
    line = " ".join(plain(value).split())
    return line.replace("&", "&amp;").replace("<", "&lt;").replace("|", "\\|")


def markdown_command(command: str) -> str:
    """The command of a report, as code."""
    return _code(plain(command))


def _code(command: str) -> str:
    return f"`{command.replace('`', '')}`"


def _preview(data: Mapping[str, Any]) -> list[str]:
    """That this is a first look, and how to make the full report."""
    command = full_command(data)
    return [f"**{PREVIEW_WORDS}** {_code(command)}"] if command else []


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
