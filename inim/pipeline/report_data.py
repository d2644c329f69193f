"""The report of a run: the content of `report.json`."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import msgspec

from inim import metrics
from inim.documents.files import folder_files
from inim.documents.parts import Backend, Checks, DisplayRecord, EyePosition, origin
from inim.documents.report import (
    CapturedPicture,
    MetricSettings,
    NoiseFloor,
    Preview,
    ReferenceViews,
    ReportDocument,
    SceneRecord,
    Scoring,
    SkippedStep,
)
from inim.image.rgbd import RGBD
from inim.inspect.accuracy_limits import accuracy_warnings, lenses_beside_panel
from inim.metrics.headline import HEADLINE
from inim.pipeline.adaptive_sampling import Evaluation
from inim.pipeline.baseline import BaselineComparison
from inim.pipeline.stages.scoring import reported_scores
from inim.regression.comparison import kernel_times
from inim.report import Report

_VERSIONS = ("drjit", "flip-evaluator", "mitsuba", "numba", "numpy", "OpenEXR", "scikit-image")


def make_report(
    evaluation: Evaluation,
    noise_floor: NoiseFloor,
    times: Mapping[str, tuple[float, ...]],
    comparison: BaselineComparison,
    folder: Path,
) -> Report:
    """Collect the data of a report, whose images are in `folder`; the caller writes it.

    `times` are log ratios to the reference kernel, by generator.
    """
    plan, checks = evaluation.plan, [*evaluation.checks, *comparison.checks]
    algorithms, observer = evaluation.algorithms, evaluation.run.observer
    for name, ratios in times.items():
        algorithms[name] = msgspec.structs.replace(
            algorithms[name], yardsticks=kernel_times(ratios)
        )
    preview = None
    if plan.request.preview:
        command = replace(plan, request=replace(plan.request, preview=False)).command
        preview = Preview(full_command=shlex.join(["inim", "validate", *command]))
    settings = plan.settings
    # Lenses outside the panel, and displays beyond the tested accuracy limits.
    display_warnings = lenses_beside_panel(plan.display) + accuracy_warnings(
        plan.display,
        settings.lens_model,
        viewpoints=plan.viewpoints,
        pixel_mm=plan.display.capture_pixel_mm(settings.capture_pixels_per_pitch),
    )
    reference_views, reference_precision = reported_scores(evaluation.reference_scores)
    data = ReportDocument(
        title=settings.title or plan.request.scene.stem,
        **origin(
            shlex.join(["python", "-m", "inim.validate", *plan.command]),
            (*_VERSIONS, *metrics.perception_packages()),
        ),
        preview=preview,
        scene=msgspec.convert(
            {
                "path": str(plan.request.scene),
                "sha256": plan.file.sha256,
                "definitions": plan.definitions,
                "allow_folders": [str(folder) for folder in plan.request.allow_folders],
                **evaluation.scene,
            },
            SceneRecord,
        ),
        settings=settings,
        display=DisplayRecord.of(plan.display),
        misalign=settings.misalign,
        backend=Backend.of(evaluation.backend),
        lens_model=settings.lens_model,
        viewpoints=[EyePosition(name=v.name, position_mm=v.position_mm) for v in plan.viewpoints],
        rgbd=_describe_capture(evaluation.capture.rgbd),
        noise_floor=noise_floor,
        scoring=_scoring(),
        reference=ReferenceViews(views=reference_views, precision=reference_precision),
        algorithms=algorithms,
        timings=observer.timings
        | {
            "mitsuba_render": observer.render_seconds,
            "total": perf_counter() - observer.started,
        },
        skipped=[SkippedStep(**row) for row in evaluation.run.skipped.rows],
        warnings=[*display_warnings, *evaluation.warnings],
        verdict=Checks(passed=all(check.passed for check in checks), checks=checks),
        files=folder_files(folder, "report.html", "report.json", "junit.xml", "summary.md"),
        regression=comparison.data,
    )
    return Report(folder, data)


def _scoring() -> Scoring:
    return Scoring(
        headline=HEADLINE,
        relic_margin_px=metrics.RELIC_MARGIN_PX,
        metrics={
            metric.name: MetricSettings(border_px=metric.border, arguments=dict(metric.settings))
            for metric in metrics.all_metrics()
        },
    )


def _describe_capture(rgbd: RGBD) -> CapturedPicture:
    covered = rgbd.depth_mm[rgbd.covered]
    return CapturedPicture(
        rows=rgbd.shape[0],
        columns=rgbd.shape[1],
        pixel_mm=rgbd.pixel_mm,
        covered_fraction=float(rgbd.covered.mean()),
        depth_min_mm=float(covered.min()) if covered.size else None,
        depth_max_mm=float(covered.max()) if covered.size else None,
    )
