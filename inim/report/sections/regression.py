"""Changes relative to the baseline: failures in words and images, and the drift of all other
values.
"""

from pathlib import Path

import msgspec

from inim.report.document import ReportDocument
from inim.report.images import ENCODINGS, ReportImages
from inim.report.labels import MISSING, short
from inim.report.page import (
    Section,
    check_badge,
    document_page,
    element,
    figure,
    lead,
    text,
    text_table,
)
from inim.report.sections import ReportSection
from inim.report.sections.run import check_list
from inim.report.summary import render_checks, render_junit
from inim.scores.document_parts import Drift, Regression
from inim.scores.metrics import all_metrics
from inim.scores.regression.document import CompareDocument
from inim.system.document import write_listed

_FOLDER = "regression"
# The rest is in report.json.
_MOST_DRIFTS = 12
_MOST_PICTURES = 6
_WORDS = (
    "A change fails if it is larger than noise explains and large enough to matter. Sidak's "
    "correction over all tests of a kind limits false alarms to one run in a thousand. "
)


def regression(data: ReportDocument | CompareDocument, images: ReportImages) -> str:
    """The section on the baseline; empty for a run that was not compared with one."""
    comparison = data.regression
    if comparison is None:
        return ""
    judged = [check for check in data.verdict.checks if check.kind is not None]
    failed = sum(not check.passed for check in judged)
    changed = f"{failed} changed" if failed else "none changed"
    words = f"Of {len(judged)} comparisons with {comparison.baseline}, {changed}. "
    if comparison.reason:
        words += f"That baseline was accepted because: {comparison.reason}. "
    pictures = _images(comparison, images)
    return lead(words + _WORDS) + pictures + _circumstances(comparison) + _drift(comparison)


def _images(comparison: Regression, images: ReportImages) -> str:
    rows = []
    for name in comparison.pictures[:_MOST_PICTURES]:
        shots = [
            figure(
                images.embed(images.read(_FOLDER, f"{name}-{kind}.png"), f"{name}, {kind}"),
                label,
                remark,
            )
            for kind, label, remark in (
                ("baseline", "Before", "as stored in the baseline"),
                ("candidate", "Now", ""),
                ("difference", "Difference", "amplified; black is equal"),
            )
        ]
        rows.append(element("h3", text(name)) + element("div", *shots, class_="three"))
    return "".join(rows)


def _circumstances(comparison: Regression) -> str:
    rows = [
        [row.name, *(MISSING if v is None else v for v in (row.baseline, row.candidate))]
        for row in comparison.circumstances
    ]
    if not rows:
        return ""
    heads = ["Circumstance", "Baseline", "This run"]
    return text_table("Other differences between the two runs, not tested", heads, rows, "facts")


def _drift(comparison: Regression) -> str:
    """The reported scores that moved most, passed or not."""

    def size(row: Drift) -> float:
        if row.change is None or row.baseline is None:
            return 0.0
        return abs(row.change) / max(abs(row.baseline), 0.1)

    moved = sorted(comparison.drift, key=size, reverse=True)
    rows = [
        [
            f"{row.subject}: {_score_phrase(row.score)}",
            short(row.baseline),
            short(row.candidate),
            "+" * (row.change is not None and row.change >= 0) + short(row.change),
        ]
        for row in moved[:_MOST_DRIFTS]
        if size(row) > 0
    ]
    if not rows:
        return element("p", "No reported score drifted.")
    caption = f"The {len(rows)} reported scores that drifted most, judged or not"
    return text_table(caption, ["Score", "Baseline", "This run", "Drift"], rows, "drift")


def _score_phrase(label: str) -> str:
    """A score's name with its metric's label and without its unit: "PSNR to reference"."""
    for metric in all_metrics():
        if metric.unit:
            label = label.removesuffix(f"_{metric.unit.lower()}")
        label = label.replace(metric.name, metric.label)
    return label.replace("eia", "EIA").replace("_", " ")


SECTIONS = (ReportSection(35, "regression", "Against the baseline", regression),)


_SHOWN = ("title", "created", "inim", "mitsuba", "libLLVM", "device", "threads", "seed")


def write_comparison(data: CompareDocument, folder: Path) -> None:
    """Write all forms of a comparison into a folder, `compare.json` last: it marks a whole one."""
    forms = {
        "compare.html": lambda data: _page(data, folder),
        "junit.xml": render_junit,
        "summary.md": render_checks,
    }
    write_listed(data, folder, "compare.json", forms)


def _page(data: CompareDocument, folder: Path) -> str:
    return document_page(
        data,
        "compare.json",
        [text(f"{data.after.folder} against {data.before.folder}")],
        [
            Section(
                "regression", "What changed", regression(data, ReportImages(folder, ENCODINGS[0]))
            ),
            Section("checks", "Checks", check_list(data.verdict)),
            Section("runs", "The two runs", _runs(data)),
        ],
        purpose="inim comparison",
        words=f": {data.verdict.word}",
        verdict_badge=check_badge(data.verdict),
    )


def _runs(data: CompareDocument) -> str:
    sides = [msgspec.to_builtins(side.circumstances) for side in (data.before, data.after)]
    rows = [[name, *(side.get(name, MISSING) for side in sides)] for name in _SHOWN]
    return text_table("Circumstances", ["", "Before", "After"], rows, "facts")
