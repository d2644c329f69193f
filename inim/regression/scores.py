"""Scores with their standard errors, from the two independent halves of a run's samples.

A score is the mean of a local map m (SSIM's, FLIP's, or the squared error of PSNR). The run is
split into two halves a, b that share no random number: ground truth, capture, reconstruction.
Their difference is noise and nothing else, so pictures moved a little along it, by
``h (a - b) / 2`` either way, tell how the score answers to noise of the run's own kind, at the
run's own level:

    D = (m(+h) - m(-h)) / h                   expectation 0 in every block, either sign alike
    error^2 = c sum over blocks (sum of D in the block)^2 / (4 N^2)
    bias = (mean of m(+h) + mean of m(-h) - 2 mean of m) / (2 h^2)

That is the infinitesimal jackknife (Jaeckel, Bell Laboratories MM 72-1215-11, 1972); with h = 1 the
moved pictures would be the halves themselves, whose greater noise makes SSIM answer less than the
whole picture's does. Blocks are wider than what SSIM's window and a lens couple; `c` makes up for
what they couple across the blocks' borders.

The bias is by how much the score moves as the noise's variance grows by its own amount, SSIM of
noisy pictures being too low. That is all that noise adds to it where the map is smooth; FLIP takes
a root of small errors, and noise has added more. Runs of unlike sample counts are compared free of
it: a score is expected to move by ``bias (r^2 - 1)`` where the ground truth's standard errors grew
r times.

A score that is no mean of a map answers as a whole. There D^2 is the mean over some patterns of
signs, drawn once and for all, by which the blocks are moved: its expectation over all patterns is
the sum of the blocks' own squares (Hutchinson, Commun. Statist. Simul. 18, 1989).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from inim.metrics import Metric, all_metrics, find, score_maps
from inim.regression.verdict import (
    FALSE_ALARM_RATE,
    Verdict,
    freedom_of_sum,
    sidak,
    welch_half_width,
    welch_p_value,
    within,
)

__all__ = ["ScoreEstimate", "compare_scores", "score_interval", "view_scores"]

#: Confidence of the interval shown beside a single score.
SHOWN_LEVEL = 0.05
# A ratio of variances beyond these is no matter of sample counts, and has a verdict of its own.
_SCALES = (0.5, 2.0)
# Side of a block in view pixels.
_BLOCK_PX = 16
# Errors of D are alike over some 2.2 pixels: SSIM's window, a Gaussian of 1.5, meets itself
# at a mean distance of 1.5 * sqrt(2) * sqrt(2 / pi) = 1.7, and lenses of 4 pixels at 4 / 3. Blocks
# of side L miss what crosses their borders, and keep (1 - 2.2 / L)^2 of the variance. FLIP's errors
# proved to need no more.
_COUPLING = (1 - 2.2 / _BLOCK_PX) ** -2
# Patterns of signs for a score without a map, two evaluations each; so many degrees of freedom.
_PATTERNS = 8
# The step h: noise grows by h^2, and differences are far above float32's rounding.
_STEP = 0.25


@dataclass(frozen=True)
class ScoreEstimate:
    """A score and how sure it is.

    Attributes
    ----------
    value : float
        As reported.
    error : float
        Its standard error.
    freedom : float
        Degrees of freedom of `error`.
    bias : float
        What as much noise again would add to `value`.
    """

    value: float
    error: float
    freedom: float
    bias: float

    def as_data(self) -> dict[str, float | None]:
        """For JSON: what is not finite is null."""
        found = {"value": self.value, "error": self.error, "freedom": self.freedom}
        found["bias"] = self.bias
        return {k: v if math.isfinite(v) else None for k, v in found.items()}

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> ScoreEstimate:
        """From `as_data`; null is NaN, which passes nothing."""
        names = ("value", "error", "freedom", "bias")
        return cls(*(math.nan if data[n] is None else float(data[n]) for n in names))


def view_scores(
    reference: tuple[np.ndarray, np.ndarray, np.ndarray],
    test: tuple[np.ndarray, np.ndarray, np.ndarray],
    keys: Sequence[str] | None = None,
    maps: Mapping[str, np.ndarray] | None = None,
) -> dict[str, ScoreEstimate]:
    """Scores of a view, with their errors.

    Parameters
    ----------
    reference, test : three (rows, columns, 3) float32, linear RGB
        The picture, and the two halves it is the mean of.
    keys : sequence of str, optional
        `inim.metrics.Metric.key` of those wanted; all metrics without.
    maps : mapping of str to array, optional
        `inim.metrics.score_maps` of the pictures, if they are made already.
    """
    metrics = [m for m in all_metrics() if keys is None or m.key in keys]
    keys = [metric.key for metric in metrics]
    whole = score_maps(reference[0], test[0], keys) if maps is None else maps
    local = [key for key in keys if whole[key].ndim]
    plus, minus = (
        score_maps(_moved(*reference, sign), _moved(*test, sign), local)
        for sign in (np.float32(1), np.float32(-1))
    )
    found = {key: _estimate(whole[key], plus[key], minus[key]) for key in local}
    others = [key for key in keys if key not in found]
    found |= _without_maps(reference, test, {key: float(whole[key]) for key in others})
    return {metric.key: _of_mean(metric, found[metric.key]) for metric in metrics}


def _moved(
    whole: np.ndarray, first: np.ndarray, second: np.ndarray, sign: np.ndarray | np.float32
) -> np.ndarray:
    """The picture, a step towards either half: everywhere, or by a (rows, columns, 1) sign."""
    moved: np.ndarray = whole + sign * np.float32(_STEP / 2) * (first - second)
    return moved


def _estimate(whole: np.ndarray, plus: np.ndarray, minus: np.ndarray) -> ScoreEstimate:
    """See the module."""
    blocks = (plus.astype(np.float64) - minus) / _STEP
    for axis in (0, 1):
        blocks = np.add.reduceat(blocks, np.arange(0, blocks.shape[axis], _BLOCK_PX), axis=axis)
    squares = np.square(blocks)
    freedom = freedom_of_sum(squares.sum(), np.square(squares).sum())
    error = math.sqrt(_COUPLING * float(squares.sum())) / (2 * whole.size)
    value, above, below = (float(m.mean(dtype=np.float64)) for m in (whole, plus, minus))
    return ScoreEstimate(value, error, float(freedom), (above + below - 2 * value) / (2 * _STEP**2))


def _without_maps(
    reference: tuple[np.ndarray, np.ndarray, np.ndarray],
    test: tuple[np.ndarray, np.ndarray, np.ndarray],
    values: Mapping[str, float],
) -> dict[str, ScoreEstimate]:
    """Estimates of scores that have no map, from blocks moved with signs by chance; see the module.

    Parameters
    ----------
    reference, test : as `view_scores`
    values : mapping of str to float
        The scores, by key.
    """
    if not values:
        return {}
    random = np.random.default_rng(0)
    rows, columns = reference[0].shape[:2]
    blocks = math.ceil(rows / _BLOCK_PX), math.ceil(columns / _BLOCK_PX)
    moved: dict[str, list[tuple[float, float]]] = {key: [] for key in values}
    for _ in range(_PATTERNS):
        drawn = random.choice(np.array([-1, 1], np.float32), blocks)
        signs = np.repeat(np.repeat(drawn, _BLOCK_PX, 0), _BLOCK_PX, 1)[:rows, :columns, None]
        plus, minus = (
            score_maps(_moved(*reference, sign), _moved(*test, sign), [*values])
            for sign in (signs, -signs)
        )
        for key, pairs in moved.items():
            pairs.append((float(plus[key]), float(minus[key])))
    return {key: _by_patterns(values[key], np.array(pairs)) for key, pairs in moved.items()}


def _by_patterns(value: float, moved: np.ndarray) -> ScoreEstimate:
    """From the score and what it was with either sign of each pattern, (patterns, 2)."""
    answers = (moved[:, 0] - moved[:, 1]) / _STEP
    error = math.sqrt(_COUPLING * float(np.square(answers).mean())) / 2
    bias = (float(moved.sum(axis=1).mean()) - 2 * value) / (2 * _STEP**2)
    return ScoreEstimate(value, error, float(len(moved)), bias)


def _of_mean(metric: Metric, mean: ScoreEstimate) -> ScoreEstimate:
    """From a map's mean to the score that is made of it, errors to first order."""
    if metric.of_mean is None:
        return mean
    value, slope = metric.of_mean(mean.value)
    if not slope:
        return ScoreEstimate(value, 0.0, 1.0, 0.0)
    return ScoreEstimate(value, abs(slope) * mean.error, mean.freedom, slope * mean.bias)


def score_interval(score: ScoreEstimate, level: float = SHOWN_LEVEL) -> tuple[float, float]:
    """Where the score would lie with fresh seeds, at confidence ``1 - level``."""
    sure = ScoreEstimate(score.value, 0.0, 1.0, 0.0)
    half = float(welch_half_width(*_sides(sure, score), level))
    return score.value - half, score.value + half


def _sides(
    old: ScoreEstimate, new: ScoreEstimate
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    a, b, c, d = (np.asarray(x) for x in (old.error, old.freedom, new.error, new.freedom))
    return a, b, c, d


def compare_scores(
    baseline: Mapping[str, Mapping[str, ScoreEstimate]],
    candidate: Mapping[str, Mapping[str, ScoreEstimate]],
    noise_ratio: float = 1.0,
) -> list[Verdict]:
    """One verdict for each of the baseline's scores.

    Two-sided: a score that jumps up is as suspicious as one that falls, until somebody accepts it.

    Parameters
    ----------
    baseline, candidate : mapping of str to mapping of str to ScoreEstimate
        By what was scored ("template/left"), then by the score's name ("ssim_to_ceiling"). One
        that the candidate lacks fails.
    noise_ratio : float
        How many times the baseline's the candidate's standard errors are.
    """
    tests = sum(len(scores) for scores in baseline.values())
    level = sidak(FALSE_ALARM_RATE, tests)
    scale = noise_ratio**2 if math.isfinite(noise_ratio) else 1.0
    scale = min(max(scale, _SCALES[0]), _SCALES[1])
    return [
        _verdict(
            f"{what}: {_words(name)}", name, old, candidate.get(what, {}).get(name), level, scale
        )
        for what, scores in baseline.items()
        for name, old in scores.items()
    ]


def _verdict(
    label: str,
    name: str,
    old: ScoreEstimate,
    new: ScoreEstimate | None,
    level: float,
    scale: float,
) -> Verdict:
    metric = find(name)
    smallest, unit = (metric.tolerance, metric.unit) if metric else (0.0, "")
    label = f"{label} against the baseline"
    if new is None or metric is None:
        detail = "the score is missing" if metric else "its metric is not installed"
        return within(label, "score", math.nan, math.nan, smallest, unit=unit, detail=detail)
    if old.value == new.value == math.inf:
        # Both show the very reference: no difference is left to have an error.
        return within(label, "score", 0.0, 0.0, smallest, unit=unit, detail="identical pictures")
    expected = (old.bias + new.bias / scale) / 2 * (scale - 1)
    change = new.value - old.value - expected
    sides = _sides(old, new)
    half = float(welch_half_width(*sides, level)) if math.isfinite(change) else math.nan
    p = float(welch_p_value(np.asarray(change), *sides)) if math.isfinite(change) else None
    detail = f"{new.value:.4f}, baseline {old.value:.4f}"
    if abs(expected) > smallest / 10:
        detail += f", of which {expected:+.4f} by the number of samples"
    return within(label, "score", change, half, smallest, unit=unit, p_value=p, detail=detail)


def _words(name: str) -> str:
    """Words for a score's name: ``psnr_to_ceiling_db`` is "PSNR to ceiling"."""
    metric = find(name)
    first, _, against = name.partition("_")
    if metric is None:
        return f"{first.upper()} {against.replace('_', ' ')}".strip()
    against = against.removesuffix(metric.unit.lower()).replace("_", " ")
    return f"{metric.label} {against}".strip()
