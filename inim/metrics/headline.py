"""Headline score, which ranks the algorithms: `MAIN` on the relic, to the reference."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from inim.metrics.base import Metric
from inim.metrics.ssim import metric

MAIN = metric
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
