"""Baselines: compare a run with an accepted one, and accept a run.

A finished run's folder holds `regression/candidate.json` and `.npz`. `accept` copies them to the
baseline folder, with a reason and the date. `compare_with_baseline` compares the current run with
a baseline.
"""

import math
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from inim.display import Display
from inim.image.files.image import write_png
from inim.pipeline.evaluation import Evaluation
from inim.pipeline.plan import Plan, inputs_of
from inim.pipeline.stages.generation import ReferenceOutput
from inim.pipeline.stages.scene import describe_files
from inim.pipeline.stages.scoring import Statistics
from inim.render.scene_files.file import SceneFile
from inim.report import Report
from inim.scores.document_parts import Check, Circumstances, Regression, utc_now
from inim.scores.metrics import foreign_identities
from inim.scores.regression.comparison import Comparison, changed_pixels, compare, tile_pictures
from inim.scores.regression.fingerprints import Fingerprint
from inim.scores.regression.run_statistics import (
    BASELINE,
    CANDIDATE,
    RunStatistics,
    read_statistics,
    write_statistics,
)
from inim.scores.regression.scores import ScoreEstimate
from inim.scores.regression.tiles import TileStatistics
from inim.system.backend import Backend
from inim.system.cache import code_digest, versions
from inim.system.errors import BaselineError, UsageError
from inim.system.process import machine
from inim.system.process.user_paths import user_text
from inim.system.version import __version__

#: Folder of a report for the candidate and, after a failure, images of the differences.
FOLDER = "regression"
#: Default folder of baselines, relative to the current folder.
BASELINES = Path("reports/baselines")


@dataclass(frozen=True)
class BaselineComparison:
    """Comparison of a run with its baseline; `data` is None without a baseline."""

    data: Regression | None = None
    checks: tuple[Check, ...] = ()


def compare_with_baseline(
    plan: Plan, folder: Path, candidate: RunStatistics, outputs: Mapping[str, ReferenceOutput]
) -> BaselineComparison:
    """Compare a run with its baseline, and write the candidate and images of the differences.

    `folder` is the report's; `outputs` are the generators' outputs for the reference input, by
    method.
    """
    write_statistics(folder / FOLDER, CANDIDATE, candidate)
    baseline, path = plan.baseline, user_text(plan.request.baseline)
    if baseline is None:
        return BaselineComparison()
    for name, output in outputs.items():
        old = baseline.fingerprints.get(name)
        new = candidate.fingerprints[name]
        _write_reference_difference(folder, name, output, old, new, plan.display)
    allow = plan.request.allow_changed_inputs
    comparison = compare(baseline, candidate, allow_changed_inputs=allow)
    pictures = [
        name
        for name in failed_pictures(comparison)
        if write_difference(folder, name, comparison.baseline, candidate)
    ]
    data = regression_data(path, baseline, comparison, pictures)
    return BaselineComparison(data, tuple(comparison.checks))


def _write_reference_difference(
    folder: Path,
    name: str,
    output: ReferenceOutput,
    old: Fingerprint | None,
    new: Fingerprint,
    display: Display,
) -> None:
    """Write a generator's EIA of the reference input and its changed pixels, if any."""
    if old is None or old.eia_sha256 == new.eia_sha256 or old.sample.shape != new.sample.shape:
        return
    target = folder / FOLDER / "fixed"
    write_png(target / f"{name}-candidate.png", np.nan_to_num(output.eia()))
    write_png(target / f"{name}-difference.png", changed_pixels(old, new, display))


def write_difference(
    folder: Path, name: str, baseline: RunStatistics, candidate: RunStatistics
) -> bool:
    """Write the baseline's tiles, the difference and the candidate; False if shapes differ."""
    old, new = baseline.pictures.get(name), candidate.pictures.get(name)
    if old is None or new is None or (new.shape, new.tile) != (old.shape, old.tile):
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
    path: str, baseline: RunStatistics, comparison: Comparison, pictures: list[str]
) -> Regression:
    """Results of a comparison, without its checks."""
    return Regression(
        baseline=path,
        reason=baseline.reason,
        accepted=baseline.accepted,
        verdict=comparison.verdict,
        inputs=comparison.inputs,
        circumstances=comparison.circumstances,
        not_compared=comparison.not_compared,
        pictures=pictures,
    )


def default_baseline(title: str) -> Path:
    """Default baseline folder of a scene, named after the scene's title."""
    return BASELINES / (re.sub(r"[^\w.+-]+", "-", title).strip("-.") or "scene")


def read_run(out: Path) -> tuple[Report, RunStatistics]:
    """Read a report and its statistics; raises `FileError` or `BaselineError`."""
    return Report.load(out), read_statistics(out / FOLDER, CANDIDATE)


def accept(out: Path, reason: str, folder: Path | None = None) -> Path:
    """Make a run the baseline and return the baseline's folder.

    The default `folder` is that of the baseline that the run was compared with, else
    `default_baseline`. Raises `UsageError` if the reason is empty, or if the run is a preview or
    failed a check without a baseline; `BaselineError` or `FileError` if the report or its
    statistics are missing or damaged.
    """
    report, candidate = read_run(out)
    if report.data.preview is not None:
        raise UsageError(
            f"{out}: is a preview with too few samples for a baseline; make the full report: "
            f"{report.data.preview.full_command}"
        )
    failed = [c for c in report.data.verdict.checks if c.kind is None and not c.passed]
    if failed:
        raise UsageError(
            f"{out}: failed {len(failed)} checks without a baseline ({failed[0].name}); fix "
            "these first"
        )
    _check_complete(candidate, out)
    if not reason.strip():
        raise UsageError("--reason is missing; give the reason for the new baseline in one line")
    if folder is None:
        regression = report.data.regression
        folder = Path(regression.baseline) if regression else default_baseline(report.data.title)
        if regression and not folder.is_dir():
            raise UsageError(
                f"{out}: its baseline {folder} is not there, seen from the current folder; go to "
                "the folder of that run, or give -o FOLDER"
            )
    accepted = replace(candidate, reason=reason.strip(), accepted=utc_now())
    write_statistics(folder, BASELINE, accepted)
    return folder


def _check_complete(candidate: RunStatistics, out: Path) -> None:
    """Raise `BaselineError` unless all scores and views of a candidate are valid."""
    invalid = [
        f"{view} {name}"
        for view, scores in candidate.scores.items()
        for name, score in scores.items()
        if math.isnan(score.plain)
    ]
    invalid += [n for n, tiles in candidate.pictures.items() if not np.isfinite(tiles.mean).all()]
    views = candidate.inputs.viewpoints
    missing = [v for v in views if f"truth/{v}" not in candidate.pictures]
    if invalid or missing or not views:
        problem = f"{invalid[0]} is not a number" if invalid else f"no view {', '.join(missing)}"
        raise BaselineError(f"{out}: cannot be a baseline: {problem.strip()}; make a new report")


def failed_pictures(comparison: Comparison) -> list[str]:
    """Names of the images that changed."""
    failed = [c for c in comparison.checks if c.kind == "picture" and not c.passed]
    return [check.name.partition(": ")[0] for check in failed]


_VERSIONS = ("drjit", "mitsuba", "numba", "numpy", "scikit-image")
_SAMPLING = ("capture_spp", "eia_spp", "view_spp", "reconstruction_spp", "seed")


def collect_statistics(evaluation: Evaluation, truth: Statistics) -> RunStatistics:
    """Collect all statistics of a run."""
    plan = evaluation.plan
    facts = {}
    if isinstance(plan.file, SceneFile):
        facts = describe_files(plan.file, run=evaluation.run)
    pictures: dict[str, TileStatistics] = {}
    scores: dict[str, dict[str, ScoreEstimate]] = {}
    fingerprints: dict[str, Fingerprint] = {}
    for part in (truth, *(result.statistics for result in evaluation.results.values())):
        pictures |= part.pictures
        for name in {**part.scores, **part.light}:
            scores[name] = part.scores.get(name, {}) | part.light.get(name, {})
        fingerprints |= part.fingerprints
    return RunStatistics(
        inputs_of(plan, evaluation.backend.variant, facts),
        _circumstances(plan, evaluation.backend),
        pictures,
        scores,
        fingerprints,
    )


def _circumstances(plan: Plan, backend: Backend) -> Circumstances:
    packages: dict[str, Any] = {k.replace("-", "_"): v for k, v in versions(_VERSIONS).items()}
    return Circumstances(
        title=plan.settings.title or plan.request.scene.stem,
        created=utc_now(),
        inim=__version__,
        code=code_digest(""),
        packages={
            **{name: _words(state) for name, state in plan.algorithm_packages.items()},
            **{name: _words(state) for name, state in foreign_identities().items()},
            **{plugin.name: plugin.sha256 for plugin in plan.plugins},
        },
        **{name.replace("-", "_"): version for name, version in packages.items()},
        libllvm=backend.libllvm_version,
        device=backend.device,
        processor=machine.cpu_model(),
        threads=machine.cpu_count(),
        **{name: getattr(plan.settings, name) for name in _SAMPLING},
    )


def _words(identity: Mapping[str, str]) -> str:
    """Version and digest of a package."""
    return " ".join(filter(None, (identity.get("version"), identity.get("sha256", "")[:12])))
