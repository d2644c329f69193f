"""What a run leaves for later ones to be compared with."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import datetime, timezone
from typing import Any

from inim.backend import Backend
from inim.backend.choice import versions
from inim.documents.parts import Circumstances
from inim.documents.report import AlgorithmResult
from inim.metrics import perception_packages
from inim.pipeline.measured import Measured
from inim.pipeline.plan import Plan, conditions_of
from inim.pipeline.stages.statistics import Statistics
from inim.process import machine
from inim.regression import Fingerprint, RunStatistics, ScoreEstimate, TileStatistics
from inim.version import __version__

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
