"""What bench.json says of whole commands, as a part of a page: tables and a plot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from inim.report.bench import milliseconds, times
from inim.report.labels import MISSING, is_number, number, per_cent
from inim.report.plots import LINES, SOFT, colour_of, new_figure, plain_ticks, style
from inim.report.study import PagePart, Table
from reports.bench.parts import items, part

_MIB = 2**20
_SAME = {
    "everything": "all but times",
    "scores": "scores of both",
    "views": "scores of views of both",
}


def parts_of(data: Mapping[str, Any]) -> list[PagePart]:
    """Tables and plot of all commands."""
    found = part(data, "commands")
    lead = (
        "What a validation costs when nothing is known, and when something is found again. Each "
        "mark is a run; lines are the medians of those compared with."
    )
    tables, remarks = _tables(found), _remarks(found)
    return [PagePart("commands", "Whole commands", lead, tables, "commands", _draw(found), remarks)]


def _tables(found: Mapping[str, Any]) -> list[Table]:
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
    return [Table(caption, heads, rows), _generation(part(found, "generation"))]


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
        for c in items(found, "algorithms")
    ]
    caption = f"Generating what {len(items(found, 'viewpoints'))} viewpoints observe"
    return Table(f"{caption}: {found['algorithm']}", heads, rows)


def _remarks(found: Mapping[str, Any]) -> list[str]:
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


def _draw(found: Mapping[str, Any]) -> Any:
    """A row for each command: its runs, over seconds, and the share of what it is compared with."""
    cases = found["cases"]
    figure, (axis,) = new_figure(1, 1.2 + 0.32 * len(cases))
    figure.set_figwidth(8.4)
    compared = {case["beside"] for case in cases}
    for row, case in enumerate(cases):
        is_measure = case["name"] in compared
        colour = SOFT if is_measure else colour_of("template")
        taken = case["times_s"]
        axis.plot(taken, [row] * len(taken), "o", color=colour, alpha=0.6, markersize=5, zorder=3)
        if is_measure:
            reach = [r for r, other in enumerate(cases) if other["beside"] == case["name"]]
            ends = [min(reach) - 0.3, max(reach) + 0.3]
            axis.plot([case["median_s"]] * 2, ends, **LINES["floor"])
        else:
            _write_right_of(axis, f"{case['share']:.1%} of {case['beside']}", max(taken), row)
    axis.set_xscale("log")
    axis.margins(x=0.2)
    style(axis, "Whole commands", "seconds, start to end", "")
    axis.set_yticks(range(len(cases)), [case["name"] for case in cases])
    axis.invert_yaxis()
    plain_ticks(axis)
    return figure


def _write_right_of(axis: Any, words: str, x: float, y: float) -> None:
    """Words on the right of a mark, readable where a line is behind them."""
    behind = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
    look = {"fontsize": 8, "color": SOFT, "va": "center", "bbox": behind, "zorder": 2}
    axis.annotate(words, (x, y), (7, 0), textcoords="offset points", **look)
