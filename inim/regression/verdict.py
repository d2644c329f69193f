"""Verdicts as data, and their statistics, each with its formula and source.

Every test is two-sided. Levels are per family: the probability of any false alarm among a run's `m`
tests of one kind is `FALSE_ALARM_RATE`. `scipy.special` provides the distributions, because
`scipy.stats` takes two seconds to load.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from inim.documents.parts import Check, Kind, Relation

#: Probability that noise alone fails a family of tests (all tiles, all scores, all times) of an
#: unchanged program: once in three years in a daily check.
FALSE_ALARM_RATE = 1e-3


def sidak(level: float, tests: int) -> float:
    """Level of each of `tests` tests for a family of the given `level`.

    ``1 - (1 - level)^(1/m)``; exact for independent tests, conservative for two-sided tests of
    correlated normal means.

    Source: Sidak, JASA 62, 1967.
    """
    return -math.expm1(math.log1p(-level) / max(1, tests))


def freedom_of_sum(squares: np.ndarray, fourths: np.ndarray) -> np.ndarray:
    """Degrees of freedom of a sum of variance estimates with one degree each.

    For ``S1 = sum v_i`` and ``S2 = sum v_i^2`` it is ``3 S1^2 / S2 - 2``, at least one: near n for
    n equal estimates, and 1 for a single one.

    * `squares`, `fourths`, arrays of one shape: S1 and S2.

    Source: Welch, Biometrika 34, 1947: ``(sum v)^2 / sum(v^2 / (f + 2)) - 2`` at f = 1, which
    removes the bias of Satterthwaite's (1946) formula at few degrees.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = 3 * np.square(squares) / fourths - 2
    # Without noise any finite number will do.
    return np.where(fourths > 0, np.maximum(freedom, 1.0), 1.0)


def welch_freedom(
    error_a: np.ndarray, freedom_a: np.ndarray, error_b: np.ndarray, freedom_b: np.ndarray
) -> np.ndarray:
    """Degrees of freedom of the difference of two means with their own standard errors.

    ``(a^2 + b^2)^2 / (a^4 / nu_a + b^4 / nu_b)``. Source: Welch 1947, Satterthwaite 1946.
    """
    a, b = np.square(error_a, dtype=np.float64), np.square(error_b, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = np.square(a + b) / (np.square(a) / freedom_a + np.square(b) / freedom_b)
    return np.where(a + b > 0, np.maximum(freedom, 1.0), 1.0)


def welch_half_width(
    error_a: np.ndarray,
    freedom_a: np.ndarray,
    error_b: np.ndarray,
    freedom_b: np.ndarray,
    level: float,
) -> np.ndarray:
    """Half width of a difference's two-sided interval at confidence ``1 - level``."""
    from scipy.special import stdtrit

    freedom = welch_freedom(error_a, freedom_a, error_b, freedom_b)
    error = np.hypot(np.asarray(error_a, np.float64), np.asarray(error_b, np.float64))
    # NaN stays NaN and fails.
    width: np.ndarray = np.where(error == 0, 0.0, -stdtrit(freedom, level / 2) * error)
    return width


def welch_p_value(
    difference: np.ndarray,
    error_a: np.ndarray,
    freedom_a: np.ndarray,
    error_b: np.ndarray,
    freedom_b: np.ndarray,
) -> np.ndarray:
    """Two-sided p-value of Welch's t-test; for noiseless means 1 if equal, else 0."""
    from scipy.special import stdtr

    freedom = welch_freedom(error_a, freedom_a, error_b, freedom_b)
    error = np.hypot(np.asarray(error_a, np.float64), np.asarray(error_b, np.float64))
    with np.errstate(divide="ignore", invalid="ignore"):
        p = 2 * stdtr(freedom, -np.abs(difference) / error)
    return np.where(error == 0, np.where(difference == 0, 1.0, 0.0), p)


def binomial_interval(count: int, trials: int, level: float) -> tuple[float, float]:
    """Exact interval of a share, observed as `count` of `trials`.

    Source: Clopper and Pearson, Biometrika 26, 1934.
    """
    from scipy.special import betainccinv, betaincinv

    low = 0.0 if count == 0 else float(betaincinv(count, trials - count + 1, level / 2))
    high = 1.0 if count == trials else float(betainccinv(count + 1, trials - count, level / 2))
    return low, high


@dataclass(frozen=True)
class Shift:
    """Shift between two samples: the median of all pairwise differences, with its interval.

    The interval is infinite if the samples are too small for the level; `p_value` is that of no
    shift.
    """

    value: float
    low: float
    high: float
    p_value: float


def shift_of(candidate: Sequence[float], baseline: Sequence[float], level: float) -> Shift:
    """Estimate the distribution-free shift between two samples; outliers have no weight.

    The estimate is the median of all differences ``c_i - b_j``. Its interval ends at two of them,
    chosen by the exact distribution of the rank-sum statistic U.

    Source: Hodges and Lehmann, Ann. Math. Statist. 34, 1963; Mann and Whitney, ibid. 18, 1947.
    """
    differences = np.sort(np.subtract.outer(np.asarray(candidate), np.asarray(baseline)).ravel())
    if differences.size == 0 or not np.isfinite(differences).all():
        return Shift(math.nan, -math.inf, math.inf, math.nan)
    cumulative = np.cumsum(_rank_sum_distribution(len(candidate), len(baseline)))
    # The largest k with P(U < k) <= level / 2: the k-th smallest and largest differences bound it.
    k = int(np.searchsorted(cumulative, level / 2, side="right"))
    low, high = (differences[k - 1], differences[-k]) if k else (-math.inf, math.inf)
    ties = 0.5 * np.count_nonzero(differences == 0)
    u = float(np.count_nonzero(differences > 0) + ties)
    extreme = math.floor(min(u, differences.size - u))
    p = min(1.0, 2 * float(cumulative[extreme]))
    return Shift(float(np.median(differences)), float(low), float(high), p)


@lru_cache(maxsize=16)
def _rank_sum_distribution(m: int, n: int) -> np.ndarray:
    """Probability of each value 0..m n of U for two samples of the same distribution.

    The numbers of ways to obtain U = u are the coefficients of the Gaussian binomial, the product
    over i = 1..m of ``(1 - q^(n + i)) / (1 - q^i)``.
    """
    ways = np.zeros(m * n + 1)
    ways[0] = 1
    for i in range(1, m + 1):
        ways[n + i :] -= ways[: -(n + i)].copy()
        for first in range(i):
            ways[first::i] = np.cumsum(ways[first::i])
    probabilities: np.ndarray = ways / ways.sum()
    return probabilities


#: Relation of a change to the largest that passes in either direction.
WITHIN: Relation = "within"


def verdict_line(verdict: Check) -> str:
    """Format a verdict as text."""
    low, high = verdict.interval or (math.nan, math.nan)
    unit = f" {verdict.unit}" if verdict.unit else ""
    sign = "within ±" if verdict.relation == WITHIN else "at most "
    value = f"{verdict.value:{'+.4g' if verdict.relation == WITHIN else '.4g'}}"
    return (
        f"{'passed' if verdict.passed else 'FAILED'}  {verdict.name}: {value}{unit} "
        f"({low:.4g} to {high:.4g}), {sign}{verdict.limit:.4g}"
        f"{f'; {verdict.detail}' if verdict.detail else ''}"
    )


def within(
    name: str, kind: Kind, change: float, half_width: float, smallest: float, **more: Any
) -> Check:
    """Verdict on a change, which fails only if it counts *and* noise does not explain it.

    `half_width` is that of the confidence interval, `smallest` the smallest change that counts, and
    `more` other fields of the check.
    """
    limit = max(smallest, half_width) if math.isfinite(half_width) else smallest
    is_finite = math.isfinite(change) and math.isfinite(half_width)
    interval = (change - half_width, change + half_width)
    return Check(
        name=name,
        kind=kind,
        value=change,
        relation=WITHIN,
        limit=limit,
        interval=interval,
        passed=bool(is_finite and abs(change) <= limit),
        **{"detail": "", "unit": "", **more},
    )


def all_passed(verdicts: Sequence[Check]) -> bool:
    """True if there is a verdict and every verdict passed."""
    return bool(verdicts) and all(verdict.passed for verdict in verdicts)
