"""The content of `report.json`, schema `inim.report/1`, from what a run found."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import asdict
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from inim.half_buffers import HalfBuffers
from inim.pipeline.ledger import Ledger
from inim.pipeline.score import ViewScores
from inim.pipeline.truth import GroundTruth
from inim.provenance import backend_data, versions
from inim.report import SCHEMA
from inim.version import __version__

__all__ = ["eia_scores", "report_data"]

_VERSIONS = ("drjit", "flip-evaluator", "mitsuba", "numba", "numpy", "OpenEXR", "scikit-image")


def eia_scores(
    job: Ledger, truth: HalfBuffers, eia: np.ndarray | None = None
) -> dict[str, float | None]:
    """SSIM and PSNR of an EIA; none where the run makes only what is observed of it.

    Without an EIA, the noise floor's.
    """
    if job.observed is not None:
        return {"ssim": None, "psnr_db": None}
    if eia is None:
        return dict(job.scorer.eia(truth.first, truth.second))
    return dict(job.scorer.eia(truth.image, eia))


def report_data(
    job: Ledger,
    truth: GroundTruth,
    ceiling: Mapping[str, ViewScores],
    algorithms: Mapping[str, Any],
) -> dict[str, Any]:
    """Everything a report holds, but the run's total time.

    Parameters
    ----------
    job : Ledger
    truth : GroundTruth
    ceiling : mapping of str to ViewScores
        By viewpoint.
    algorithms : mapping
        Scores by name.
    """
    plan = job.plan
    with job.stage("score"):
        noise_floor = _noise_floor(job, truth)
    return {
        "schema": SCHEMA,
        "title": plan.settings.title or plan.request.scene.stem,
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "inim_version": __version__,
        "versions": versions(_VERSIONS),
        "command": shlex.join(["python", "-m", "inim.validate", *plan.request.command()]),
        "scene": _scene(job, truth),
        "settings": asdict(plan.settings),
        "display": {"given": plan.display.given(), "derived": plan.display.derived()},
        "misalign": plan.settings.misalign,
        "backend": backend_data(job.backend),
        "lens_model": plan.settings.lens_model,
        "viewpoints": [
            {"name": v.name, "position_mm": list(v.position_mm)} for v in plan.viewpoints
        ],
        "rgbd": _rgbd(truth),
        "noise_floor": noise_floor,
        "ceiling": {"views": {name: scores.values for name, scores in ceiling.items()}},
        "algorithms": algorithms,
        "timings": job.timings,
        "skipped": job.memo.rows,
        "warnings": job.warnings,
        "verdict": {"passed": all(c["passed"] for c in job.checks), "checks": job.checks},
        "files": _listed_files(job.folder),
    }


def _noise_floor(job: Ledger, truth: GroundTruth) -> dict[str, Any]:
    with job.beside() as begin:
        whole = begin(eia_scores, job, truth.eia)
        begun = {n: begin(job.scorer.plain_view, t.first, t.second) for n, t in truth.views.items()}
        views = {name: one.result() for name, one in begun.items()}
        return {"eia": whole.result(), "views": views}


def _scene(job: Ledger, truth: GroundTruth) -> dict[str, Any]:
    return {
        "path": str(job.plan.request.scene),
        "sha256": job.plan.file.sha256,
        **truth.scene,
    }


def _rgbd(truth: GroundTruth) -> dict[str, Any]:
    covered = truth.rgbd.depth_mm[truth.rgbd.covered]
    return {
        "rows": truth.rgbd.shape[0],
        "columns": truth.rgbd.shape[1],
        "pixel_mm": truth.rgbd.pixel_mm,
        "covered_fraction": float(truth.rgbd.covered.mean()),
        "depth_min_mm": float(covered.min()) if covered.size else None,
        "depth_max_mm": float(covered.max()) if covered.size else None,
    }


def _listed_files(folder: Path) -> list[str]:
    """Every file of the report, so that a later run can tell its own from the user's."""
    pictures = (str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())
    return sorted([*pictures, "report.html", "report.json", "junit.xml", "summary.md"])
