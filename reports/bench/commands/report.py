"""Page of the study of whole commands: tables and a plot from bench.json."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from inim.apps.bench.page import milliseconds, times
from inim.report.labels import MISSING, is_number, number, per_cent
from inim.report.plots import LINES, SOFT, colour_of, new_figure, plain_ticks, style
from inim.report.study import PagePart, Table
from reports.bench.parts import RUN_PARTS, items, part

_MIB = 2**20
_SAME = {
    "everything": "all except times",
    "scores": "common scores",
    "views": "common scores of views",
}


def parts_of(data: Mapping[str, Any]) -> list[PagePart]:
    """Part of the page: tables and plot of all commands."""
    study = part(data, "commands")
    lead = (
        "Time of a validation with an empty result cache and with cached results. Each mark is a "
        "run. Lines are the medians of the commands used for comparison."
    )
    tables, remarks = _tables(study), _remarks(study)
    return [PagePart("commands", "Whole commands", lead, tables, "commands", _draw(study), remarks)]


def _tables(study: Mapping[str, Any]) -> list[Table]:
    """Tables of the commands and of the partial generation for nine viewpoints."""
    heads = [
        "command", "in the cache", "seconds", "fastest", "spread", "compared with", "share",
        "by fastest", "peak MiB", "samples traced", "share of samples", "same results",
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
        for case in items(study, "cases")
    ]
    caption = f"Whole commands on {study['title']}, medians"
    return [Table(caption, heads, rows), _parts(study), _generation(part(study, "generation"))]


def _parts(study: Mapping[str, Any]) -> Table:
    """Seconds of the parts of the last run of each command."""
    rows = []
    for case in items(study, "cases"):
        if case.get("parts"):
            rest = case["times_s"][-1] - sum(case["parts"].values())
            seconds = [*case["parts"].values(), rest]
            rows.append([case["name"], *(number(value, 2) for value in seconds)])
    heads = ["command", *RUN_PARTS, "start, files and report"]
    return Table("Seconds of the parts of a run", heads, rows)


def _samples(case: Mapping[str, Any]) -> str:
    traced = case["traced"]
    return f"{number(traced / 1e6, 2)} million" if is_number(traced) else MISSING


def _same(case: Mapping[str, Any]) -> str:
    if case["unlike"] is None:
        return MISSING
    if case["unlike"]:
        return f"NO: {len(case['unlike'])} differ, first {case['unlike'][0]}"
    return f"yes, {_SAME[case['same']]}"


def _generation(generation: Mapping[str, Any]) -> Table:
    heads = [
        "picture", "observed through", "share of the panel", "ms per EIA", "fastest", "spread",
        "runs", "kernel times", "share of the whole EIA's time", "by fastest", "same pixels",
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
        for c in items(generation, "algorithms")
    ]
    count = len(items(generation, "viewpoints"))
    caption = f"Generation of the pixels that {count} viewpoints observe"
    return Table(f"{caption}: {generation['algorithm']}", heads, rows)


def _remarks(study: Mapping[str, Any]) -> list[str]:
    """Conditions of the measurements, in sentences."""
    return [
        f"Whole commands: medians of {study['rounds']} rounds. Each round runs all cases in turn. "
        "Times are from the start to the end of a process. The study uses its own result caches, "
        "which are empty at the start of a round. An uncounted round before compiles the kernels "
        "that numba and Dr.Jit store on disk. Only the time of the first run includes this "
        "compilation.",
        f"Validated: {study['algorithms'].replace(',', ', ')}, through {study['lens_model']} "
        f"lenses, from {', '.join(items(study, 'viewpoints'))}. Nine viewpoints: template only. "
        "Peak memory is that of a command's largest process.",
        *map(str, items(study, "notes")),
    ]


def _draw(study: Mapping[str, Any]) -> Any:
    """Plot the seconds of all runs, one row per command, with shares of the compared command."""
    cases = study["cases"]
    figure, (axis,) = new_figure(1, 1.2 + 0.32 * len(cases))
    figure.set_figwidth(8.4)
    compared = {case["beside"] for case in cases}
    for row, case in enumerate(cases):
        is_compared_with = case["name"] in compared
        colour = SOFT if is_compared_with else colour_of("template")
        seconds = case["times_s"]
        marks = {"color": colour, "alpha": 0.6, "markersize": 5, "zorder": 3}
        axis.plot(seconds, [row] * len(seconds), "o", **marks)
        if is_compared_with:
            rows = [r for r, other in enumerate(cases) if other["beside"] == case["name"]]
            ends = [min(rows) - 0.3, max(rows) + 0.3]
            axis.plot([case["median_s"]] * 2, ends, **LINES["floor"])
        else:
            _write_right_of(axis, f"{case['share']:.1%} of {case['beside']}", max(seconds), row)
    axis.set_xscale("log")
    axis.margins(x=0.2)
    style(axis, "Whole commands", "seconds, start to end", "")
    axis.set_yticks(range(len(cases)), [case["name"] for case in cases])
    axis.invert_yaxis()
    plain_ticks(axis)
    return figure


def _write_right_of(axis: Any, text: str, x: float, y: float) -> None:
    """Write text to the right of a mark, on white so that it is readable across a line."""
    background = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
    options = {"fontsize": 8, "color": SOFT, "va": "center", "bbox": background, "zorder": 2}
    axis.annotate(text, (x, y), (7, 0), textcoords="offset points", **options)
