"""A comparison with a baseline in lines of text: changed inputs, changed scores and the verdict."""

import math
import re
import shlex
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from inim.report.document import ReportDocument
from inim.report.labels import MISSING, check_sentence, is_number, number, plain, short
from inim.scores.document_parts import Change, Check, Regression
from inim.scores.metrics import HEADLINE, MAIN
from inim.scores.regression.document import CompareDocument
from inim.scores.regression.scores import score_label
from inim.system.document import read_document

#: Comparisons and changes on the terminal and in the summary; the document has all.
MOST_LINES = 12
_HEADLINE = score_label(HEADLINE)
_CHANGED = ("worse", "inputs changed, scores changed")
_DIRECTIONS = ("worse", "", "better")
# Circumstances that may explain a change; versions of libraries are in the document.
_CODE = re.compile("code$|inim$|package ")


def change_text(change: Change) -> str:
    """A changed input or circumstance as `name: old → new`."""
    old, new = ("none" if v is None else short(v) for v in (change.baseline, change.candidate))
    return plain(f"{change.name}: {old} → {new}")


def tolerance_share(check: Check) -> float:
    """Change of a comparison in units of the largest that passes; infinite without a number."""
    value, limit = check.value, check.limit
    if not is_number(value):
        return math.inf
    return abs(value) / limit if limit > 0 else math.inf if value else 0.0


def compared(data: ReportDocument | CompareDocument) -> list[Check]:
    """All checks of a comparison."""
    return [check for check in data.verdict.checks if check.kind is not None]


def worst_first(checks: Iterable[Check]) -> list[Check]:
    """Comparisons that became worse, then the others; each by change in units of its tolerance."""
    return sorted(checks, key=lambda c: (_DIRECTIONS.index(c.direction), -tolerance_share(c)))


def changed_check(check: Check) -> str:
    """A changed comparison and its direction in one line."""
    return f"{check.direction or 'changed'}: {check.name}: {check_sentence(check)}"


def short_name(check: Check) -> str:
    """Name of a comparison where the baseline is evident."""
    return check.name.removesuffix(" against the baseline")


def also_changed(comparison: Regression) -> list[str]:
    """A line with the code and the packages that changed, which may explain a change."""
    names = [change_text(c) for c in comparison.circumstances if _CODE.match(c.name)]
    return [f"also changed, which excuses no change: {'; '.join(names)}"] if names else []


def headline_changes(data: ReportDocument | CompareDocument) -> dict[str, dict[str, Check]]:
    """Checks of the headline score by algorithm, then by viewpoint."""
    changes: dict[str, dict[str, Check]] = {}
    for check in compared(data):
        subject, _, score = check.name.partition(": ")
        if check.kind == "score" and score.startswith(_HEADLINE):
            algorithm, _, view = subject.rpartition("/")
            changes.setdefault(algorithm, {})[view] = check
    return changes


def signed_change(check: Check) -> str:
    """Change of a score with its interval: `−0.0700 [−0.0750, −0.0650]`."""
    low, high = (number(end, MAIN.digits) for end in check.interval or (None, None))
    value = number(check.value, MAIN.digits)
    return f"{value} [{low}, {high}]" if value != MISSING else value


def verdict_sentence(data: ReportDocument | CompareDocument, comparison: Regression) -> str:
    """The verdict with the numbers of comparisons and of changed inputs, and the worst change."""
    checks = compared(data)
    changed = worst_first(check for check in checks if not check.passed)
    words = f"{comparison.verdict}: {len(changed)} of {len(checks)} comparisons changed"
    if count := sum(check.direction == "worse" for check in changed):
        words += f", {count} worse"
    if count := len(comparison.inputs):
        words += f", {count} changed input{'s' * (count > 1)}"
    if comparison.verdict == _CHANGED[1] and data.verdict.passed:
        words += ", allowed"
    if changed and comparison.verdict in _CHANGED:
        kind = "worst" if changed[0].direction == "worse" else "largest"
        words += f"; {kind}: {short_name(changed[0])}"
    return words


def comparison_lines(
    data: ReportDocument | CompareDocument, out: Path | None = None, most: int = MOST_LINES
) -> list[str]:
    """Changed inputs, changed comparisons and the verdict; empty without a baseline.

    With the folder of a report, the last line is the command that accepts its changes.
    """
    comparison = data.regression
    if comparison is None:
        return []
    lines = [f"changed {change_text(change)}" for change in comparison.inputs[:most]]
    lines += _more(comparison.inputs, most, "changed inputs")
    if comparison.not_compared:
        names = ", ".join(comparison.not_compared[:most])
        lines.append(plain(f"not compared: {names}"))
        lines += _more(comparison.not_compared, most, "not compared")
    failed = worst_first(check for check in compared(data) if not check.passed)
    lines += [plain(changed_check(check)) for check in failed[:most]]
    lines += _more(failed, most, "changed comparisons")
    if failed:
        lines += map(plain, also_changed(comparison))
    lines.append(verdict_sentence(data, comparison))
    if out is not None and comparison.verdict != "passed":
        lines.append(f"to accept: {accept_command(out)}")
    return lines


def accept_command(out: Path) -> str:
    """Command that makes a report the baseline of its comparison."""
    return f"inim accept {shlex.quote(str(out))} --reason TEXT"


def accepted_lines(out: Path) -> list[str]:
    """All changes of a report relative to the baseline that it was compared with, for a review."""
    data = read_document(out / "report.json", "make it with inim validate", ReportDocument)
    return comparison_lines(data, most=sys.maxsize)


def _more(items: Sequence[object], most: int, kind: str) -> list[str]:
    return [f"and {len(items) - most} more {kind}"] * (len(items) > most)
