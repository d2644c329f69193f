"""Comparison of two validations' reports, and their numbers of traced samples."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

#: Compared values: the report without the run's own data; scores in both reports; scores of views
#: in both reports.
EVERYTHING, SCORES, VIEWS = "everything", "scores", "views"
# Data of the run, not of its result.
_RUN_KEYS = frozenset({"created", "command", "skipped", "timings", "seconds"})
_SCORE_KEYS = ("noise_floor", "reference", "algorithms")
_SAMPLES = re.compile(r"([\d.]+(?:e[+-]?\d+)?)( million)? samples")

Path = tuple[str, ...]


def differences(report: Mapping[str, Any], other: Mapping[str, Any], extent: str) -> list[str]:
    """Paths of the compared values that differ between two reports.

    The reports are contents of report.json; `extent` is `EVERYTHING`, `SCORES` or `VIEWS`. A value
    that is in only one report is a difference for `EVERYTHING` and is ignored otherwise.
    """
    values, other_values = dict(_values(report)), dict(_values(other))
    paths = values.keys() | other_values.keys()
    if extent != EVERYTHING:
        paths = {path for path in values.keys() & other_values.keys() if path[0] in _SCORE_KEYS}
    if extent == VIEWS:
        paths = {path for path in paths if "views" in path}
    if not paths:
        return ["nothing to compare"]
    missing = object()
    return sorted(
        "/".join(path)
        for path in paths
        if values.get(path, missing) != other_values.get(path, missing)
    )


def _values(data: Any, path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Paths and values of all leaves, without the run's own data."""
    if not isinstance(data, Mapping):
        yield path, data
        return
    for key, value in data.items():
        if key not in _RUN_KEYS:
            yield from _values(value, (*path, key))


def samples_of(
    rows: Sequence[Mapping[str, str]], uncached: Sequence[Mapping[str, str]]
) -> tuple[float, float]:
    """Traced samples of a run, and the samples of a run that skips nothing.

    `rows` are `skipped` of the run's report; `uncached` are those of a run with an empty cache,
    which contain the samples of all pictures.
    """
    sizes = {name: sum(counts) for name, counts in _pictures(uncached).items() if counts}
    traced = total = 0.0
    for name, counts in _pictures(rows).items():
        traced += counts[0] if counts else 0.0
        total += sum(counts) if counts else sizes.get(name, 0.0)
    return traced, total


def _pictures(rows: Sequence[Mapping[str, str]]) -> dict[str, tuple[float, float] | None]:
    """Traced and skipped samples of each picture; None for a picture from the cache."""
    pictures: dict[str, tuple[float, float] | None] = {}
    for row in rows:
        kind, colon, names = row["step"].partition(": ")
        traced, skipped = _count(row["performed"]), _count(row["skipped"])
        counts = None if traced is None or skipped is None else (traced, skipped)
        # `inim.pipeline.memo` lists pictures with equal counts in one row.
        for name in names.split(", ") if colon else [""]:
            pictures[f"{kind}: {name}" if colon else kind] = counts
    return pictures


def _count(text: str) -> float | None:
    """Number of samples in a text such as "1.5 million samples traced"."""
    match = _SAMPLES.match(text)
    return None if match is None else float(match[1]) * (1e6 if match[2] else 1)
