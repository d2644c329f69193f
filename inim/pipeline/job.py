"""Validation inside the worker: from a plan to a written report."""

from pathlib import Path
from typing import Any

import numpy as np

from inim.pipeline.output import Images
from inim.pipeline.plan import Plan
from inim.pipeline.stages.scene import Renderer
from inim.pipeline.stages.stage import Run
from inim.pipeline.validate import validate
from inim.report import Report
from inim.report.document import ReportDocument
from inim.report.labels import suggested_criteria
from inim.report.summary import score_lines
from inim.scores.metrics import HEADLINE_WORDS
from inim.system.cache import ResultCache, open_store
from inim.system.document import write_document
from inim.system.errors import naming
from inim.system.process.atomic_file import file_errors
from inim.system.process.observer import Observer


def run_job(plan: Plan, staging: Path, observer: Observer) -> bool:
    """Entry point in the worker: validate and write the report; True if every check passed.

    An unchanged run writes its last report again, from the cache.
    """
    cache = open_cache(plan)
    with naming(plan.request.scene):
        if plan.is_reproducible:
            report = _run_or_reuse(plan, staging, observer, cache)
        else:
            report = run(plan, staging, observer, cache)
    return report.passed


def run_data_job(plan: Plan, staging: Path, observer: Observer) -> bool:
    """Entry point in the worker: validate and write the data of the report alone."""
    with naming(plan.request.scene):
        report = run(plan, staging, observer, data_only=True)
    write_document(staging / "report.json", report.data)
    return report.passed


def _run_or_reuse(plan: Plan, staging: Path, observer: Observer, cache: ResultCache) -> Report:
    """Carry out a plan, or write the files of its last report and print the scores."""

    def make_files() -> dict[str, np.ndarray]:
        run(plan, staging, observer, cache)
        paths = (path for path in staging.rglob("*") if path.is_file())
        return {str(p.relative_to(staging)): np.fromfile(p, np.uint8) for p in paths}

    def inputs() -> dict[str, Any]:
        return {"command": plan.command, **plan.cache_key(_renderer(plan, observer))}

    files, reason = cache.find_or_make("report", inputs, make_files, explain=False)
    if reason is not None:
        return Report.load(staging)
    for name, content in files.items():
        path = staging / name
        with file_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            content.tofile(path)
    report = Report.load(staging)
    _print_scores(observer, report.data)
    created = report.data.created
    observer.line(f"nothing has changed since the report of {created}; --no-skip repeats it")
    return report


def run(
    plan: Plan,
    staging: Path,
    observer: Observer | None = None,
    cache: ResultCache | None = None,
    *,
    data_only: bool = False,
) -> Report:
    """Carry out a plan in this process and write its report into `staging`, an empty folder.

    With `data_only`, write neither pictures nor pages, only the statistics.
    """
    observer = observer or Observer()
    with observer.timed("start"):
        run, renderer, images = setup(
            plan, staging, observer, cache or open_cache(plan), data_only=data_only
        )
    with images.thread, run.ahead:
        report = validate(plan, renderer, images, run)
    _print_scores(observer, report.data)
    if not data_only:
        observer.stage("write report")
        report.write(run.cache, plan.request.out)
    return report


def open_cache(plan: Plan) -> ResultCache:
    """The result cache of a plan's scene; without a store if the plan skips nothing."""
    store = None if plan.request.no_skip else open_store()
    return ResultCache(store, str(plan.request.scene.resolve()))


def _renderer(plan: Plan, observer: Observer) -> Renderer:
    request = plan.request
    return Renderer(
        request.backend, observer, plan.rays_in_flight, not request.no_skip, plan.plugins
    )


def setup(
    plan: Plan,
    folder: Path,
    observer: Observer,
    cache: ResultCache | None = None,
    *,
    data_only: bool = False,
) -> tuple[Run, Renderer, Images]:
    """Create the run, the renderer and the images of a plan; by default without a cache.

    With `data_only`, the images are not written.
    """
    cache = cache or ResultCache()
    attributes = {"inim:scene_sha256": plan.file.sha256, "inim:seed": str(plan.settings.seed)}
    images = Images(folder, attributes, observer, cache, data_only=data_only)
    return Run(cache, observer), _renderer(plan, observer), images


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
