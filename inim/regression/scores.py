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
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from inim.metrics import score_maps, scores_of
from inim.regression.inference import (
    FALSE_ALARM_RATE,
    freedom_of_sum,
    sidak,
    welch_half_width,
    welch_p_value,
)
from inim.regression.verdict import Verdict, within

__all__ = ["SMALLEST_CHANGES", "ScoreEstimate", "compare_scores", "score_interval", "view_scores"]

#: The smallest changes that count. SSIM and FLIP: half of the last digit but one that reports
#: quote; where algorithms differ, they differ by hundredths. PSNR: below a tenth of a decibel no
#: one sees it.
SMALLEST_CHANGES = {"ssim": 0.005, "flip": 0.005, "psnr": 0.1}
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
    names: Sequence[str] = ("ssim", "psnr_db", "flip"),
    maps: Mapping[str, np.ndarray] | None = None,
) -> dict[str, ScoreEstimate]:
    """SSIM, PSNR and FLIP of a view, with their errors.

    Parameters
    ----------
    reference, test : three (rows, columns, 3) float32, linear RGB
        The picture, and the two halves it is the mean of.
    names : sequence of str
        Those wanted.
    maps : mapping of str to (rows, columns), optional
        `inim.metrics.score_maps` of the pictures, if they are made already.
    """
    whole = score_maps(reference[0], test[0], names) if maps is None else maps
    plus, minus = (
        score_maps(_moved(*reference, step), _moved(*test, step), names) for step in (1, -1)
    )
    values = scores_of(whole)
    found = {}
    for name in names:
        one = _estimate(whole[name], plus[name], minus[name])
        found[name] = _decibels(one, values[name]) if name == "psnr_db" else one
    return found


def _moved(whole: np.ndarray, first: np.ndarray, second: np.ndarray, sign: int) -> np.ndarray:
    """The picture, a step towards either half."""
    moved: np.ndarray = whole + np.float32(sign * _STEP / 2) * (first - second)
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


def _decibels(squared: ScoreEstimate, value: float) -> ScoreEstimate:
    """From a mean squared error to the PSNR that it is, errors to first order."""
    if not squared.value > 0:
        return ScoreEstimate(value, 0.0, 1.0, 0.0)
    slope = 10 / math.log(10) / squared.value
    return ScoreEstimate(value, slope * squared.error, squared.freedom, -slope * squared.bias)


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
    smallest = SMALLEST_CHANGES[name.partition("_")[0]]
    unit = "dB" if name.startswith("psnr") else ""
    label = f"{label} against the baseline"
    if new is None:
        detail = "the score is missing"
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
    metric, _, against = name.removesuffix("_db").partition("_")
    return f"{metric.upper()} {against.replace('_', ' ')}".strip()
