"""What the run did and what it left out, and why that changes no result."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from inim.report.markup import element, table, text
from inim.report.wording import MISSING, is_number, items, part

__all__ = ["skipped"]

_WORDS = "No score on this page would be another, had everything been done."
_SAMPLES = (
    "Samples ended when every SSIM was known as well as was asked for: with all of them, some "
    "would be another by no more than that. Nothing else that was skipped changes a score."
)
_COLUMNS = {"what": "What", "done": "Done", "skipped": "Skipped", "why": "Why"}


def skipped(data: Mapping[str, Any]) -> str:
    """The section; empty for a report that does not say."""
    rows = [
        [text(MISSING if part(row).get(key) is None else part(row)[key]) for key in _COLUMNS]
        for row in items(data, "skipped")
    ]
    if not rows:
        return ""
    error = part(data, "settings").get("score_error")
    words = _SAMPLES if is_number(error) and error > 0 else _WORDS
    caption = "What this run did and skipped"
    return element("p", text(words), class_="lead") + table(
        caption, list(_COLUMNS.values()), rows, "skips"
    )
