"""Means of maps without noise, from K independent replicates of both images.

A moment of an image without noise is a mean of products of different replicates, j != k, because
their noise is independent. SSIM and PSNR are computed from such moments (`Metric.noise_free`). Any
other score is extrapolated from sub-averages of the replicates, which have 2, 4 and 8 times the
noise's variance. The replicates of two images may share noise, those of the same index only: the
products omit it. Derivation and sources: docs/theory/scores.md.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from inim.scores.metrics import Metric, Viewing, score_maps
from inim.scores.metrics.base import noise_free_maps
from inim.scores.regression.verdict import freedom_of_sum

#: Side of a block in view pixels.
BLOCK_PX = 16
# Errors of neighbouring pixels are correlated over about 2.2 pixels: the mean distance is
# 1.5 * sqrt(2) * sqrt(2 / pi) = 1.7 within SSIM's window, a Gaussian of 1.5, and 4 / 3 within
# lenses of 4 pixels. Blocks of side L lose the correlation across their borders, and keep
# (1 - 2.2 / L)^2 of the variance. FLIP's errors need no larger value.
COUPLING = (1 - 2.2 / BLOCK_PX) ** -2
# Share of a second-order correction, and of an extrapolation, that may be wrong.
_UNSURE_SECOND_ORDER, _UNSURE_EXTRAPOLATION = 0.5, 0.25
# Ratio of the increments of a score if its noise doubles: 2 while the score is linear in the
# variance. It rises towards 2 as the noise falls, by about 0.1 from the measured levels.
_INCREMENT_RATIOS, _RISE = (1.3, 2.0), 0.1
# Share of noise in SSIM's denominator, mean over the pixels, above which its expansion to second
# order fails: the interval is unknown.
_MOST_NOISE = 0.35


@dataclass(frozen=True)
class MeanEstimate:
    """The mean of a map over a mask, with its uncertainty."""

    mean: float
    error: float  #: Standard error; infinite if unknown.
    freedom: float  #: Degrees of freedom of `error`.
    extension: tuple[float, float]  #: By how much the interval is longer below and above.
    #: (contrasts, rows, columns) float32: changes of the mean by the noise of each block; the sum
    #: of their squares is the squared error without coupling.
    responses: np.ndarray | None = None


#: Estimates the mean without noise over a mask, (rows, columns) bool. The map of a score without a
#: map has one pixel.
Estimator = Callable[[np.ndarray], MeanEstimate]


def estimators(
    metrics: Sequence[Metric], reference: np.ndarray, test: np.ndarray, viewing: Viewing | None
) -> dict[str, Estimator]:
    """Estimators by `Metric.key`, from replicates in linear RGB, (K, rows, columns, 3)."""
    with_moments = [metric for metric in metrics if metric.noise_free is not None]
    maps = noise_free_maps(with_moments, reference, test)
    result: dict[str, Estimator] = {key: partial(_from_moments, m) for key, m in maps.items()}
    keys = [metric.key for metric in metrics if metric.key not in result]
    if keys:
        result |= _extrapolations(keys, reference, test, viewing)
    return result


def _from_moments(maps: np.ndarray, mask: np.ndarray) -> MeanEstimate:
    """Estimate a mean from the maps of `Metric.noise_free`."""
    count, size = len(maps) - 3, np.count_nonzero(mask)
    mean, first_order, noise = (float(m[mask].mean(dtype=np.float64)) for m in maps[:3])
    scale = math.sqrt((count - 1) / count) / size  # of the delete-one jackknife
    responses = scale * np.stack([sum_blocks(np.where(mask, change, 0)) for change in maps[3:]])
    rest = _UNSURE_SECOND_ORDER * (first_order - mean)
    error, freedom = error_of_responses(responses)
    if not noise <= _MOST_NOISE:
        error = math.inf
    return MeanEstimate(mean, error, freedom, (max(-rest, 0.0), max(rest, 0.0)), responses)


def _extrapolations(
    keys: Sequence[str], reference: np.ndarray, test: np.ndarray, viewing: Viewing | None
) -> dict[str, Estimator]:
    """Estimators of metrics without `Metric.noise_free`, from sub-averages of the replicates."""

    def score(left_out: slice | int, images: slice = slice(None)) -> dict[str, np.ndarray]:
        means = [np.delete(s[images], left_out, axis=0).mean(axis=0) for s in (reference, test)]
        return score_maps(means[0], means[1], keys, viewing)

    whole, count = slice(0), len(reference)
    levels = {key: [np.atleast_2d(values)] for key, values in score(whole).items()}
    responses: dict[str, np.ndarray] = {}
    for parts in (parts for parts in (2, 4, 8) if count % parts == 0):
        size = count // parts
        scores = [score(whole, slice(i, i + size)) for i in range(0, count, size)]
        for key, means in levels.items():
            maps = [np.atleast_2d(scores_of_part[key]) for scores_of_part in scores]
            means.append(sum(maps[1:], maps[0].astype(np.float64)) / parts)
            if key not in responses:  # the difference of the halves has noise only
                responses[key] = (maps[0] - maps[1])[None] / 2
    without_map = [key for key, means in levels.items() if means[0].size == 1]
    if without_map:  # there are no blocks: leave out each replicate instead
        scores = [score(k) for k in range(count)]
        for key in without_map:
            values = np.array([scores_of_part[key] for scores_of_part in scores])[:, None, None]
            responses[key] = math.sqrt((count - 1) / count) * (values - values.mean())
    return {key: partial(_from_levels, means, responses[key]) for key, means in levels.items()}


def _from_levels(
    levels: Sequence[np.ndarray], responses: np.ndarray, mask: np.ndarray
) -> MeanEstimate:
    """Extrapolate a mean to no noise from its values at 1, 2, 4, ... times the noise's variance."""
    means = [float(level[mask].mean(dtype=np.float64)) for level in levels]
    blocks = [sum_blocks(np.where(mask, response, 0)) for response in responses]
    responses = np.stack(blocks) / np.count_nonzero(mask)
    increments = np.diff(means)
    before, after = increments[:-1].sum(), increments[1:].sum()
    ratio = after / before + _RISE if before else _INCREMENT_RATIOS[1]
    low, high = _INCREMENT_RATIOS
    correction = float(increments[0]) / (min(max(ratio, low), high) - 1)
    error, freedom = error_of_responses(responses)
    rest = _UNSURE_EXTRAPOLATION * abs(correction)
    return MeanEstimate(means[0] - correction, error, freedom, (rest, rest), responses)


def sum_blocks(values: np.ndarray, block_px: tuple[int, int] = (BLOCK_PX, BLOCK_PX)) -> np.ndarray:
    """Sums of a (rows, columns) map over blocks of rows and columns, float64."""
    values = values.astype(np.float64)
    for axis, side in enumerate(block_px):
        values = np.add.reduceat(values, np.arange(0, values.shape[axis], side), axis=axis)
    return values


def error_of_responses(responses: np.ndarray) -> tuple[float, float]:
    """Standard error from `MeanEstimate.responses`, and its degrees of freedom.

    The jackknife's K responses of a block have K - 1 degrees.
    """
    degrees = max(1, len(responses) - 1)
    squares = np.square(responses).sum(axis=0)
    coupling = COUPLING if squares.size > 1 else 1.0
    freedom = freedom_of_sum(squares.sum(), np.square(squares).sum(), degrees)
    return math.sqrt(coupling * float(squares.sum())), float(freedom)
