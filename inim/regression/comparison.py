"""A candidate against a baseline: every verdict there is, or the reason why there can be none."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from inim.errors import BaselineError
from inim.regression.pictures import compare_noise, compare_pictures
from inim.regression.reference_eia import compare_fingerprints
from inim.regression.run_statistics import Evidence, differing_conditions
from inim.regression.scores import compare_scores
from inim.regression.times import compare_times
from inim.regression.verdict import Verdict

__all__ = ["changed_circumstances", "check_comparable", "check_times", "compare", "drift"]

#: Rendered without any generator: their noise is that of the ground truth.
TRUTH = "truth/"
_TIME_CONDITIONS = ("processor", "threads")
_ALWAYS_NEW = ("created",)


def check_comparable(baseline: Evidence, conditions: Mapping[str, Any], where: str) -> None:
    """Raise `BaselineError` unless a run under these conditions can be compared.

    Parameters
    ----------
    baseline : Evidence
    conditions : mapping
        Of the candidate; known before anything is rendered.
    where : str
        The baseline's place, for the message.
    """
    reasons = differing_conditions(baseline.conditions, conditions)
    if reasons:
        more = f" (and {len(reasons) - 3} more)" if len(reasons) > 3 else ""
        raise BaselineError(
            f"{where}: made under other conditions: {'; '.join(reasons[:3])}{more}; accept a "
            "baseline for these with inim baseline accept OUT --reason TEXT"
        )
    truth = [name for name in baseline.pictures if name.startswith(TRUTH)]
    if not (truth and baseline.scores):
        raise BaselineError(f"{where}: holds no picture or no score to compare; accept it anew")


def check_times(baseline: Evidence, circumstances: Mapping[str, Any], where: str) -> None:
    """Raise `BaselineError` unless times of a run under these circumstances can be compared.

    A ratio to the yardstick takes out how fast a machine is, not what it is good at: another
    processor, or another number of threads, has other ratios.
    """
    if not baseline.times:
        raise BaselineError(
            f"{where}: has no times; accept one of a run with --time, or leave --time out"
        )
    for name in _TIME_CONDITIONS:
        old, new = baseline.circumstances.get(name), circumstances.get(name)
        if old != new:
            raise BaselineError(
                f"{where}: its times are of {name} {old!r}, not {new!r}; accept a baseline here, "
                "or leave --time out"
            )


def compare(baseline: Evidence, candidate: Evidence, where: str) -> list[Verdict]:
    """Verdicts on pictures, noise, scores, fixed pictures and, where the candidate has them, times.

    Parameters
    ----------
    baseline, candidate : Evidence
    where : str
        The baseline's place, for messages.

    Raises
    ------
    BaselineError
        The two were made under conditions that differ.
    """
    check_comparable(baseline, candidate.conditions, where)
    truth_old, truth_new = (_truth(side) for side in (baseline, candidate))
    noise = compare_noise(truth_old, truth_new)
    verdicts = [
        *compare_pictures(baseline.pictures, candidate.pictures),
        noise,
        *compare_scores(baseline.scores, candidate.scores, noise.value),
        *compare_fingerprints(baseline.fingerprints, candidate.fingerprints),
    ]
    if candidate.times:
        check_times(baseline, candidate.circumstances, where)
        verdicts += compare_times(baseline.times, candidate.times)
    return verdicts


def _truth(side: Evidence) -> dict[str, Any]:
    return {name: found for name, found in side.pictures.items() if name.startswith(TRUTH)}


def changed_circumstances(baseline: Evidence, candidate: Evidence) -> list[dict[str, Any]]:
    """What else differs, without a verdict: versions, samples, seed, machine."""
    names = [*baseline.circumstances, *candidate.circumstances]
    rows = []
    for name in dict.fromkeys(names):
        old, new = baseline.circumstances.get(name), candidate.circumstances.get(name)
        if old != new and name not in _ALWAYS_NEW:
            rows.append({"name": name, "baseline": old, "candidate": new})
    return rows


def drift(baseline: Evidence, candidate: Evidence) -> list[dict[str, Any]]:
    """Every reported number of both runs, by what was scored and the score's name."""
    rows = []
    for what, scores in candidate.reported.items():
        old = baseline.reported.get(what, {})
        for name, value in scores.items():
            known = value is not None and old.get(name) is not None
            change = float(value) - float(old[name]) if known else None  # type: ignore[arg-type]
            if change is not None and not math.isfinite(change):
                change = None
            rows.append(
                {
                    "what": what,
                    "score": name,
                    "baseline": old.get(name),
                    "candidate": value,
                    "change": change,
                }
            )
    return rows
