"""Baselines: the verdict on a run against an accepted one, and accepting.

A finished run's folder holds `regression/candidate.json` and `.npz`. `accept` copies them, with a
reason and the date, to where baselines are kept; `judge` compares the run under way with one.
"""

from __future__ import annotations

import math
import re
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from inim.errors import BaselineError, UsageError
from inim.pipeline.differences import FOLDER, write_difference
from inim.pipeline.ledger import Ledger
from inim.pipeline.plan import Plan
from inim.pipeline.run_statistics import conditions_of
from inim.regression import (
    BASELINE,
    CANDIDATE,
    Evidence,
    Verdict,
    changed_circumstances,
    check_comparable,
    compare,
    drift,
    read_evidence,
    write_evidence,
)
from inim.report import Report

__all__ = [
    "accept",
    "check_conditions",
    "default_baseline",
    "judge",
    "load_baseline",
    "regression_data",
    "verdict_lines",
]

#: Where baselines are kept, below where the command is typed.
BASELINES = Path("reports/baselines")


def load_baseline(folder: Path) -> Evidence:
    """The baseline in a folder.

    Raises
    ------
    BaselineError
        There is none, or one of another schema.
    """
    return read_evidence(folder, BASELINE)


def check_conditions(plan: Plan, variant: str | None = None) -> None:
    """Raise `BaselineError` where the plan's baseline was made under other conditions."""
    baseline, where = plan.baseline, plan.request.baseline
    if baseline is None:
        return
    conditions = conditions_of(plan, variant)
    if variant is None:  # not known before a backend is chosen
        conditions["variant"] = baseline.conditions.get("variant")
    check_comparable(baseline, conditions, str(where))


def judge(job: Ledger, candidate: Evidence) -> dict[str, Any] | None:
    """Compare the run with its baseline: checks are added to the ledger, pictures written.

    Returns
    -------
    dict or None
        The `regression` of report.json; None without a baseline.
    """
    write_evidence(job.folder / FOLDER, CANDIDATE, candidate)
    baseline = job.plan.baseline
    if baseline is None:
        return None
    where = str(job.plan.request.baseline)
    verdicts = compare(baseline, candidate, where)
    job.checks += [one.as_check() for one in verdicts]
    failed = [v for v in verdicts if v.kind == "picture" and not v.passed]
    pictures = [
        name
        for name in baseline.pictures
        if any(v.name.startswith(f"{name}: ") for v in failed)
        and write_difference(job.folder, name, baseline, candidate)
    ]
    return regression_data(where, baseline, candidate, pictures)


def regression_data(
    where: str, baseline: Evidence, candidate: Evidence, pictures: list[str]
) -> dict[str, Any]:
    """What a report says of a comparison besides its checks."""
    return {
        "baseline": where,
        "reason": baseline.reason,
        "accepted": baseline.accepted,
        "circumstances": changed_circumstances(baseline, candidate),
        "drift": drift(baseline, candidate),
        "pictures": pictures,
    }


def default_baseline(title: str) -> Path:
    """Where the baseline of a scene is kept: a folder named after its title."""
    return BASELINES / (re.sub(r"[^\w.+-]+", "-", title).strip("-.") or "scene")


def accept(out: Path, reason: str, folder: Path | None = None) -> Path:
    """Make the run in `out` the baseline; its folder.

    Parameters
    ----------
    out : Path
        A report.
    reason : str
        Why, for whoever reads the history; it may not be empty.
    folder : Path, optional
        Where to; the baseline that the run was compared with, or `default_baseline`.

    Raises
    ------
    UsageError
        No reason, or a run that failed on its own: no baseline excuses that.
    BaselineError, FileError
        No report, or one without a candidate.
    """
    if not reason.strip():
        raise UsageError("--reason is empty; say in a line why this is the new baseline")
    report = Report.load(out)
    own = [c for c in report.data["verdict"]["checks"] if "kind" not in c and not c["passed"]]
    if own:
        raise UsageError(
            f"{out}: failed {len(own)} checks of its own ({own[0]['name']}); mend that first"
        )
    candidate = read_evidence(out / FOLDER, CANDIDATE)
    _check_whole(candidate, out)
    if folder is None:
        compared = report.data.get("regression")
        folder = Path(compared["baseline"]) if compared else default_baseline(report.data["title"])
    today = datetime.now(timezone.utc).isoformat(timespec="seconds")
    write_evidence(folder, BASELINE, candidate.accept(reason.strip(), today))
    return folder


def _check_whole(candidate: Evidence, out: Path) -> None:
    """A baseline with a hole in it would let everything pass, or nothing."""
    wrong = [
        f"{what} {name}"
        for what, scores in candidate.scores.items()
        for name, score in scores.items()
        if math.isnan(score.value)
    ]
    wrong += [n for n, found in candidate.pictures.items() if not np.isfinite(found.mean).all()]
    views = candidate.conditions.get("viewpoints") or {}
    missing = [v for v in views if f"truth/{v}" not in candidate.pictures]
    if wrong or missing or not views:
        what = f"{wrong[0]} is not a number" if wrong else f"no view {', '.join(missing)}".strip()
        raise BaselineError(f"{out}: cannot be a baseline: {what}; make the report anew")


def verdict_lines(verdicts: list[Verdict]) -> list[str]:
    """The verdicts as text, failed ones first."""
    return [v.line() for v in sorted(verdicts, key=lambda v: v.passed)]
