"""Baselines: the verdict on a run against an accepted one, and accepting.

A finished run's folder holds `regression/candidate.json` and `.npz`. `accept` copies them, with a
reason and the date, to where baselines are kept; `judge` compares the run under way with one.
"""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from inim.backend import Backend
from inim.backend.choice import versions
from inim.display import Display
from inim.documents.parts import Check, Circumstances, Regression
from inim.documents.report import AlgorithmResult
from inim.errors import BaselineError, UsageError
from inim.files.image import write_png
from inim.metrics import perception_packages
from inim.pipeline.adaptive_sampling import Measured
from inim.pipeline.plan import Plan, conditions_of
from inim.pipeline.stages.evaluate import Statistics
from inim.pipeline.stages.generate import Reference
from inim.process import machine
from inim.regression import (
    BASELINE,
    CANDIDATE,
    Fingerprint,
    RunStatistics,
    ScoreEstimate,
    TileStatistics,
    Verdict,
    changed_circumstances,
    compare,
    drift,
    read_statistics,
    write_statistics,
)
from inim.regression.comparison import changed_pixels, tile_pictures
from inim.report import Report
from inim.version import __version__

#: Of a report: the candidate and, where it fails, images of the differences.
FOLDER = "regression"
#: Where baselines are kept, below where the command is typed.
BASELINES = Path("reports/baselines")


@dataclass(frozen=True)
class Comparison:
    """A run beside its baseline.

    Attributes
    ----------
    data : Regression, optional
        None without a baseline.
    checks : tuple of Check
        Rows of the verdict.
    """

    data: Regression | None = None
    checks: tuple[Check, ...] = ()


def judge(
    plan: Plan, folder: Path, candidate: RunStatistics, references: Mapping[str, Reference]
) -> Comparison:
    """Compare a run with its baseline; images of what changed are written.

    Parameters
    ----------
    plan : Plan
    folder : Path
        Of the report.
    candidate : RunStatistics
        What the run leaves behind.
    references : mapping of str to Reference
        What the generators make of the reference input, by method.
    """
    write_statistics(folder / FOLDER, CANDIDATE, candidate)
    baseline, where = plan.baseline, str(plan.request.baseline)
    if baseline is None:
        return Comparison()
    for name, reference in references.items():
        old = baseline.fingerprints.get(name)
        _keep_changed(folder, name, reference, candidate.fingerprints[name], old, plan.display)
    verdicts = compare(baseline, candidate, where)
    failed = [v for v in verdicts if v.kind == "picture" and not v.passed]
    pictures = [
        name
        for name in baseline.pictures
        if any(v.name.startswith(f"{name}: ") for v in failed)
        and write_difference(folder, name, baseline, candidate)
    ]
    data = regression_data(where, baseline, candidate, pictures)
    return Comparison(data, tuple(one.as_check() for one in verdicts))


def _keep_changed(
    folder: Path,
    name: str,
    reference: Reference,
    new: Fingerprint,
    old: Fingerprint | None,
    display: Display,
) -> None:
    """The changed EIA of the reference input, if it has changed, and where."""
    if old is None or old.eia_sha256 == new.eia_sha256 or old.sample.shape != new.sample.shape:
        return
    place = folder / FOLDER / "fixed"
    write_png(place / f"{name}-candidate.png", np.nan_to_num(reference.eia()))
    write_png(place / f"{name}-difference.png", changed_pixels(old, new, display))


def write_difference(
    folder: Path, name: str, baseline: RunStatistics, candidate: RunStatistics
) -> bool:
    """The candidate's picture beside the baseline's tiles and what changed; whether it could be."""
    old, new = baseline.pictures[name], candidate.pictures.get(name)
    if new is None or (new.shape, new.tile) != (old.shape, old.tile):
        return False
    before, change = tile_pictures(old, new)
    target = folder / FOLDER / name
    write_png(target.with_name(f"{target.name}-baseline.png"), before)
    write_png(target.with_name(f"{target.name}-difference.png"), change)
    source = folder / f"{name}.png"
    if source.is_file():
        shutil.copyfile(source, target.with_name(f"{target.name}-candidate.png"))
    return True


def regression_data(
    where: str, baseline: RunStatistics, candidate: RunStatistics, pictures: list[str]
) -> Regression:
    """Results of a comparison, except its checks."""
    return Regression(
        baseline=where,
        reason=baseline.reason,
        accepted=baseline.accepted,
        circumstances=changed_circumstances(baseline, candidate),
        drift=drift(baseline, candidate),
        pictures=pictures,
    )


def default_baseline(title: str) -> Path:
    """Where the baseline of a scene is kept: a folder named after its title."""
    return BASELINES / (re.sub(r"[^\w.+-]+", "-", title).strip("-.") or "scene")


def read_run(out: Path) -> tuple[Report, RunStatistics]:
    """Read a report and its statistics.

    Raises
    ------
    FileError, BaselineError
        One of the two is missing or damaged.
    """
    return Report.load(out), read_statistics(out / FOLDER, CANDIDATE)


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
        No reason, a preview, or a run that failed on its own: no baseline excuses that.
    BaselineError, FileError
        No report, or one without a candidate.
    """
    if not reason.strip():
        raise UsageError("--reason is empty; say in a line why this is the new baseline")
    report, candidate = read_run(out)
    if report.data.preview is not None:
        raise UsageError(
            f"{out}: is a preview, of too few samples to compare with; make the full report: "
            f"{report.data.preview.full_command}"
        )
    own = [c for c in report.data.verdict.checks if c.kind is None and not c.passed]
    if own:
        raise UsageError(
            f"{out}: failed {len(own)} checks of its own ({own[0].name}); mend that first"
        )
    _check_whole(candidate, out)
    if folder is None:
        compared = report.data.regression
        folder = Path(compared.baseline) if compared else default_baseline(report.data.title)
    today = datetime.now(timezone.utc).isoformat(timespec="seconds")
    write_statistics(folder, BASELINE, candidate.accept(reason.strip(), today))
    return folder


def _check_whole(candidate: RunStatistics, out: Path) -> None:
    """A baseline with a hole in it would let everything pass, or nothing."""
    wrong = [
        f"{what} {name}"
        for what, scores in candidate.scores.items()
        for name, score in scores.items()
        if math.isnan(score.value)
    ]
    wrong += [n for n, found in candidate.pictures.items() if not np.isfinite(found.mean).all()]
    views = candidate.conditions.viewpoints
    missing = [v for v in views if f"truth/{v}" not in candidate.pictures]
    if wrong or missing or not views:
        what = f"{wrong[0]} is not a number" if wrong else f"no view {', '.join(missing)}".strip()
        raise BaselineError(f"{out}: cannot be a baseline: {what}; make the report anew")


def verdict_lines(verdicts: list[Verdict]) -> list[str]:
    """The verdicts as text, failed ones first."""
    return [v.line() for v in sorted(verdicts, key=lambda v: v.passed)]


_VERSIONS = ("drjit", "mitsuba", "numba", "numpy", "scikit-image")
_SAMPLING = ("capture_spp", "eia_spp", "view_spp", "reconstruction_spp", "seed")


def run_statistics(
    found: Measured, truth: Statistics, times: Mapping[str, tuple[float, ...]]
) -> RunStatistics:
    """All that a run leaves behind.

    Parameters
    ----------
    found : Measured
    truth : Statistics
        Of the ground truth.
    times : mapping of str to tuple of float
        See `inim.regression.log_ratios`.
    """
    pictures: dict[str, TileStatistics] = {}
    scores: dict[str, dict[str, ScoreEstimate]] = {}
    prints: dict[str, Fingerprint] = {}
    for one in (truth, *(result.statistics for result in found.results.values())):
        pictures |= one.pictures
        scores |= one.scores
        prints |= one.fingerprints
    return RunStatistics(
        conditions_of(found.plan, found.backend.variant),
        _circumstances(found.plan, found.backend),
        pictures,
        scores,
        prints,
        dict(times),
        _reported(found.algorithms),
    )


def _circumstances(plan: Plan, backend: Backend) -> Circumstances:
    packages: dict[str, Any] = {**versions((*_VERSIONS, *perception_packages()))}
    return Circumstances(
        title=plan.settings.title or plan.request.scene.stem,
        created=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        inim=__version__,
        **{name.replace("-", "_"): version for name, version in packages.items()},
        libllvm=backend.libllvm_version,
        device=backend.device,
        processor=machine.cpu_model(),
        threads=machine.cpu_count(),
        **{name: getattr(plan.settings, name) for name in _SAMPLING},
    )


def _reported(algorithms: Mapping[str, AlgorithmResult]) -> dict[str, dict[str, float | None]]:
    """Every score of a report, by method and by method and viewpoint."""
    rows: dict[str, dict[str, float | None]] = {}
    for name, result in algorithms.items():
        rows[name] = {f"eia {key}": _finite(value) for key, value in result.eia.items()}
        for view, scores in result.views.items():
            rows[f"{name}/{view}"] = {key: _finite(value) for key, value in scores.items()}
    return rows


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
