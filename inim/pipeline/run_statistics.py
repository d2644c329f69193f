"""What a run leaves for later ones to be compared with: statistics, scores, conditions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from datetime import datetime, timezone
from typing import Any

import numpy as np

from inim.backend import machine
from inim.cache.store import Record
from inim.display import Display
from inim.half_buffers import HalfBuffers
from inim.pipeline.deciding import score_parts
from inim.pipeline.differences import keep_fixed
from inim.pipeline.ledger import Ledger
from inim.pipeline.method import Fixed
from inim.pipeline.plan import Plan
from inim.pipeline.score import Sampled, ViewScores
from inim.pipeline.truth import GroundTruth
from inim.provenance import versions
from inim.regression import (
    Evidence,
    Fingerprint,
    HalfBuffer,
    ScoreEstimate,
    TileStatistics,
    eia_tile,
    tile_statistics,
    view_tile,
)
from inim.version import __version__

#: Of a picture's samples.
Half = np.ndarray | HalfBuffer

__all__ = [
    "Against",
    "Contest",
    "Findings",
    "against",
    "ceiling_scores",
    "circumstances_of",
    "conditions_of",
    "eia_statistics",
    "evidence_of",
    "fingerprints",
    "truth_findings",
]

# What scores against the ceiling are called.
_TO_CEILING = {
    "ssim": "ssim_to_ceiling",
    "psnr_db": "psnr_to_ceiling_db",
    "flip": "flip_to_ceiling",
}
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
            name: self.ceiling.values[metric] for metric, name in _TO_CEILING.items()
        }

    def estimates(self) -> dict[str, ScoreEstimate]:
        """Those that later runs are compared with, and how sure they are."""
        to_ceiling = {name: self.ceiling.estimates[metric] for metric, name in _TO_CEILING.items()}
        return to_ceiling | {"ssim_to_scene": self.scene.estimates["ssim"]}


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
    begun = {}
    with job.beside() as begin:
        if job.observed is None:
            halves, tile = (truth.eia.first, truth.eia.second), _eia_tile(job.plan.display)
            begun["truth/eia"] = begin(_statistics, job, halves, tile)
        for name, view in truth.views.items():
            begun[f"truth/{name}"] = begin(_view_statistics, job, view)
        pictures = {name: one.result() for name, one in begun.items()}
    scores = {
        f"ceiling/{name}": {"ssim_to_scene": found.estimates["ssim"]}
        for name, found in ceiling.items()
    }
    return Findings(pictures, scores)


def ceiling_scores(job: Ledger, truth: GroundTruth) -> dict[str, ViewScores]:
    """What perfect elemental images show, against the rendered view, by viewpoint."""

    def of(name: str) -> ViewScores:
        return job.scorer.view(truth.views[name], truth.ceiling[name], sure=("ssim",))

    with job.beside() as begin:
        begun = {name: begin(of, name) for name in truth.views}
        return {name: one.result() for name, one in begun.items()}


def against(job: Ledger, truth: GroundTruth, name: str, view: Sampled) -> Against:
    """Scores of a contender's view from a viewpoint."""
    scene, ceiling = truth.views[name], truth.ceiling[name]
    return Against(
        job.scorer.view(scene, view, truth.relic[name], sure=("ssim",)),
        job.scorer.view(ceiling, view, sure=("ssim", "psnr_db", "flip")),
    )


def _eia_tile(display: Display) -> tuple[int, int]:
    return eia_tile(display.eia_shape, (display.lens_rows, display.lens_columns))


def _view_statistics(job: Ledger, view: HalfBuffers) -> TileStatistics:
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


def eia_statistics(job: Ledger, name: str, halves: tuple[Half, Half]) -> dict[str, TileStatistics]:
    """Statistics of a contender's EIA by either half of the samples; none of one made in part."""
    if job.observed is not None:
        return {}
    tile = _eia_tile(job.plan.display)
    return {f"eia/{name}": _statistics(job, halves, tile, generated=True)}


def fingerprints(job: Ledger, name: str, fixed: Fixed | None) -> dict[str, Fingerprint]:
    """Of what a contender makes of the fixed picture, which is kept where a baseline's differs."""
    if fixed is None:
        return {}
    found, baseline = fixed.fingerprint(), job.plan.baseline
    if baseline is not None:
        keep_fixed(job, name, fixed.eia, found, baseline.fingerprints.get(name))
    return {name: found}


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
        "threads": machine.cpu_count(),
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
