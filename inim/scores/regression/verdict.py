"""Verdicts as data, and their statistics, each with its formula and source.

Every test is two-sided. Levels are per family: the probability of any false alarm among a run's `m`
tests of one kind is `FAMILY_RATE`. `scipy.special` provides the distributions, because
`scipy.stats` takes two seconds to load.
"""

import math
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from inim.scores.document_parts import Check, Direction, Kind, Relation, Verdict

#: Probability that noise alone fails any test of an unchanged program: once in three years in a
#: daily check. The two families of tests, all tiles and all scores, have half of it each.
FALSE_ALARM_RATE = 1e-3
FAMILY_RATE = FALSE_ALARM_RATE / 2


def sidak(level: float, tests: int) -> float:
    """Level of each of `tests` tests for a family of the given `level`.

    ``1 - (1 - level)^(1/m)``; exact for independent tests, conservative for two-sided tests of
    correlated normal means.

    Source: Sidak, JASA 62, 1967.
    """
    return -math.expm1(math.log1p(-level) / max(1, tests))


def freedom_of_sum(squares: np.ndarray, fourths: np.ndarray, degrees: int = 1) -> np.ndarray:
    """Degrees of freedom of a sum of variance estimates with f = `degrees` degrees each.

    For ``S1 = sum v_i`` and ``S2 = sum v_i^2`` it is ``(f + 2) S1^2 / S2 - 2``, at least f: near
    ``n f`` for n equal estimates, and f for a single one.

    * `squares`, `fourths`, arrays of one shape: S1 and S2.

    Source: Welch, Biometrika 34, 1947: ``(sum v)^2 / sum(v^2 / (f + 2)) - 2``, which removes the
    bias of Satterthwaite's (1946) formula at few degrees.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = (degrees + 2) * np.square(squares) / fourths - 2
    # Without noise any finite number will do.
    return np.where(fourths > 0, np.maximum(freedom, degrees), 1.0)


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


def student_interval(sample: Sequence[float], level: float) -> tuple[float, float]:
    """Interval of the mean of two or more independent normal values.

    Source: Student, Biometrika 6, 1908.
    """
    from scipy.special import stdtrit

    mean, count = float(np.mean(sample)), len(sample)
    error = float(np.std(sample, ddof=1)) / math.sqrt(count)
    half = float(-stdtrit(count - 1, level / 2)) * error
    return mean - half, mean + half


def binomial_interval(count: int, trials: int, level: float) -> tuple[float, float]:
    """Exact interval of a share, observed as `count` of `trials`.

    Source: Clopper and Pearson, Biometrika 26, 1934.
    """
    from scipy.special import betainccinv, betaincinv

    low = 0.0 if count == 0 else float(betaincinv(count, trials - count + 1, level / 2))
    high = 1.0 if count == trials else float(betainccinv(count + 1, trials - count, level / 2))
    return low, high


#: Relation of a change to the largest that passes in either direction.
WITHIN: Relation = "within"


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


#: Excuse of a score that became better, if nothing else became worse; and of any failure if the
#: inputs changed.
BETTER: Direction = "better"
_INPUTS = "inputs changed"
# Kinds of checks that decide if inputs changed.
_DECIDING = ("score", "light")


def judge(
    checks: Sequence[Check], *, inputs_changed: bool, allow_changed_inputs: bool
) -> tuple[Verdict, list[Check]]:
    """Verdict of all checks of a comparison, and the checks with their excuses.

    If inputs changed, scores and light decide. Otherwise, an algorithm whose scores became better
    has other pictures, too.
    """
    failed = [check for check in checks if not check.passed]
    if not any(check.kind == "score" for check in checks):
        missing = within(
            "scores against the baseline",
            "score",
            math.nan,
            math.nan,
            0.0,
            detail="no score of both runs has the same name; choose another baseline",
        )
        return "not comparable", [*checks, missing]
    if inputs_changed:
        is_changed = any(check.kind in _DECIDING for check in failed)
        excused = [c for c in failed if allow_changed_inputs or c.kind not in _DECIDING]
        verdict: Verdict = (
            "inputs changed, scores changed"
            if is_changed
            else "inputs changed, scores within intervals"
        )
        return verdict, _excuse(checks, excused, _INPUTS)
    if not failed:
        return "passed", [*checks]
    better = [c for c in failed if c.kind == "score" and c.direction == BETTER]
    improved = {_algorithm(c) for c in better}
    images = [
        c for c in failed if c.kind in ("picture", "pixels", "light") and _algorithm(c) in improved
    ]
    if all(c in better or c in images for c in failed):
        return "improved", _excuse(checks, failed, BETTER)
    return "worse", _excuse(checks, failed, "")


def _excuse(checks: Sequence[Check], excused: Sequence[Check], reason: str) -> list[Check]:
    return [
        msgspec.structs.replace(check, excuse=reason if any(check is e for e in excused) else "")
        for check in checks
    ]


def _algorithm(check: Check) -> str:
    """Algorithm that a check's name begins with: `eia/NAME: ` or `NAME/VIEWPOINT: `."""
    subject = check.name.partition(": ")[0]
    is_eia = subject.startswith("eia/") and check.kind == "picture"
    return subject.removeprefix("eia/") if is_eia else subject.rpartition("/")[0] or subject
