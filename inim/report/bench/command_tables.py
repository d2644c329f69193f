"""The tables of whole commands, and how they were timed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from inim.report.bench.cells import Table, milliseconds, times
from inim.report.wording import MISSING, is_number, items, number, part, per_cent

__all__ = ["command_remarks", "command_tables"]

_MIB = 2**20
_SAME = {
    "everything": "all but times",
    "scores": "scores of both",
    "views": "scores of views of both",
}


def command_tables(found: Mapping[str, Any]) -> list[Table]:
    """Commands; then the generation of what nine viewpoints observe."""
    heads = [
        "command", "its store holds", "seconds", "fastest", "spread", "of", "share", "by fastest",
        "peak MiB", "samples traced", "of all", "same as there",
    ]  # fmt: skip
    rows = [
        [
            case["name"],
            case["finds"],
            number(case["median_s"], 2),
            number(case["min_s"], 2),
            f"± {per_cent(case['spread'], 1)}",
            MISSING if case["beside"] == case["name"] else case["beside"],
            per_cent(case["share"], 1),
            per_cent(case["share_min"], 1),
            number(case["peak_bytes"] / _MIB, 0),
            _samples(case),
            per_cent(case["traced"] / case["whole"], 1) if case["whole"] else MISSING,
            _same(case),
        ]
        for case in items(found, "cases")
    ]
    caption = f"Whole commands on {found['title']}, medians"
    return [Table("commands", caption, heads, rows), _generation(part(found, "generation"))]


def _samples(case: Mapping[str, Any]) -> str:
    traced = case["traced"]
    return f"{number(traced / 1e6, 2)} million" if is_number(traced) else MISSING


def _same(case: Mapping[str, Any]) -> str:
    if case["unlike"] is None:
        return MISSING
    if case["unlike"]:
        return f"NO: {len(case['unlike'])} differ, first {case['unlike'][0]}"
    return f"yes, {_SAME[case['same']]}"


def _generation(found: Mapping[str, Any]) -> Table:
    heads = [
        "picture", "observed through", "of the panel", "ms per EIA", "fastest", "spread", "runs",
        "yardsticks", "of the whole EIA", "by fastest", "same pixels",
    ]  # fmt: skip
    rows = [
        [
            c["form"],
            c["name"],
            per_cent(c["observed_share"], 1),
            milliseconds(c["median_ms"]),
            milliseconds(c["min_ms"]),
            f"± {per_cent(c['spread'], 1)}",
            str(c["runs"]),
            times(c["ratio"]),
            per_cent(c["share"], 1),
            per_cent(c["share_min"], 1),
            "yes" if c["same"] else "NO",
        ]
        for c in items(found, "contenders")
    ]
    caption = f"Generating what {len(items(found, 'viewpoints'))} viewpoints observe"
    return Table("commands", f"{caption}: {found['algorithm']}", heads, rows)


def command_remarks(found: Mapping[str, Any]) -> list[str]:
    """How whole commands were timed, in sentences."""
    return [
        f"Whole commands: medians of {found['rounds']} rounds, all cases in turn in each, every "
        "time that of a process from its start to its end. Stores of results are their own and "
        "empty when a round begins. A round before, not counted, left the kernels that numba and "
        "Dr.Jit keep on disk: no time has their compiling in it, that of an empty store included.",
        f"Validated: {found['algorithms'].replace(',', ', ')}, through {found['lens_model']} "
        f"lenses, from {', '.join(items(found, 'viewpoints'))}; from nine viewpoints, template "
        "alone. Peak memory is that of a command's largest process.",
        *map(str, items(found, "notes")),
    ]
