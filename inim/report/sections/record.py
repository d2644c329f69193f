"""The record of the run: its checks, where the time went, warnings, and how to run it again."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, TypeGuard

from inim.report.markup import bullets, element, mark, table, text
from inim.report.page import how_to_reproduce
from inim.report.wording import (
    MISSING,
    NBSP,
    check_interval,
    check_passed,
    check_value,
    checks,
    is_number,
    items,
    number,
    part,
    per_cent,
    relation,
)

__all__ = ["check_list", "reproduce", "timings", "warnings"]

_TOTAL, _RENDER = "total", "mitsuba_render"


def check_list(data: Mapping[str, Any]) -> str:
    """Every check with its numbers, the failed ones first."""
    if not checks(data):
        return element("p", "Nothing was checked.")
    rows = [_check_row(check) for check in sorted(checks(data), key=check_passed)]
    heads = ["Check", "Value", "Relation", "Limit", "Interval of the value", "Verdict"]
    return table("Every check, the failed ones first", heads, rows, "checks")


def _check_row(check: Mapping[str, Any]) -> list[str]:
    word = "passed" if check_passed(check) else "failed"
    name = text(check.get("name", MISSING))
    if check.get("detail"):
        name += element("small", text(check["detail"]))
    badge = element("span", mark(word), word, class_=f"badge {word}")
    value, limit = check_value(check), check_value(check, "limit")
    interval = text(check_interval(check) or MISSING)
    return [name, text(value), text(relation(check)), text(limit), interval, badge]


def timings(data: Mapping[str, Any]) -> str:
    """Where the time went, stage by stage, and how much of it the renderer took."""
    taken = part(data, "timings")
    stages = {k: v for k, v in taken.items() if k not in (_TOTAL, _RENDER)}
    total = taken.get(_TOTAL)
    if not _is_time(total):
        total = math.fsum(v for v in stages.values() if _is_time(v))
    rows = [_stage_row(name, seconds, total) for name, seconds in stages.items()]
    listed = table("Wall-clock time", ["Stage", "Seconds", "Share of the total"], rows, "timings")
    return _time_words(taken, total) + listed


def _time_words(taken: Mapping[str, Any], total: float) -> str:
    words = f"{number(total, 2)}{NBSP}s in all"
    render = taken.get(_RENDER)
    if _is_time(render) and total > 0:
        share = per_cent(render / total, 0)
        words += f", of which the renderer took {number(render, 2)}{NBSP}s ({share})"
    return element("p", text(f"{words}."), class_="lead")


def _stage_row(name: str, seconds: object, total: float) -> list[str]:
    share = seconds / total if _is_time(seconds) and total > 0 else None
    width = min(100 * (share or 0.0), 100.0)
    bar = element("div", class_="bar", style=f"width:{width:.1f}%", aria_hidden="true")
    words = element("span", text(per_cent(share, 1)))
    label = text(name.replace("_", " "))
    return [label, text(number(seconds, 2)), element("div", words, bar, class_="share")]


def _is_time(value: object) -> TypeGuard[float]:
    return is_number(value) and math.isfinite(value) and value >= 0


def warnings(data: Mapping[str, Any]) -> str:
    """What the run wants the reader to know."""
    return bullets(items(data, "warnings"), "cautions") or element("p", "None.")


def reproduce(data: Mapping[str, Any]) -> str:
    """The command, and everything that could make another run differ."""
    return how_to_reproduce(data).body
