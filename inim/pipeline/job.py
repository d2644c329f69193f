"""Validation inside the worker: from a plan to a written report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from inim.cache import ResultCache, open_store
from inim.documents.report import ReportDocument
from inim.metrics import HEADLINE_WORDS
from inim.pipeline.output import Images
from inim.pipeline.plan import Plan, check_baseline
from inim.pipeline.stages.scene import Renderer
from inim.pipeline.stages.stage import Run
from inim.pipeline.validate import validate
from inim.process.observer import Observer
from inim.report import Report
from inim.report.labels import suggested_criteria
from inim.report.summary import score_lines
from inim.worker.output import publish


def run_job(plan: Plan, staging: Path, observer: Observer) -> bool:
    """Entry point in the worker: validate and publish the report; True if every check passed."""
    report = run(plan, staging, observer)
    publish(staging, plan.request.out)
    return report.passed


def run(plan: Plan, staging: Path, observer: Observer | None = None) -> Report:
    """Carry out a plan in this process and write its report into `staging`, an empty folder."""
    observer = observer or Observer()
    store = None if plan.request.no_skip else open_store()
    with observer.timed("start"):
        run, renderer, images = setup(plan, staging, observer, store)
        check_baseline(plan, renderer.backend.variant)
    report = validate(plan, renderer, images, run)
    _print_scores(observer, report.data)
    observer.stage("write report")
    report.write(run.cache)
    return report


def setup(
    plan: Plan, folder: Path, observer: Observer, store: Any = None
) -> tuple[Run, Renderer, Images]:
    """Create the run, the renderer and the images of a plan."""
    request = plan.request
    cache = ResultCache(store, str(request.scene.resolve()))
    renderer = Renderer(
        request.backend, observer, plan.rays_in_flight, not request.no_skip, plan.plugins
    )
    attributes = {"inim:scene_sha256": plan.file.sha256, "inim:seed": str(plan.settings.seed)}
    return Run(cache, observer), renderer, Images(folder, attributes, observer, cache)


def _print_scores(observer: Observer, data: ReportDocument) -> None:
    """Print the headline scores, the best algorithm, and suggested criteria."""
    best = data.best_algorithm
    for line in score_lines(data):
        observer.line(line)
    if best is not None and len(data.algorithms) > 1:
        observer.line(f"best: {best}, by its mean {HEADLINE_WORDS}")
    if data.verdict.word == "ran clean" and (criteria := suggested_criteria(data)):
        observer.line(
            f"no criteria set; for later runs: -D 'inim.min_ssim_to_reference={criteria}'"
        )
