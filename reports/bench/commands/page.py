"""Page of the study of whole commands: tables and a plot from bench.json."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from inim.report.labels import MISSING, is_number, number, per_cent
from inim.report.study import PagePart, Table
from reports.bench.study import RUN_PARTS
from reports.study import Results, entry, table

_MIB = 2**20
_SAME = {
    "everything": "all except times",
    "scores": "common scores",
    "views": "common scores of views",
}


def page(results: Results) -> tuple[list[str], list[PagePart]]:
    """Conditions, and tables and plot of all commands."""
    study = results["commands"]
    lead = "Time of a validation with an empty result cache and with cached results."
    generation = study["generation"]
    observed = {
        "observed through": lambda c: c["name"],
        "share of the panel": lambda c: per_cent(c["observed_share"], 1),
    }
    shares = {c["name"]: c for c in generation["algorithms"] if c["observed_share"] < 1}
    caption = f"Panel pixels that {len(generation['viewpoints'])} viewpoints observe"
    tables = [_commands(study), _parts(study), table(caption, shares.values(), observed)]
    part = PagePart("commands", "Whole commands", lead, tables)
    return _remarks(study), [part]


def _commands(study: Mapping[str, Any]) -> Table:
    """Times of all commands."""
    columns = {
        "command": lambda c: c["name"],
        "in the cache": lambda c: c["finds"],
        "seconds": lambda c: number(c["median_s"], 2),
        "fastest": lambda c: number(c["min_s"], 2),
        "spread": lambda c: f"± {per_cent(c['spread'], 1)}",
        "compared with": lambda c: MISSING if c["beside"] == c["name"] else c["beside"],
        "share": lambda c: per_cent(c["share"], 1),
        "by fastest": lambda c: per_cent(c["share_min"], 1),
        "peak MiB": lambda c: number(c["peak_bytes"] / _MIB, 0),
        "samples traced": _samples,
        "share of samples": lambda c: (
            per_cent(c["traced"] / c["whole"], 1) if c["whole"] else MISSING
        ),
        "same results": _same,
    }
    return table(f"Whole commands on {study['title']}, medians", study["cases"], columns)


def _parts(study: Mapping[str, Any]) -> Table:
    """Seconds of the parts of the last run of each command."""
    columns = {
        "command": lambda c: c["name"],
        **{part: entry("parts", part, text=partial(number, digits=2)) for part in RUN_PARTS},
        "start, files and report": lambda c: number(c["times_s"][-1] - sum(c["parts"].values()), 2),
    }
    cases = [case for case in study["cases"] if case.get("parts")]
    return table("Seconds of the parts of a run", cases, columns)


def _samples(case: Mapping[str, Any]) -> str:
    traced = case["traced"]
    return f"{number(traced / 1e6, 2)} million" if is_number(traced) else MISSING


def _same(case: Mapping[str, Any]) -> str:
    if case["unlike"] is None:
        return MISSING
    if case["unlike"]:
        return f"NO: {len(case['unlike'])} differ, first {case['unlike'][0]}"
    return f"yes, {_SAME[case['same']]}"


def _remarks(study: Mapping[str, Any]) -> list[str]:
    """Conditions of the measurements, in sentences."""
    return [
        f"Whole commands: medians of {study['rounds']} rounds. Each round runs all cases in turn. "
        "Times are from the start to the end of a process. The study uses its own result caches, "
        "which are empty at the start of a round. An uncounted round before compiles the kernels "
        "that numba and Dr.Jit store on disk. Only the time of the first run includes this "
        "compilation.",
        f"Validated: {study['algorithms'].replace(',', ', ')}, through {study['lens_model']} "
        f"lenses, from {', '.join(study['viewpoints'])}. Nine viewpoints: template only. "
        "Peak memory is that of a command's largest process.",
        *study["notes"],
    ]
