"""A report for continuous integration: short Markdown for a comment box, and JUnit XML."""

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from inim.report.comparison_text import (
    MOST_LINES,
    accept_command,
    also_changed,
    change_text,
    changed_check,
    comparison_lines,
    headline_changes,
    short_name,
    signed_change,
    tolerance_share,
    verdict_sentence,
    worst_first,
)
from inim.report.document import ReportDocument
from inim.report.labels import (
    MISSING,
    PREVIEW_WORDS,
    aligned,
    check_limit,
    check_sentence,
    check_value,
    full_command,
    named,
    number,
    per_cent,
    plain,
    relation,
    score,
    shares_of_possible,
    suggested_criteria,
    unequal_algorithms,
    verdict_words,
)
from inim.report.page import element, text, text_table
from inim.scores.document_parts import Check, Checks
from inim.scores.metrics import HEADLINE, HEADLINE_TO_SCENE, MAIN
from inim.scores.regression.document import CompareDocument

_SUITE = "inim.validate"
# Stages that contain others, among the timings of a run.
_TOTAL_TIME, _RENDER_TIME = "total", "mitsuba_render"

# Long names and long lists stay in report.json: a summary is read in a comment box.
_LONGEST_NAME = 80
_LONGEST_SENTENCE = 300
_MOST_FAILURES = 20
_MEANING = (
    "SSIM on the relic to the reference, in brackets to the ground truth; then both for the whole "
    "image. Scores are corrected for noise, except those of the EIA and the noise floor. The "
    "reference is the view of the ground-truth EIA. The table of scores in report.html also has "
    "the other metrics, such as PSNR, and 95 % intervals."
)


def render_summary(data: ReportDocument, out: Path | None = None) -> str:
    """The report, whose folder is `out`, in Markdown: verdict and scores with their references."""
    suggestion = suggested_criteria(data) if data.verdict.word == "ran clean" else ""
    criteria = (
        [f"To set criteria: `-D 'inim.min_ssim_to_reference={suggestion}'`."] if suggestion else []
    )
    command = full_command(data)
    preview = [f"**{PREVIEW_WORDS}** {markdown_command(command)}"] if command else []
    blocks = [
        f"## {markdown_text(data.title)}: {verdict_words(data)}",
        _verdict_line(data),
        *_regression_lines(data, out),
        *preview,
        _scores_table(data),
        named(data, _MEANING),
        *(f"{markdown_text(line, _LONGEST_SENTENCE)}." for line in _note_lines(data)),
        *criteria,
        *_failures(data),
    ]
    if count := len(data.warnings):
        blocks.append(f"{count} warning{'s' * (count > 1)}: see the report.")
    return "\n\n".join(blocks) + "\n"


def render_text(data: ReportDocument) -> str:
    """The headline scores as a table of plain text, for a terminal."""
    return plain("\n".join([f"{data.title}: {verdict_words(data)}", *score_lines(data)]))


_SCORE_WORDS = f"{MAIN.label} on the relic to the reference (in brackets: to the ground truth)"
_LINE_WIDTH = 80
_MOST_OF_NAME = 34


def score_lines(data: ReportDocument) -> list[str]:
    """Headline scores of all algorithms and viewpoints, in lines of at most 80 characters.

    Viewpoints that do not fit are in a further block of lines.
    """
    first, *columns = _score_columns(data)
    lines = [named(data, _SCORE_WORDS)]
    block = [first]
    for cells in columns:
        if len(block) > 1 and _width([*block, cells]) > _LINE_WIDTH:
            lines += aligned(block)
            block = [first]
        block.append(cells)
    return [*lines, *aligned(block), *_note_lines(data)]


def _note_lines(data: ReportDocument) -> list[str]:
    """Lines on unequal algorithms and with the `shares_of_possible`, if there are any."""
    shares = shares_of_possible(data).items()
    cells = ", ".join(f"{name} {per_cent(share, 0)}" for name, share in shares)
    return [*unequal_algorithms(data), *[f"share of what is possible: {cells}"] * bool(cells)]


def render_table(data: ReportDocument, link: str) -> str:
    """Verdict and headline scores as HTML, with a link to the page."""
    heads, *rows = zip(*_score_columns(data), strict=True)
    link_to_page = element("a", "report", href=link, target="_blank")
    verdict = text(f"{data.title}: {verdict_words(data)}")
    caption = named(data, _SCORE_WORDS)
    notes = [element("p", text(line)) for line in _note_lines(data)]
    return "".join(
        [element("p", verdict, "; ", link_to_page), text_table(caption, heads, rows), *notes]
    )


def _score_columns(data: ReportDocument) -> list[list[str]]:
    """Names, then for each viewpoint its name and the headline scores of all algorithms."""
    results = {name: result.views for name, result in data.algorithms.items()}
    names = {name: _cut(name, _MOST_OF_NAME) for name in [*results, "reference"]}
    columns = [["", *names.values()]]
    for view in data.viewpoint_names:
        cells = [view]
        for views in results.values():
            scores = views.get(view, {})
            to_truth = _three_digits(scores, HEADLINE_TO_SCENE)
            cells.append(f"{_three_digits(scores, HEADLINE)} ({to_truth})")
        cells.append(f"({_three_digits(data.reference.views[view], HEADLINE_TO_SCENE)})")
        columns.append(cells)
    return columns


def _three_digits(scores: Mapping[str, Any], key: str) -> str:
    return number(scores.get(key), 3)


def _cut(name: str, longest: int) -> str:
    return name if len(name) <= longest else name[: longest - 1] + "…"


def _width(columns: Sequence[Sequence[str]]) -> int:
    return sum(max(map(len, column)) + 2 for column in columns) - 2


def render_checks(data: CompareDocument) -> str:
    """A comparison of two runs in a few lines of Markdown."""
    verdict = data.verdict
    head = f"## {markdown_text(data.title)}: {data.regression.verdict}"
    line = f"{_sign(verdict)} {verdict.passed_count} of {len(verdict.checks)} comparisons passed."
    return "\n\n".join([head, line, *_regression_lines(data), *_failures(data)]) + "\n"


_KINDS = {
    "picture": "pictures, tile by tile",
    "noise": "noise of the ground truth",
    "score": "scores",
    "light": "light on the relic",
    "pixels": "EIAs of the reference input",
}


def _regression_lines(data: ReportDocument | CompareDocument, out: Path | None = None) -> list[str]:
    """Against the baseline: verdict, changed inputs, changes of the headline score, comparisons.

    Each kind of comparison has the one nearest to failing, which shows drift where all is well.
    """
    comparison = data.regression
    if comparison is None:
        return []
    title = f"**Against {markdown_text(comparison.baseline)}**"
    if comparison.reason:
        title += f" ({markdown_text(comparison.reason, _LONGEST_SENTENCE)})"
    words = verdict_sentence(data, comparison)
    inputs = [f"* {markdown_text(change_text(c), _LONGEST_SENTENCE)}" for c in comparison.inputs]
    blocks = [f"{title}: {markdown_text(words, _LONGEST_SENTENCE)}."]
    if inputs:
        more = [f"* and {len(inputs) - MOST_LINES} more"] * (len(inputs) > MOST_LINES)
        blocks.append("**Changed inputs**\n\n" + "\n".join([*inputs[:MOST_LINES], *more]))
    blocks += _headline_table(data)
    if comparison.not_compared:
        names = ", ".join(comparison.not_compared)
        blocks.append(f"Not compared: {markdown_text(names, _LONGEST_SENTENCE)}.")
    if comparison.verdict != "passed":
        blocks += [markdown_text(line, _LONGEST_SENTENCE) for line in also_changed(comparison)]
        if out is not None:
            blocks.append(f"To accept: {markdown_command(accept_command(out))}")
    heads = ["comparison", "changed", "largest for its limit", "value", "limit"]
    rows = []
    for kind, label in _KINDS.items():
        of_kind = [check for check in data.verdict.checks if check.kind == kind]
        if of_kind:
            rows.append([label, *_kind_row(of_kind)])
    return [*blocks, *([markdown_table(heads, rows, words=(0, 2))] if rows else [])]


def _headline_table(data: ReportDocument | CompareDocument) -> list[str]:
    """Changes of the headline score by algorithm and viewpoint, and the place of the others."""
    changes = headline_changes(data)
    views = list(dict.fromkeys(view for by_view in changes.values() for view in by_view))
    rows = [
        [markdown_text(name), *(signed_change(c[v]) if v in c else MISSING for v in views)]
        for name, c in changes.items()
    ]
    heads = [f"change of {MAIN.label} on the relic to the reference", *map(markdown_text, views)]
    page = "compare.html" if isinstance(data, CompareDocument) else "report.html"
    others = f"Changes of all scores are in the checks of {page}."
    return [markdown_table(heads, rows), others] if rows else []


def _kind_row(of_kind: list[Check]) -> list[str]:
    changed = sum(not check.passed for check in of_kind)
    worst = max(of_kind, key=lambda c: (not c.passed, tolerance_share(c)))
    limit = f"{relation(worst)} {check_limit(worst)}"
    counted = f"{changed} of {len(of_kind)}"
    name = markdown_text(short_name(worst))
    return [counted, name, markdown_text(check_value(worst)), markdown_text(limit)]


def _verdict_line(data: ReportDocument) -> str:
    parts = [
        f"Display {markdown_text(data.display.parameters.name)}",
        f"lens model {markdown_text(data.lens_model)}",
        f"renderer {markdown_text(data.backend.variant)}",
        f"inim {markdown_text(data.inim_version)}",
    ]
    verdict = data.verdict
    counted = f"{verdict.passed_count} of {len(verdict.checks)} checks passed."
    doubts = "".join(f" {markdown_text(doubt, _LONGEST_SENTENCE)}." for doubt in verdict.doubts)
    words = f"{_sign(verdict)} **{verdict.word.capitalize()}**:{doubts} {counted}"
    return f"{words} {', '.join(parts)}."


def _sign(verdict: Checks) -> str:
    return {"passed": "✅", "failed": "❌"}.get(verdict.word, "⚪")


def _scores_table(data: ReportDocument) -> str:
    names = data.viewpoint_names
    of_eia = [f"EIA {MAIN.label}", "unlit"] if data.picture is None else ["wrong source", "holes"]
    heads = ["algorithm", *map(markdown_text, names), *of_eia, "seconds"]
    rows = [_algorithm_row(data, name, names) for name in data.algorithms]
    rows.append(_reference_row("*reference*", [data.reference.views[n] for n in names], {}))
    if (floor := data.noise_floor) is not None:
        rows.append(_reference_row("*noise floor*", [floor.views[n] for n in names], floor.eia))
    return markdown_table(heads, rows)


def _algorithm_row(data: ReportDocument, name: str, names: list[str]) -> list[str]:
    result = data.algorithms[name]
    views = [result.views.get(view, {}) for view in names]
    cells = [
        f"{score(v, HEADLINE)} ({score(v, HEADLINE_TO_SCENE)}); "
        f"{score(v, MAIN.to_reference_key)} ({score(v, MAIN.key)})"
        for v in views
    ]
    label = markdown_text(name)
    if name == data.best_algorithm and len(data.algorithms) > 1:
        label += ", best"
    if data.picture is None:
        of_eia = [score(result.eia, MAIN.key), per_cent(result.unlit_fraction, 2)]
    else:
        of_eia = [per_cent(result.wrong_source, 2), score(result.eia, "hole_fraction")]
    return [label, *cells, *of_eia, number(result.seconds, 2)]


def _reference_row(
    label: str, views: Sequence[Mapping[str, Any]], eia: Mapping[str, Any]
) -> list[str]:
    cells = [f"({score(v, HEADLINE_TO_SCENE)}); ({score(v, MAIN.key)})" for v in views]
    return [label, *cells, score(eia, MAIN.key), MISSING, MISSING]


def _failures(data: ReportDocument | CompareDocument) -> list[str]:
    failed = [f"{c.name}: {check_sentence(c)}" for c in data.verdict.failures if c.kind is None]
    changed = worst_first(check for check in data.verdict.failures if check.kind is not None)
    failed += map(changed_check, changed)
    lines = [f"* {markdown_text(line, _LONGEST_SENTENCE)}" for line in failed[:_MOST_FAILURES]]
    if len(failed) > _MOST_FAILURES:
        document = "compare.json" if isinstance(data, CompareDocument) else "report.json"
        lines.append(f"* and {len(failed) - _MOST_FAILURES} more, in {document}")
    note = " (scores in comparisons are not corrected for noise)" if changed else ""
    return [f"**Failed checks**{note}\n\n" + "\n".join(lines)] if lines else []


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
    return f"`{plain(command).replace('`', '')}`"


def render_junit(data: ReportDocument | CompareDocument) -> str:
    """One test suite, ``inim.validate``: a test case per check, and one per stage with its time.

    Returns well-formed XML document for any names of the checks.
    """
    suite = ET.Element("testsuite")
    for check in data.verdict.checks:
        case = _case(suite, check.name)
        if check.fails_run:
            _add_failure(case, check_sentence(check))
    failures = len(data.verdict.failures)
    if data.verdict.checks and not data.verdict.passed and not failures:
        # A run that failed must not show as green because no single check has the reason.
        reasons = "; ".join(data.verdict.doubts) or "the run did not pass, without a failed check"
        _add_failure(_case(suite, "verdict"), reasons)
        failures = 1
    if isinstance(data, ReportDocument):
        for stage, seconds in data.timings.items():
            if stage not in (_TOTAL_TIME, _RENDER_TIME):
                _case(suite, stage, f"{_SUITE}.time").set("time", f"{seconds:.3f}")
    _describe(suite, data, failures)
    ET.indent(suite)
    body = ET.tostring(suite, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{body}\n'


def _describe(suite: ET.Element, data: ReportDocument | CompareDocument, failures: int) -> None:
    total = 0.0 if isinstance(data, CompareDocument) else data.timings[_TOTAL_TIME]
    if data.regression is not None:
        words = comparison_lines(data, most=len(data.verdict.checks))
        properties = ET.Element("properties")
        verdict = {"name": "verdict of the comparison", "value": data.regression.verdict}
        ET.SubElement(properties, "property", verdict)
        suite.insert(0, properties)
        ET.SubElement(suite, "system-out").text = "\n".join(words)
    suite.set("name", _SUITE)
    suite.set("tests", str(len(suite.findall("testcase"))))
    suite.set("failures", str(failures))
    suite.set("errors", "0")
    suite.set("skipped", "0")
    suite.set("time", f"{total:.3f}" if total else "0")
    suite.set("timestamp", plain(data.created))


def _case(suite: ET.Element, name: str, group: str = _SUITE) -> ET.Element:
    attributes = {"classname": group, "name": plain(name), "time": "0"}
    return ET.SubElement(suite, "testcase", attributes)


def _add_failure(case: ET.Element, sentence: str) -> None:
    failure = ET.SubElement(case, "failure", {"type": "check", "message": plain(sentence)})
    failure.text = plain(f"{case.get('name')}: {sentence}")
