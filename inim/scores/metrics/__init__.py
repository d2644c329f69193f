"""Scores of an image against a reference, on display-referred sRGB, and the headline score.

A metric is one file with one value, a `Metric`. Other packages register theirs in the entry-point
group ``inim.metrics``, under the metric's name: docs/how-to/own-metric.md. Every run computes all
installed metrics. All parameters are fixed.
Algorithms are ranked by the headline: `MAIN` on the relic, to the reference.
"""

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, wraps
from threading import Lock
from typing import Any

import numpy as np

from inim.scores.metrics.base import Metric, Viewing, maps_of
from inim.scores.metrics.flip import flip, flip_map
from inim.scores.metrics.flip import metric as _flip
from inim.scores.metrics.psnr import metric as _psnr
from inim.scores.metrics.psnr import psnr_db
from inim.scores.metrics.ssim import SSIM_WINDOW, ssim, ssim_map
from inim.scores.metrics.ssim import metric as _ssim
from inim.system.errors import UsageError
from inim.system.plugins import announced_names, attribute_errors, identity, load

__all__ = [
    "HEADLINE",
    "HEADLINE_TO_SCENE",
    "HEADLINE_WORDS",
    "MAIN",
    "RELIC_MARGIN_PX",
    "SSIM_WINDOW",
    "Metric",
    "Viewing",
    "all_metrics",
    "best_algorithm",
    "eia_scores",
    "find",
    "flip",
    "flip_map",
    "foreign_identities",
    "passing_limit",
    "preferred_algorithm",
    "psnr_db",
    "relic_region",
    "score",
    "score_maps",
    "ssim",
    "ssim_map",
]

#: Margin of the relic's region, in pixels: half of SSIM's window.
RELIC_MARGIN_PX = SSIM_WINDOW // 2
_OWN = (_ssim, _psnr, _flip)
_ENTRY_POINTS = "inim.metrics"
# Other packages' functions may not be thread-safe.
_PLUGIN_LOCK = Lock()


def all_metrics() -> tuple[Metric, ...]:
    """All metrics: the project's own, then those of other packages, by name.

    Raises `UsageError` if another package's metric cannot be loaded, is not a `Metric`, or has the
    wrong name.
    """
    return _all_metrics(tuple(sys.path))


@cache
def _all_metrics(path: tuple[str, ...]) -> tuple[Metric, ...]:  # noqa: ARG001
    """Metrics of a search path, cached."""
    return (*_OWN, *_foreign_metrics())


def _foreign_metrics() -> tuple[Metric, ...]:
    return tuple(_foreign(name) for name in announced_names(_ENTRY_POINTS))


def _foreign(name: str) -> Metric:
    plugin = load(_ENTRY_POINTS, name, "metric")
    if not isinstance(plugin, Metric):
        raise UsageError(
            f"metric {name!r} is a {type(plugin).__name__}; register an inim.scores.metrics.Metric"
        )
    if plugin.name != name:
        raise UsageError(f"metric {name!r} has the name {plugin.name!r}; use one name for both")
    if name in {metric.name for metric in _OWN}:
        raise UsageError(f"metric {name!r} is one of inim's own; rename the other metric")
    return replace(
        plugin,
        function=_guard(name, plugin.function, is_map=plugin.reach is not None),
    )


def _guard(name: str, function: Callable[..., Any], *, is_map: bool) -> Callable[..., Any]:
    """Wrap another package's function with checks and errors that name the metric."""

    @wraps(function)
    def guarded(reference: np.ndarray, test: np.ndarray, *viewing: Viewing) -> np.ndarray:
        shape = reference.shape[:2]
        with _PLUGIN_LOCK, attribute_errors(_ENTRY_POINTS, "metric", name):
            values = np.asarray(function(reference, test, *viewing))
            if values.shape != shape and (is_map or values.shape):
                raise ValueError(f"the result has the shape {values.shape}, not {shape}")
            if np.isnan(values).any():
                raise ValueError("the result is NaN")
            return values

    return guarded


def find(score_name: str) -> Metric | None:
    """Find a metric by its name or by a score's: ``psnr``, ``psnr_to_reference_db``."""
    name = score_name.partition("_")[0]
    return next((metric for metric in all_metrics() if metric.name == name), None)


def foreign_identities() -> dict[str, dict[str, str]]:
    """Identities of other packages' metrics (`inim.system.plugins.identity`), for cache keys."""
    return {m.name: identity(_ENTRY_POINTS, m.name) for m in _foreign_metrics()}


def score_maps(
    reference: np.ndarray,
    test: np.ndarray,
    keys: Sequence[str] | None = None,
    viewing: Viewing | None = None,
) -> dict[str, np.ndarray]:
    """Compute the maps whose means are the scores, by `Metric.key`; `keys` selects metrics.

    See `inim.scores.metrics.base.maps_of` for images, maps and errors. The map of PSNR has squared
    errors.
    """
    metrics = {metric.key: metric for metric in all_metrics()}
    selection = [metrics[key] for key in (metrics if keys is None else keys)]
    return maps_of(selection, reference, test, viewing)


def score(
    reference: np.ndarray,
    test: np.ndarray,
    region: np.ndarray | None = None,
    viewing: Viewing | None = None,
) -> dict[str, float]:
    """Score an image by every installed metric.

    Scores are plain: the noise of rendered images lowers them. Those of `inim.validate` are
    corrected for noise; `plain` in its `precision` has the plain scores.

    Parameters
    ----------
    reference, test : (rows, columns, 3) float32 array
        Linear RGB, 1 being the panel's white.
    region : (rows, columns) bool array, optional
        Region of the relic, such as `inim.scores.metrics.relic_region` returns; adds scores
        restricted to it.
    viewing : Viewing, optional
        Viewing conditions; without them, metrics that need them are left out.

    Returns
    -------
    dict of str to float
        Scores by key: ``ssim``, ``psnr_db``, ``flip``; ``ssim_on_relic``, ...

    Raises
    ------
    UsageError
        Images that differ in shape, are integers or contain values that are not finite.
    """
    maps = score_maps(reference, test, viewing=viewing)
    metrics = [metric for metric in all_metrics() if metric.key in maps]
    scores = {metric.key: metric.score(maps[metric.key]) for metric in metrics}
    if region is not None:
        for metric in metrics:
            if metric.has_relic_score and maps[metric.key].ndim:
                scores[metric.on_relic_key] = metric.score(maps[metric.key], region)
    return scores


def relic_region(relic: np.ndarray) -> np.ndarray:
    """The relic's region in a view: its pixels, (rows, columns) bool, with a margin.

    The margin of `RELIC_MARGIN_PX` includes all pixels whose SSIM window contains the relic.
    """
    region = relic
    for _ in range(2):  # along rows, then along columns
        padded = np.pad(region, ((0, 0), (RELIC_MARGIN_PX, RELIC_MARGIN_PX)))
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * RELIC_MARGIN_PX + 1, axis=1)
        region = np.any(windows, axis=-1).T
    return region


def eia_scores(reference: np.ndarray, test: np.ndarray) -> dict[str, float]:
    """Score an EIA, (rows, columns, 3) float32, linear RGB, by the metrics that apply to it."""
    scores = {}
    for metric in all_metrics():
        if metric.whole_image_score is not None and metric.has_eia_score:
            scores[metric.key] = metric.whole_image_score(reference, test)
        elif metric.has_eia_score:
            scores[metric.key] = metric.score(maps_of([metric], reference, test)[metric.key])
    return scores


# -- headline score -------------------------------------------------------------------------------

MAIN = _ssim
#: Keys of the headline score and of the same score to the scene.
HEADLINE, HEADLINE_TO_SCENE = MAIN.on_relic_to_reference_key, MAIN.on_relic_key
HEADLINE_WORDS = f"{MAIN.label} on the relic, to the reference"


def best_algorithm(headlines: Mapping[str, Sequence[float]]) -> str | None:
    """Name of the algorithm with the best mean headline score; the first of equal ones.

    The finite scores of the views are given by algorithm; those with fewer scores rank lower. None
    if there are no scores.
    """

    def rank(algorithm: str) -> tuple[int, float]:
        scores = headlines[algorithm]
        return len(scores), sum(scores) / len(scores) if scores else 0.0

    best = max(headlines, key=rank, default=None)
    return best if best is not None and headlines[best] else None


def preferred_algorithm(metric: Metric, means: Mapping[str, float], best: str) -> str:
    """Name of the algorithm that a metric ranks first by its mean score to the reference.

    Within the metric's tolerance, it is `best`, the best algorithm by the headline score.
    """
    sign = 1 if metric.better == "higher" else -1
    other = max(means, key=lambda name: sign * means[name], default=best)
    if best not in means or sign * (means[other] - means[best]) <= metric.tolerance:
        return best
    return other


def passing_limit(headlines: Sequence[float], noise: float) -> float:
    """Suggest a criterion that a run just passes.

    The worst view's headline score, minus the largest half interval and the smallest change that
    counts, rounded down to a hundredth.
    """
    return max(math.floor(100 * (min(headlines) - noise - MAIN.tolerance)) / 100, 0.0)
