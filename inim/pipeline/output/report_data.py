"""The report of a run: the content of `report.json`, schema `inim.report/1`."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import asdict, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from inim import metrics
from inim.backend.provenance import backend_data, versions
from inim.image.rgbd import RGBD
from inim.inspect.accuracy_limits import accuracy_warnings, lenses_beside_panel
from inim.metrics.headline import HEADLINE
from inim.pipeline.measured import Measured
from inim.pipeline.output.baseline import Comparison
from inim.pipeline.plan import Plan
from inim.pipeline.stages.evaluate import scores_data
from inim.regression import yardsticks
from inim.report import SCHEMA, Report
from inim.version import __version__

_VERSIONS = ("drjit", "flip-evaluator", "mitsuba", "numba", "numpy", "OpenEXR", "scikit-image")


def report_of(
    found: Measured,
    noise_floor: Mapping[str, Any],
    times: Mapping[str, tuple[float, ...]],
    comparison: Comparison,
    folder: Path,
) -> Report:
    """The report, all but the run's total time; nothing is written yet.

    Parameters
    ----------
    found : Measured
    noise_floor : mapping
        Scores of the ground truth against itself.
    times : mapping of str to tuple of float
        Log ratios to the reference kernel, by generator.
    comparison : Comparison
        With the baseline.
    folder : Path
        Where the images lie.
    """
    plan, checks = found.plan, [*found.checks, *comparison.checks]
    algorithms = found.algorithms
    for name, ratios in times.items():
        algorithms[name] = algorithms[name] | {"yardsticks": yardsticks(ratios)}
    data = {
        "schema": SCHEMA,
        "title": plan.settings.title or plan.request.scene.stem,
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "inim_version": __version__,
        "versions": versions((*_VERSIONS, *metrics.perception_packages())),
        "command": shlex.join(["python", "-m", "inim.validate", *plan.command]),
        "scene": {
            "path": str(plan.request.scene),
            "sha256": plan.file.sha256,
            "definitions": plan.definitions,
            "allow_folders": [str(folder) for folder in plan.request.allow_folders],
            **found.scene,
        },
        "settings": asdict(plan.settings),
        "display": {"given": plan.display.given(), "derived": plan.display.derived()},
        "misalign": plan.settings.misalign,
        "backend": backend_data(found.backend),
        "lens_model": plan.settings.lens_model,
        "viewpoints": [
            {"name": v.name, "position_mm": list(v.position_mm)} for v in plan.viewpoints
        ],
        "rgbd": _rgbd(found.capture.rgbd),
        "noise_floor": noise_floor,
        "scoring": _scoring(),
        "ceiling": scores_data(found.ceiling),
        "algorithms": algorithms,
        "timings": found.run.observer.timings,
        "skipped": found.run.skipped.rows,
        "warnings": [*_outside_limits(plan), *found.warnings],
        "verdict": {"passed": all(c["passed"] for c in checks), "checks": checks},
        "files": _listed_files(folder),
    }
    optional = {"regression": comparison.data, "preview": _preview(plan)}
    return Report(folder, data | {name: found for name, found in optional.items() if found})


def _preview(plan: Plan) -> dict[str, str]:
    """What makes the full report, where this one is of a first look; empty where it is not."""
    if not plan.request.preview:
        return {}
    words = replace(plan, request=replace(plan.request, preview=False)).command
    return {"full_command": shlex.join(["inim", "validate", *words])}


def _outside_limits(plan: Plan) -> list[str]:
    """What of the display lies outside its panel, or the limits that the stress run measured."""
    return lenses_beside_panel(plan.display) + accuracy_warnings(
        plan.display,
        plan.settings.lens_model,
        viewpoints=plan.viewpoints,
        pixel_mm=plan.capture_pixel_mm,
    )


def _scoring() -> dict[str, Any]:
    """What decides scores, for whoever computes them again from the report's EXR pictures."""
    return {
        "headline": HEADLINE,
        "relic_margin_px": metrics.RELIC_MARGIN_PX,
        "metrics": {
            metric.name: {"border_px": metric.border, "arguments": dict(metric.settings)}
            for metric in metrics.all_metrics()
        },
    }


def _rgbd(rgbd: RGBD) -> dict[str, Any]:
    covered = rgbd.depth_mm[rgbd.covered]
    return {
        "rows": rgbd.shape[0],
        "columns": rgbd.shape[1],
        "pixel_mm": rgbd.pixel_mm,
        "covered_fraction": float(rgbd.covered.mean()),
        "depth_min_mm": float(covered.min()) if covered.size else None,
        "depth_max_mm": float(covered.max()) if covered.size else None,
    }


def _listed_files(folder: Path) -> list[str]:
    """Every file of the report."""
    pictures = (str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())
    return sorted([*pictures, "report.html", "report.json", "junit.xml", "summary.md"])
