"""What changed against the baseline: failures in words and images, and the drift of all else."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from inim.metrics import all_metrics
from inim.report.images import Images
from inim.report.markup import element, figure, text, text_table
from inim.report.sections import ReportSection
from inim.report.wording import MISSING, check_passed, checks, is_number, items, part, short

_FOLDER = "regression"
# The rest is in report.json.
_MOST_DRIFTS = 12
_MOST_PICTURES = 6
_WORDS = (
    "A change fails if it is larger than what noise explains and large enough to count; Sidak's "
    "correction over all tests of a kind keeps false alarms to one run in a thousand. "
)


def regression(data: Mapping[str, Any], images: Images) -> str:
    """The section on the baseline; empty for a run that was not compared with one."""
    found = part(data, "regression")
    if not found:
        return ""
    judged = [check for check in checks(data) if "kind" in check]
    failed = sum(not check_passed(check) for check in judged)
    changed = f"{failed} changed" if failed else "nothing changed"
    words = f"Of {len(judged)} comparisons with {found.get('baseline', MISSING)}, {changed}. "
    if found.get("reason"):
        words += f"That baseline was accepted because: {found['reason']}. "
    lead = element("p", text(words + _WORDS), class_="lead")
    return lead + _images(found, images) + _circumstances(found) + _drift(found)


def _images(found: Mapping[str, Any], images: Images) -> str:
    rows = []
    for name in items(found, "pictures")[:_MOST_PICTURES]:
        shots = [
            figure(
                images.embed(images.read(_FOLDER, f"{name}-{kind}.png"), f"{name}, {kind}"),
                label,
                remark,
            )
            for kind, label, remark in (
                ("baseline", "Before", "what the baseline holds of it"),
                ("candidate", "Now", ""),
                ("difference", "Difference", "amplified; black is equal"),
            )
        ]
        heading = element("h3", text(name))
        rows.append(heading + element("div", *shots, class_="three"))
    return "".join(rows)


def _circumstances(found: Mapping[str, Any]) -> str:
    rows = [
        [part(row).get("name", MISSING), _shown(row, "baseline"), _shown(row, "candidate")]
        for row in items(found, "circumstances")
    ]
    if not rows:
        return ""
    heads = ["What made it", "Baseline", "This run"]
    return text_table("What else differs between the two runs, not judged", heads, rows, "facts")


def _shown(row: Any, key: str) -> object:
    value = part(row).get(key)
    return MISSING if value is None else value


def _drift(found: Mapping[str, Any]) -> str:
    """The reported scores that moved most, passed or not."""

    def size(row: Any) -> float:
        change, before = part(row).get("change"), part(row).get("baseline")
        if not is_number(change) or not math.isfinite(change):
            return 0.0
        return abs(change) / max(abs(before), 0.1) if is_number(before) else 0.0

    moved = sorted(items(found, "drift"), key=size, reverse=True)
    rows = [
        [
            f"{part(row).get('what', MISSING)}: {_words(part(row).get('score', MISSING))}",
            short(part(row).get("baseline")),
            short(part(row).get("candidate")),
            _signed(part(row).get("change")),
        ]
        for row in moved[:_MOST_DRIFTS]
        if size(row) > 0
    ]
    if not rows:
        return element("p", "No reported score drifted.")
    caption = f"The {len(rows)} reported scores that drifted most, judged or not"
    return text_table(caption, ["Score", "Baseline", "This run", "Drift"], rows, "drift")


def _words(name: object) -> str:
    """A score's name with its metric's label and without its unit: "PSNR to ceiling"."""
    label = str(name)
    for metric in all_metrics():
        if metric.unit:
            label = label.removesuffix(f"_{metric.unit.lower()}")
        label = label.replace(metric.name, metric.label)
    return label.replace("eia", "EIA").replace("_", " ")


def _signed(change: object) -> str:
    if not is_number(change):
        return MISSING
    return f"+{short(float(change))}" if change >= 0 else short(float(change))


SECTIONS = (ReportSection(30, "regression", "Against the baseline", regression),)
