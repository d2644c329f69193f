"""What the scores of drawn displays say: of each parameter alone, and of all together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median

from msgspec.structs import replace

from inim.display.misalignment import misalignment_text
from inim.documents.tolerate import (
    DrawAlone,
    DrawTogether,
    LossCurve,
    ParameterTolerance,
    Together,
)
from inim.errors import SceneError
from inim.tolerate.curve import Curve, fit_curve, share_interval, tolerance_interval
from inim.tolerate.study import LEAST_ALONE, ToleranceStudy

# Of figures that were fitted or drawn: no draw knows more, and another processor rounds alike.
_DIGITS = 4
# Of a normal error: the median of its size is this part of its standard deviation.
_MEDIAN_OF_NORMAL = 0.6745
_HALVINGS = 40
# Of a curve's line, either way.
_POINTS = 20

Scores = Mapping[str, float | None]


def parameter_tolerances(
    study: ToleranceStudy, scores: Scores, criterion: float, reached: Mapping[str, float]
) -> tuple[list[ParameterTolerance], Together | None]:
    """Tolerances of each parameter alone, and losses of displays with all errors at once.

    Parameters
    ----------
    study : ToleranceStudy
    scores : mapping of str to float or None
        Of each display, by its `misalignment_text`; None: it could not be validated.
    criterion : float
    reached : mapping of str to float
        Standard errors of a calibration, by parameter.

    Raises
    ------
    SceneError
        The display as designed has no score.
    """
    aligned = aligned_score(scores)
    rows: list[ParameterTolerance] = []
    curves: dict[str, Curve] = {}
    for name, spread in study.spreads.items():
        draws = _scored([{name: error} for error in study.draw_alone(name)], scores)
        row = ParameterTolerance(
            name=name,
            distribution=spread.distribution,
            spread=spread.size,
            farthest=_rounded(study.reach * spread.size),
            tolerance=None,
            interval=None,
            curve=None,
            scatter=None,
            calibration_standard_error=reached.get(name),
            draws=[DrawAlone(error=errors[name], score=score) for errors, score in draws],
        )
        if len(draws) >= LEAST_ALONE:
            losses = [(errors[name], aligned - score) for errors, score in draws]
            curves[name], row = _alone(row, losses, criterion, f"{study.seed} {name}")
        rows.append(row)
    together = _scored(study.draw_together(), scores)
    return rows, _together(together, aligned, criterion, rows, curves) if together else None


def aligned_score(scores: Scores) -> float:
    """Score of the display as designed."""
    aligned = scores.get("")
    if aligned is None:
        raise SceneError("the display as designed has no score: the relic is in none of its views")
    return aligned


def _scored(
    drawn: Sequence[Mapping[str, float]], scores: Scores
) -> list[tuple[Mapping[str, float], float]]:
    """The draws that have a score, with it."""
    pairs = [(errors, scores.get(misalignment_text(errors))) for errors in drawn]
    return [(errors, score) for errors, score in pairs if score is not None]


def _alone(
    row: ParameterTolerance, losses: Sequence[tuple[float, float]], criterion: float, seed: str
) -> tuple[Curve, ParameterTolerance]:
    """The curve through a parameter's draws, and its row with what follows from the curve."""
    errors, lost = zip(*losses, strict=True)
    farthest = row.farthest
    curve = fit_curve(errors, lost, criterion)
    tolerance = curve.tolerance(criterion)
    off = median(abs(curve.loss(error) - loss) for error, loss in losses) / _MEDIAN_OF_NORMAL
    low, high = tolerance_interval(curve, errors, lost, farthest, criterion, seed)
    return curve, replace(
        row,
        tolerance=_rounded(tolerance) if tolerance <= farthest else None,
        interval=(_rounded_or_none(low), _rounded_or_none(high)),
        curve=LossCurve(
            power=_rounded(curve.power),
            below=_rounded(curve.below),
            above=_rounded(curve.above),
            line=[(_rounded(e), _rounded(curve.loss(e))) for e in _places(farthest)],
        ),
        scatter=_rounded(off),
    )


def _places(farthest: float) -> list[float]:
    """Errors to draw a curve at, closer together near zero."""
    half = [farthest * (i / _POINTS) ** 2 for i in range(_POINTS + 1)]
    return [-error for error in half[:0:-1]] + half


def _together(
    drawn: Sequence[tuple[Mapping[str, float], float]],
    aligned: float,
    criterion: float,
    rows: Sequence[ParameterTolerance],
    curves: Mapping[str, Curve],
) -> Together:
    """The share of displays that lose no more, and whether losses add up."""
    lost = [aligned - score for _, score in drawn]
    passed = sum(loss <= criterion for loss in lost)
    whole = len(curves) == len(rows)
    sums = [
        sum(curve.loss(errors[name]) for name, curve in curves.items()) if whole else None
        for errors, _ in drawn
    ]
    # Of losses that matter: small ones are noise.
    ratios = [
        loss / total
        for loss, total in zip(lost, sums, strict=True)
        if total is not None and total >= criterion / 2
    ]
    low, high = share_interval(passed, len(drawn))
    return Together(
        share=passed / len(drawn),
        interval=(_rounded(low), _rounded(high)),
        to_sum=_rounded(median(ratios)) if ratios else None,
        part_of_each=_rounded_or_none(_part_of_each(rows, curves, criterion)),
        draws=[
            DrawTogether(errors=dict(errors), score=score, sum_of_losses=_rounded_or_none(total))
            for (errors, score), total in zip(drawn, sums, strict=True)
        ],
    )


def _part_of_each(
    rows: Sequence[ParameterTolerance], curves: Mapping[str, Curve], criterion: float
) -> float | None:
    """The part of its tolerance that each error may have at once, if losses add up."""
    bears = {row.name: row.tolerance for row in rows if row.tolerance is not None}
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS if bears else 0):
        part = (low + high) / 2
        total = sum(
            max(curves[name].loss(part * end), curves[name].loss(-part * end))
            for name, end in bears.items()
        )
        low, high = (part, high) if total <= criterion else (low, part)
    return high if bears else None


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


def _rounded_or_none(value: float | None) -> float | None:
    return None if value is None else _rounded(value)
