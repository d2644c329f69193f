"""The headline score: the one by which algorithms are ranked, everywhere.

It is `MAIN` on the relic, to the reference.
"""

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
    """The algorithm with the best mean headline score; the first of equal ones.

    One that lacks any of the scores is never the best while another has them all.

    Parameters
    ----------
    headlines : mapping of str to sequence of float
        Finite scores of the views, by algorithm.

    Returns
    -------
    str or None
        None without any score.
    """

    def rank(algorithm: str) -> tuple[int, float]:
        scores = headlines[algorithm]
        return len(scores), sum(scores) / len(scores) if scores else 0.0

    best = max(headlines, key=rank, default=None)
    return best if best is not None and headlines[best] else None


def preferred(metric: Metric, means: Mapping[str, float], best: str) -> str:
    """The algorithm that a metric finds better than the best by the headline score, or the latter.

    A difference below the metric's tolerance does not count.

    Parameters
    ----------
    metric : Metric
    means : mapping of str to float
        Mean score to the reference, by algorithm.
    best : str
        By the headline score.
    """
    sign = 1 if metric.better == "higher" else -1
    other = max(means, key=lambda name: sign * means[name], default=best)
    if best not in means or sign * (means[other] - means[best]) <= metric.tolerance:
        return best
    return other


def passing_limit(headlines: Sequence[float], noise: float) -> float:
    """A criterion that a run would just pass.

    The worst view's headline score, less the largest half interval and the smallest change that
    counts, rounded down to a hundredth.
    """
    return max(math.floor(100 * (min(headlines) - noise - MAIN.tolerance)) / 100, 0.0)
