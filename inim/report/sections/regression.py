"""Changes relative to the baseline: changed inputs, scores with intervals, and images."""

from collections.abc import Sequence
from pathlib import Path

import msgspec

from inim.report.comparison_text import (
    changed_check,
    compared,
    headline_changes,
    signed_change,
    verdict_sentence,
    worst_first,
)
from inim.report.document import ReportDocument
from inim.report.images import ENCODINGS, ReportImages
from inim.report.labels import MISSING
from inim.report.page import (
    Section,
    bullets,
    check_badge,
    document_page,
    element,
    figure,
    lead,
    table,
    text,
    text_table,
    void,
)
from inim.report.sections import ReportSection
from inim.report.sections.run import check_list
from inim.report.summary import render_checks, render_junit
from inim.scores.document_parts import Change, Regression
from inim.scores.metrics import HEADLINE_WORDS
from inim.scores.regression.document import CompareDocument
from inim.system.document import write_listed

_FOLDER = "regression"
# The rest is in report.json.
_MOST_PICTURES = 6
_WORDS = (
    "A change counts if it is larger than noise explains and large enough to matter. All tests "
    "together raise a false alarm in at most one run of a thousand. "
)


def regression(data: ReportDocument | CompareDocument, images: ReportImages) -> str:
    """The section on the baseline; empty for a run that was not compared with one.

    Changed inputs come first, then scores, then pictures.
    """
    comparison = data.regression
    if comparison is None:
        return ""
    runs = ("Baseline", "This run")
    if isinstance(data, CompareDocument):
        runs = (data.before.folder, data.after.folder)
    words = f"Against {comparison.baseline}, {verdict_sentence(data, comparison)}. "
    if comparison.reason:
        words += f"That baseline was accepted because: {comparison.reason}. "
    parts = [
        lead(words + _WORDS),
        _changes("Changed inputs", ("Input", *runs), comparison.inputs),
        _scores(data),
        _not_compared(comparison),
        _images(comparison, images, *_remarks(data)),
        _changes(
            "Other differences, which excuse no change",
            ("Circumstance", *runs),
            comparison.circumstances,
        ),
    ]
    return "".join(parts)


def _changes(caption: str, heads: Sequence[str], changes: Sequence[Change]) -> str:
    """Table of changes; empty without any."""
    rows = [
        [
            text(row.name),
            *(
                _preview(preview) + text(MISSING if value is None else value)
                for preview, value in zip(row.previews, (row.baseline, row.candidate), strict=True)
            ),
        ]
        for row in changes
    ]
    return table(caption, list(map(text, heads)), rows, "facts") if rows else ""


def _preview(png_base64: str) -> str:
    """Picture of a changed file, enlarged; empty without one."""
    if not png_base64:
        return ""
    return void("img", src=f"data:image/png;base64,{png_base64}", alt="", width=96) + " "


def _scores(data: ReportDocument | CompareDocument) -> str:
    """Changes of the headline score by algorithm and viewpoint, and all changed scores.

    Last is the number of changes that are not of scores.
    """
    rows = [
        [algorithm, view, signed_change(c), "" if c.passed else c.direction or "changed"]
        for algorithm, by_view in headline_changes(data).items()
        for view, c in by_view.items()
    ]
    caption = f"Change of {HEADLINE_WORDS}, with its interval"
    heads = ["Algorithm", "Viewpoint", "Change", ""]
    all_changes = text_table(caption, heads, rows, "drift") if rows else ""
    changed = [check for check in compared(data) if not check.passed]
    scores = worst_first(check for check in changed if check.kind == "score")
    title = lead(f"Changed scores: {len(scores)}, not corrected for noise.")
    listed = (title + bullets(map(changed_check, scores), "changes")) * bool(scores)
    words = text(f"Other changed comparisons: {len(changed) - len(scores)}, see ")
    others = element("p", words, element("a", "Checks", href="#checks"), ".")
    return all_changes + listed + others * (len(changed) > len(scores))


def _not_compared(comparison: Regression) -> str:
    names = ", ".join(comparison.not_compared)
    return element("p", text(f"Not compared: {names}.")) if names else ""


def _remarks(data: ReportDocument | CompareDocument) -> tuple[str, str]:
    """Captions of the picture before, and of the difference."""
    if isinstance(data, CompareDocument):
        return "", "amplified; black is equal"
    before = "mean of each tile, which is all that a baseline has"
    return before, "by tile, amplified: red is brighter now, blue darker, black equal"


def _images(comparison: Regression, images: ReportImages, before: str, difference: str) -> str:
    rows = []
    for name in comparison.pictures[:_MOST_PICTURES]:
        shots = [
            figure(
                images.embed(images.read(_FOLDER, f"{name}-{kind}.png"), f"{name}, {kind}"),
                label,
                remark,
            )
            for kind, label, remark in (
                ("baseline", "Before", before),
                ("candidate", "Now", ""),
                ("difference", "Difference", difference),
            )
        ]
        rows.append(element("h3", text(name)) + element("div", *shots, class_="three"))
    return "".join(rows)


SECTIONS = (ReportSection(5, "regression", "Against the baseline", regression),)


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
        words=f": {data.regression.verdict}",
        verdict_badge=check_badge(data.verdict),
    )


def _runs(data: CompareDocument) -> str:
    sides = [msgspec.to_builtins(side.circumstances) for side in (data.before, data.after)]
    rows = [[name, *(side.get(name, MISSING) for side in sides)] for name in _SHOWN]
    return text_table("Circumstances", ["", "Before", "After"], rows, "facts")
