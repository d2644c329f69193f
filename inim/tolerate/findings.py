"""Tolerances of single parameters, and losses of displays with all errors at once.

The loss of SSIM from an error e of one parameter, with all others exact, follows a law fitted to
draws:

    L(e) = 1 - exp(-(|e| / w)^p),   with separate w below and above zero

It is 0 at e = 0, grows as a power of small errors (p = 1 if an error exchanges whole pixels, 2
if it mixes neighbours), and saturates. The law is not derived from optics:
the scatter of the draws around it is reported with it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from random import Random
from statistics import median

import numpy as np
from msgspec.structs import replace

from inim.display.misalignment import misalignment_text
from inim.documents.display import DrawAlone, DrawTogether, LossCurve, ParameterTolerance, Together
from inim.errors import SceneError
from inim.tolerate.study import LEAST_ALONE, ToleranceStudy, round_digits

# Median of |x| over the standard deviation, for a normal distribution.
_MEDIAN_OF_NORMAL = 0.6745
_HALVINGS = 40
# Points of a curve's line on either side.
_POINTS = 20

Scores = Mapping[str, float | None]


def parameter_tolerances(
    study: ToleranceStudy, scores: Scores, criterion: float, reached: Mapping[str, float]
) -> tuple[list[ParameterTolerance], Together | None]:
    """Compute the tolerance of each parameter, and the losses of displays with all errors at once.

    `scores` are by `misalignment_text`, None if a display could not be validated. `reached` are
    the standard errors of a calibration, by parameter. Raises `SceneError` if the display as
    designed has no score.
    """
    aligned = aligned_score(scores)
    rows: list[ParameterTolerance] = []
    curves: dict[str, Curve] = {}
    for name, spread in study.spreads.items():
        draws = _pair_with_scores([{name: error} for error in study.draw_alone(name)], scores)
        row = ParameterTolerance(
            name=name,
            distribution=spread.distribution,
            spread=spread.size,
            farthest=round_digits(study.reach * spread.size),
            tolerance=None,
            interval=None,
            curve=None,
            scatter=None,
            calibration_standard_error=reached.get(name),
            draws=[DrawAlone(error=errors[name], score=score) for errors, score in draws],
        )
        if len(draws) >= LEAST_ALONE:
            losses = [(errors[name], aligned - score) for errors, score in draws]
            curves[name], row = _fit_parameter(row, losses, criterion, f"{study.seed} {name}")
        rows.append(row)
    together = _pair_with_scores(study.draw_together(), scores)
    return rows, _together(together, aligned, criterion, rows, curves) if together else None


def aligned_score(scores: Scores) -> float:
    """Score of the display as designed."""
    aligned = scores.get("")
    if aligned is None:
        raise SceneError("the display as designed has no score: no view shows the relic")
    return aligned


def _pair_with_scores(
    draws: Sequence[Mapping[str, float]], scores: Scores
) -> list[tuple[Mapping[str, float], float]]:
    """Draws with their scores, without those that have none."""
    pairs = [(errors, scores.get(misalignment_text(errors))) for errors in draws]
    return [(errors, score) for errors, score in pairs if score is not None]


def _fit_parameter(
    row: ParameterTolerance, losses: Sequence[tuple[float, float]], criterion: float, seed: str
) -> tuple[Curve, ParameterTolerance]:
    """Fit the curve of one parameter's draws, and derive its row of results."""
    errors, lost = zip(*losses, strict=True)
    farthest = row.farthest
    curve = fit_curve(errors, lost, criterion)
    tolerance = curve.tolerance(criterion)
    off = median(abs(curve.loss(error) - loss) for error, loss in losses) / _MEDIAN_OF_NORMAL
    low, high = tolerance_interval(curve, errors, lost, farthest, criterion, seed)
    return curve, replace(
        row,
        tolerance=round_digits(tolerance) if tolerance <= farthest else None,
        interval=(_rounded_or_none(low), _rounded_or_none(high)),
        curve=LossCurve(
            power=round_digits(curve.power),
            below=round_digits(curve.below),
            above=round_digits(curve.above),
            line=[(round_digits(e), round_digits(curve.loss(e))) for e in _places(farthest)],
        ),
        scatter=round_digits(off),
    )


def _places(farthest: float) -> list[float]:
    """Errors at which a curve is drawn, denser near zero."""
    half = [farthest * (i / _POINTS) ** 2 for i in range(_POINTS + 1)]
    return [-error for error in half[:0:-1]] + half


def _together(
    draws: Sequence[tuple[Mapping[str, float], float]],
    aligned: float,
    criterion: float,
    rows: Sequence[ParameterTolerance],
    curves: Mapping[str, Curve],
) -> Together:
    """Share of displays within the criterion, and ratio of losses to the sums of single losses."""
    lost = [aligned - score for _, score in draws]
    passed = sum(loss <= criterion for loss in lost)
    whole = len(curves) == len(rows)
    sums = [
        sum(curve.loss(errors[name]) for name, curve in curves.items()) if whole else None
        for errors, _ in draws
    ]
    # Small losses are noise.
    ratios = [
        loss / total
        for loss, total in zip(lost, sums, strict=True)
        if total is not None and total >= criterion / 2
    ]
    low, high = share_interval(passed, len(draws))
    return Together(
        share=passed / len(draws),
        interval=(round_digits(low), round_digits(high)),
        to_sum=round_digits(median(ratios)) if ratios else None,
        part_of_each=_rounded_or_none(_part_of_each(rows, curves, criterion)),
        draws=[
            DrawTogether(errors=dict(errors), score=score, sum_of_losses=_rounded_or_none(total))
            for (errors, score), total in zip(draws, sums, strict=True)
        ],
    )


def _part_of_each(
    rows: Sequence[ParameterTolerance], curves: Mapping[str, Curve], criterion: float
) -> float | None:
    """Share of the tolerances that all errors may reach at once, if losses add up."""
    tolerances = {row.name: row.tolerance for row in rows if row.tolerance is not None}
    if not tolerances:
        return None
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        part = (low + high) / 2
        total = sum(
            max(curves[name].loss(part * end), curves[name].loss(-part * end))
            for name, end in tolerances.items()
        )
        low, high = (part, high) if total <= criterion else (low, part)
    return high


def _rounded_or_none(value: float | None) -> float | None:
    return None if value is None else round_digits(value)


_RESAMPLED = 200
_COVERAGE = 0.95
# Residuals above this, in units of `_stretched`, have linear instead of quadratic weight.
_OUTLIER = 0.1
_LEAST_POWER, _LARGEST_POWER = 0.5, 6.0


@dataclass(frozen=True)
class Curve:
    """The law of one parameter: its p, and its w below and above zero in the parameter's unit."""

    power: float
    below: float
    above: float

    def loss(self, error: float) -> float:
        """Loss caused by an error."""
        return float(_law(astuple(self), np.array(error)))

    def tolerance(self, criterion: float) -> float:
        """Largest error in either direction whose loss is within the criterion."""
        part: float = (-math.log1p(-criterion)) ** (1 / self.power)
        return min(self.below, self.above) * part


def fit_curve(
    errors: Sequence[float], losses: Sequence[float], criterion: float, near: Curve | None = None
) -> Curve:
    """Fit the law to draws; a few outliers change it little.

    Losses are compared in a scale that is linear up to the criterion and logarithmic beyond it, so
    that losses near the criterion decide. Not all errors are zero; the fit starts at `near`.
    """
    from scipy.optimize import least_squares

    e, lost = np.asarray(errors, float), np.asarray(losses, float)
    stretched_loss, farthest = _stretched(lost, criterion), float(np.abs(e).max())

    def curve(x: np.ndarray) -> tuple[float, float, float]:
        # The errors whose loss is the criterion depend far less on the power than the widths do.
        power, below, above = np.exp(x)
        wider = (-math.log1p(-criterion)) ** (1 / power)
        return power, below / wider, above / wider

    low = np.log([_LEAST_POWER, farthest / 1e3, farthest / 1e3])
    high = np.log([_LARGEST_POWER, farthest * 1e2, farthest * 1e2])
    starts = [(p, *[_crossing(e, lost, criterion, p)] * 2) for p in (1.0, 2.0)]
    if near is not None:
        wider = (-math.log1p(-criterion)) ** (1 / near.power)
        starts = [(near.power, near.below * wider, near.above * wider)]
    solutions = [
        least_squares(
            lambda x: _stretched(_law(curve(x), e), criterion) - stretched_loss,
            np.clip(np.log(start), low + 1e-6, high - 1e-6),
            bounds=(low, high),
            loss="soft_l1",
            f_scale=_OUTLIER,
        )
        for start in starts
    ]
    return Curve(*map(float, curve(min(solutions, key=lambda solution: float(solution.cost)).x)))


def _crossing(error: np.ndarray, lost: np.ndarray, criterion: float, power: float) -> float:
    """Median over the draws of the error whose loss would be the criterion by this draw alone."""
    counts = lost > criterion / 4
    if not counts.any():
        return float(3 * np.abs(error).max())
    return float(np.median(np.abs(error[counts]) * (criterion / lost[counts]) ** (1 / power)))


def _stretched(loss: np.ndarray, criterion: float) -> np.ndarray:
    stretched: np.ndarray = np.arcsinh(loss / criterion)
    return stretched


def _law(x: tuple[float, float, float], error: np.ndarray) -> np.ndarray:
    power, below, above = x
    width = np.where(error < 0, below, above)
    loss: np.ndarray = -np.expm1(-((np.abs(error) / width) ** power))
    return loss


def tolerance_interval(
    curve: Curve,
    errors: Sequence[float],
    losses: Sequence[float],
    farthest: float,
    criterion: float,
    seed: str,
) -> list[float | None]:
    """The 95 % interval of a curve's tolerance by bootstrap; None for ends beyond `farthest`."""
    tolerance, random = curve.tolerance(criterion), Random(seed)
    pairs = [pair for pair in zip(errors, losses, strict=True) if pair[0]]
    crossings = []
    for _ in range(_RESAMPLED):
        again = random.choices(pairs, k=len(pairs))
        fitted = fit_curve([e for e, _ in again], [loss for _, loss in again], criterion, curve)
        crossings.append(fitted.tolerance(criterion) / tolerance)
    crossings.sort()
    outside = round(len(crossings) * (1 - _COVERAGE) / 2)
    # The fitted parameters reduce the scatter of resampled draws.
    wider = math.sqrt(len(pairs) / (len(pairs) - len(astuple(curve))))
    ends = (tolerance * crossings[place] ** wider for place in (outside, -1 - outside))
    return [end if end <= farthest else None for end in ends]


def share_interval(passed: int, of: int) -> tuple[float, float]:
    """The 95 % interval of a share (Wilson 1927)."""
    z = 1.96
    middle, room = passed + z * z / 2, of + z * z
    half = z * math.sqrt(passed * (of - passed) / of + z * z / 4)
    return max((middle - half) / room, 0.0), min((middle + half) / room, 1.0)
