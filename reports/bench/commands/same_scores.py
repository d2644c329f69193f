"""Whether two validations say the same, and what they traced for it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

#: What has to be the same: the report but for what tells of the run itself; the scores of what
#: both have; of those, the ones of views.
EVERYTHING, SCORES, VIEWS = "everything", "scores", "views"
# Of the run itself, not of its result.
_OF_THE_RUN = frozenset({"created", "command", "skipped", "timings", "seconds"})
_OF_SCORES = ("noise_floor", "reference", "algorithms")
_SAMPLES = re.compile(r"([\d.]+(?:e[+-]?\d+)?)( million)? samples")

Path = tuple[str, ...]


def unlike(report: Mapping[str, Any], other: Mapping[str, Any], extent: str) -> list[str]:
    """Paths of the values in which two reports differ, where they should not.

    Parameters
    ----------
    report, other : mapping
        Contents of two report.json.
    extent : str
        `EVERYTHING`, `SCORES` or `VIEWS`. Values that only one of them has differ in the first,
        and are not compared in the others.
    """
    mine, others = dict(_values(report)), dict(_values(other))
    paths = mine.keys() | others.keys()
    if extent != EVERYTHING:
        paths = {path for path in mine.keys() & others.keys() if path[0] in _OF_SCORES}
    if extent == VIEWS:
        paths = {path for path in paths if "views" in path}
    if not paths:
        return ["nothing to compare"]
    absent = object()
    return sorted(
        "/".join(path) for path in paths if mine.get(path, absent) != others.get(path, absent)
    )


def _values(data: Any, path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """All that is no mapping, by path, without what tells of the run itself."""
    if not isinstance(data, Mapping):
        yield path, data
        return
    for key, value in data.items():
        if key not in _OF_THE_RUN:
            yield from _values(value, (*path, key))


def samples_of(
    rows: Sequence[Mapping[str, str]], known: Sequence[Mapping[str, str]]
) -> tuple[float, float]:
    """Samples that a run traced, and those it would have without leaving anything out.

    Parameters
    ----------
    rows : sequence of mapping
        `skipped` of its report.
    known : sequence of mapping
        That of a run which read nothing from a store: tells the samples of what this one did.
    """
    sizes = {name: sum(both) for name, both in _products(known).items() if both is not None}
    traced = whole = 0.0
    for name, both in _products(rows).items():
        traced += 0.0 if both is None else both[0]
        whole += sizes.get(name, 0.0) if both is None else sum(both)
    return traced, whole


def _products(rows: Sequence[Mapping[str, str]]) -> dict[str, tuple[float, float] | None]:
    """Samples traced and left out of each picture; None of one that was read from the store."""
    found: dict[str, tuple[float, float] | None] = {}
    for row in rows:
        kind, colon, names = row["step"].partition(": ")
        traced, left_out = _count(row["performed"]), _count(row["skipped"])
        both = None if traced is None or left_out is None else (traced, left_out)
        # Alike ones are one row, as `inim.pipeline.memo` tells them.
        for name in names.split(", ") if colon else [""]:
            found[f"{kind}: {name}" if colon else kind] = both
    return found


def _count(words: str) -> float | None:
    found = _SAMPLES.match(words)
    return None if found is None else float(found[1]) * (1e6 if found[2] else 1)
