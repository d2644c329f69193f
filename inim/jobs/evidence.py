"""What a run leaves for later ones to be compared with: statistics, scores, conditions."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from datetime import datetime, timezone
from typing import Any

import numpy as np

from inim.backend import machine
from inim.display import Display
from inim.generators import parse_algorithm
from inim.halves import Halves
from inim.jobs.deciding import score_parts
from inim.jobs.differences import keep_fixed
from inim.jobs.ledger import Ledger
from inim.jobs.plan import Plan
from inim.jobs.provenance import versions
from inim.jobs.scoring import Sampled, ViewScores
from inim.jobs.truth import GroundTruth
from inim.regression import (
    Evidence,
    Fingerprint,
    OneHalf,
    ScoreEstimate,
    TileStatistics,
    eia_tile,
    fingerprint,
    fixed_picture,
    tile_statistics,
    view_tile,
)
from inim.store import Record
from inim.version import __version__

#: Of a picture's samples.
Half = np.ndarray | OneHalf

__all__ = [
    "Against",
    "Contest",
    "Findings",
    "against",
    "ceiling_scores",
    "circumstances_of",
    "conditions_of",
    "contender_findings",
    "evidence_of",
    "truth_findings",
]

# Algorithms whose EIA depends on comparisons of stored numbers only: equal on every machine.
_EXACT = ("template",)
_VERSIONS = ("drjit", "mitsuba", "numba", "numpy", "scikit-image")
_SAMPLING = ("capture_spp", "eia_spp", "view_spp", "reconstruction_spp", "seed")


@dataclass(frozen=True)
class Findings:
    """What later runs can be compared with, of one contender or of the ground truth.

    Attributes
    ----------
    pictures : dict of str to TileStatistics
    scores : dict of str to dict of str to ScoreEstimate
        By ``NAME/VIEWPOINT``.
    fingerprints : dict of str to Fingerprint
    """

    pictures: dict[str, TileStatistics] = field(default_factory=dict)
    scores: dict[str, dict[str, ScoreEstimate]] = field(default_factory=dict)
    fingerprints: dict[str, Fingerprint] = field(default_factory=dict)


@dataclass(frozen=True)
class Against:
    """Scores of a contender's view.

    Attributes
    ----------
    scene, ceiling : ViewScores
        Against the rendered view, and against what perfect elemental images show.
    """

    scene: ViewScores
    ceiling: ViewScores

    def values(self) -> dict[str, float]:
        """As in report.json."""
        return self.scene.values | {
            "ssim_to_ceiling": self.ceiling.values["ssim"],
            "psnr_to_ceiling_db": self.ceiling.values["psnr_db"],
            "flip_to_ceiling": self.ceiling.values["flip"],
        }


@dataclass(frozen=True)
class Contest:
    """Scores and findings of one contender.

    Attributes
    ----------
    scores : dict
        As in report.json.
    findings : Findings
    """

    scores: dict[str, Any]
    findings: Findings


def truth_findings(job: Ledger, truth: GroundTruth, ceiling: Mapping[str, ViewScores]) -> Findings:
    """Statistics of the ground truth, and scores of the ceiling, by viewpoint."""
    pictures = {}
    if job.observed is None:
        tile = _eia_tile(job.plan.display)
        pictures["truth/eia"] = _statistics(job, (truth.eia.first, truth.eia.second), tile)
    scores = {}
    for name, view in truth.views.items():
        pictures[f"truth/{name}"] = _view_statistics(job, view)
        scores[f"ceiling/{name}"] = {"ssim_to_scene": ceiling[name].estimates["ssim"]}
    return Findings(pictures, scores)


def ceiling_scores(job: Ledger, truth: GroundTruth) -> dict[str, ViewScores]:
    """What perfect elemental images show, against the rendered view, by viewpoint."""
    return {
        name: job.scorer.view(view, truth.ceiling[name], sure=("ssim",))
        for name, view in truth.views.items()
    }


def against(job: Ledger, truth: GroundTruth, name: str, view: Sampled) -> Against:
    """Scores of a contender's view from a viewpoint."""
    scene, ceiling = truth.views[name], truth.ceiling[name]
    return Against(
        job.scorer.view(scene, view, truth.relic[name], sure=("ssim",)),
        job.scorer.view(ceiling, view, sure=("ssim", "psnr_db", "flip")),
    )


def _eia_tile(display: Display) -> tuple[int, int]:
    return eia_tile(display.eia_shape, (display.lens_rows, display.lens_columns))


def _view_statistics(job: Ledger, view: Halves) -> TileStatistics:
    return _statistics(job, (view.first, view.second), view_tile(view.first.shape[:2]))


def _statistics(
    job: Ledger,
    halves: tuple[Half, Half],
    tile: tuple[int, int],
    *,
    generated: bool = False,
) -> TileStatistics:
    """`tile_statistics`, made once."""

    def make() -> Record:
        found = tile_statistics(*halves, tile, generated=generated)
        return Record({name: getattr(found, name) for name in TileStatistics.array_names()})

    pictures = {"halves": list(halves), "tile": tile, "generated": generated}
    record = job.memo.recall("tile statistics", pictures | score_parts(), make)
    rows, columns = halves[0].shape[:2]
    return TileStatistics.of(tile, (rows, columns), record.arrays)


def contender_findings(
    job: Ledger,
    truth: GroundTruth,
    name: str,
    halves: tuple[Half, Half],
    views: Mapping[str, Against],
    fixed: np.ndarray | None,
) -> Findings:
    """Statistics and scores of one contender.

    Parameters
    ----------
    job : Ledger
    truth : GroundTruth
    name : str
    halves : two (rows, columns, 3) float32
        Its EIA, by either half of the samples.
    views : mapping of str to Against
        Scores of its views.
    fixed : (rows, columns, 3) float32, or None
        What it makes of the fixed picture.
    """
    display, plan = job.plan.display, job.plan
    scores = {}
    for view, found in views.items():
        to_ceiling = found.ceiling.estimates
        scores[f"{name}/{view}"] = {
            "ssim_to_ceiling": to_ceiling["ssim"],
            "psnr_to_ceiling_db": to_ceiling["psnr_db"],
            "flip_to_ceiling": to_ceiling["flip"],
            "ssim_to_scene": found.scene.estimates["ssim"],
        }
    prints = {}
    if fixed is not None:
        rgbd = fixed_picture(display, truth.rgbd.shape, truth.rgbd.pixel_mm)
        exact = parse_algorithm(name)[0] in _EXACT
        prints[name] = fingerprint(rgbd, fixed, display, exact=exact)
        if plan.baseline is not None:
            keep_fixed(job, name, fixed, prints[name], plan.baseline.fingerprints.get(name))
    pictures = {}
    if job.observed is None:
        tile = _eia_tile(display)
        pictures[f"eia/{name}"] = _statistics(job, halves, tile, generated=True)
    return Findings(pictures, scores, prints)


def conditions_of(plan: Plan, variant: str | None = None) -> dict[str, Any]:
    """What two runs must share to be compared.

    Parameters
    ----------
    plan : Plan
    variant : str, optional
        Of the renderer; left out while it is not known.
    """
    s, request = plan.settings, plan.request
    conditions = {
        "scene (SHA-256)": plan.file.sha256,
        "scene parameters": _scene_parameters(request.definitions),
        "display": _given(plan.display),
        "display as derived": plan.display.derived(),
        "array as mounted": s.misalign,
        "share of the array filled": s.fit_share,
        "lens model": s.lens_model,
        "viewpoints": {v.name: [*v.position_mm, v.pupil_mm, v.focus_mm] for v in plan.viewpoints},
        "view pixels per lens": s.view_pixels_per_lens,
        "RGB-D pixels per pitch": s.capture_pixels_per_pitch,
        "algorithms": sorted(contender.name for contender in plan.contenders),
        **({"panel pixels": "observed ones only"} if request.lazy else {}),
    }
    return conditions if variant is None else {**conditions, "variant": variant}


def _scene_parameters(definitions: tuple[str, ...]) -> list[str]:
    """`-D` of the scene's own parameters; those of `inim` are compared by what they lead to."""
    return sorted(item for item in definitions if not item.strip().startswith("inim."))


def _given(display: Display) -> dict[str, Any]:
    """Parameters that are not their defaults: one that a later version adds changes nothing."""
    defaults = {f.name: f.default for f in fields(display)}
    return {
        name: value
        for name, value in display.given().items()
        if defaults[name] is MISSING or value != defaults[name]
    }


def circumstances_of(plan: Plan, backend: Any) -> dict[str, Any]:
    """What made a run and may differ: shown, not judged."""
    return {
        "title": plan.settings.title or plan.request.scene.stem,
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "inim": __version__,
        **versions(_VERSIONS),
        "libLLVM": backend.libllvm_version,
        "device": backend.device,
        "processor": machine.cpu_model(),
        "threads": len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count(),
        **{name: getattr(plan.settings, name) for name in _SAMPLING},
    }


def evidence_of(
    plan: Plan,
    backend: Any,
    findings: list[Findings],
    algorithms: Mapping[str, Any],
    times: Mapping[str, tuple[float, ...]],
) -> Evidence:
    """All that a run leaves behind."""
    pictures: dict[str, TileStatistics] = {}
    scores: dict[str, dict[str, ScoreEstimate]] = {}
    prints: dict[str, Fingerprint] = {}
    for one in findings:
        pictures |= one.pictures
        scores |= one.scores
        prints |= one.fingerprints
    return Evidence(
        conditions_of(plan, backend.variant),
        circumstances_of(plan, backend),
        pictures,
        scores,
        prints,
        dict(times),
        _reported(algorithms),
    )


def _reported(algorithms: Mapping[str, Any]) -> dict[str, dict[str, float | None]]:
    """Every score of a report, by contender and by contender and viewpoint."""
    rows: dict[str, dict[str, float | None]] = {}
    for name, result in algorithms.items():
        rows[name] = {f"eia {key}": _finite(value) for key, value in result["eia"].items()}
        for view, scores in result["views"].items():
            rows[f"{name}/{view}"] = {key: _finite(value) for key, value in scores.items()}
    return rows


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
