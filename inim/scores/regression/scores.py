"""Noise-corrected scores with standard errors, from the two halves of a run's samples.

A score is the mean of a local map m. The difference of the halves a, b is pure noise, so images
shifted by ``h (a - b) / 2`` and its opposite measure how the score responds to the run's own noise:

    D(h) = (m(+h) - m(-h)) / h                expectation 0 in every block, symmetric in sign
    error^2 = c sum over blocks (sum of D in the block)^2 / (4 N^2)
    bias = (mean of m(+h) + mean of m(-h) - 2 mean of m) / (2 h^2)

The noise-corrected score is the mean of m minus the bias: the extrapolation from ``1 + h^2`` times
the variance to none, h^2 = -1. Its own error follows from D, extrapolated to the same point:

    D(i) = D(h) - (1 + h^2) (D(2 h) - D(h)) / (3 h^2)         at h^2 = -1

Runs are compared by their uncorrected scores, which scatter least. If sample counts differ, a score
is expected to change by ``bias (r^2 - 1)``, where r is the ratio of the ground truth's standard
errors. A score without a map responds as a whole: its D^2 is the mean over fixed random patterns of
signs by which the blocks are shifted. Derivation and sources: docs/theory/scores.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from inim.image.noisy_image import NoisyImage
from inim.scores.document_parts import Check
from inim.scores.metrics import Metric, Viewing, all_metrics, find, score_maps
from inim.scores.regression.document import EstimateRecord
from inim.scores.regression.verdict import (
    FALSE_ALARM_RATE,
    freedom_of_sum,
    sidak,
    welch_half_width,
    welch_p_value,
    within,
)

#: One minus the confidence of the interval of a single score.
INTERVAL_LEVEL = 0.05
# Largest ratio of a map's mean to its noise-corrected mean, if the score is not the mean: scores
# of images that differ by noise only would be infinite.
_MOST_CORRECTED = 50.0
# Variance ratios outside this range do not come from sample counts and have their own verdict.
_SCALES = (0.5, 2.0)
# Side of a block in view pixels.
_BLOCK_PX = 16
# Errors of D are correlated over about 2.2 pixels: the mean distance is 1.5 * sqrt(2) *
# sqrt(2 / pi) = 1.7 within SSIM's window, a Gaussian of 1.5, and 4 / 3 within lenses of 4 pixels.
# Blocks of side L lose the correlation across their borders, and keep (1 - 2.2 / L)^2 of the
# variance. FLIP's errors need no larger value.
_COUPLING = (1 - 2.2 / _BLOCK_PX) ** -2
# Patterns of signs for a score without a map, two evaluations each: its degrees of freedom.
_PATTERNS = 8
# The step h: noise grows by h^2, and differences are far above float32's rounding.
_STEP = 0.25
_STEPS = (_STEP, -_STEP, 2 * _STEP, -2 * _STEP)


@dataclass(frozen=True)
class ScoreEstimate:
    """A score with its uncertainty."""

    plain: float  #: Score of the noisy images.
    error: float  #: Standard error of `plain`.
    freedom: float  #: Degrees of freedom of `error`.
    bias: float  #: Change of `plain` if the noise's variance doubled.
    #: Standard error of `value`; infinite if unknown, as in a baseline.
    value_error: float = math.inf
    value_freedom: float = 1.0  #: Degrees of freedom of `value_error`.
    #: Largest usual bias that `value` keeps, with the sign of `bias`.
    remaining_bias: float = 0.0

    @property
    def value(self) -> float:
        """Noise-corrected score, to first order in the variance."""
        return self.plain - self.bias

    def as_record(self) -> EstimateRecord:
        """Return the compared values for a baseline's JSON; values that are not finite are null."""
        values = {name: getattr(self, name) for name in EstimateRecord.__struct_fields__}
        return EstimateRecord(**{k: v if math.isfinite(v) else None for k, v in values.items()})

    @classmethod
    def of(cls, record: EstimateRecord) -> ScoreEstimate:
        """Inverse of `as_record`; null becomes NaN, which passes no check.

        A score without a value, but with an error of 0, is infinite: its images are identical.
        """
        values = msgspec.structs.asdict(record)
        if record.plain is None and record.error == 0:
            values["plain"] = math.inf
        return cls(**{n: math.nan if value is None else value for n, value in values.items()})


# An image, and the difference of its halves.
_ImageAndNoise = tuple[np.ndarray, np.ndarray]


def view_scores(
    reference: NoisyImage,
    test: NoisyImage,
    region: np.ndarray | None = None,
    keys: Sequence[str] | None = None,
    viewing: Viewing | None = None,
) -> dict[str, ScoreEstimate]:
    """Scores of a view with their errors, by `inim.scores.metrics.Metric.key`.

    * `region`, (rows, columns) bool: the relic's region, for additional scores by `on_relic_key`.
    * `keys`: `inim.scores.metrics.Metric.key` of the metrics to compute; default: all.
    * `viewing`: without it, metrics with `needs_viewing` are left out.
    """
    metrics = [m for m in all_metrics() if keys is None or m.key in keys]
    truth, view = _image_and_noise(reference), _image_and_noise(test)
    maps = score_maps(truth[0], view[0], [metric.key for metric in metrics], viewing)
    metrics = [metric for metric in metrics if metric.key in maps]
    with_map = [metric for metric in metrics if maps[metric.key].ndim]

    steps = [
        score_maps(_shift(*truth, step), _shift(*view, step), [metric.key for metric in with_map])
        for step in map(np.float32, _STEPS)
    ]
    values = {metric.key: float(maps[metric.key]) for metric in metrics if metric not in with_map}
    estimates = _estimate_without_maps(truth, view, values, viewing)
    scores = {}
    for metric in metrics:
        key = metric.key
        areas: dict[str, np.ndarray | None] = {key: None}
        if metric.has_relic_score and region is not None and metric in with_map:
            areas[metric.on_relic_key] = region
        for name, area in areas.items():
            mean = estimates.get(key) or _estimate_mean(
                maps[key],
                [step_maps[key] for step_maps in steps],
                metric.score_mask(maps[key].shape, area),
            )
            remaining = metric.remaining_bias * mean.bias
            scores[name] = _score_from_mean(metric, replace(mean, remaining_bias=remaining))
    return scores


def _image_and_noise(image: NoisyImage) -> _ImageAndNoise:
    first, second = image.halves()
    return image.image, first - second


def _shift(image: np.ndarray, difference: np.ndarray, step: np.ndarray | np.float32) -> np.ndarray:
    """Shift an image towards its first half by a step, or by (rows, columns, 1) steps."""
    result: np.ndarray = image + step / 2 * difference
    return result


def _odd_responses(maps: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """D(h) and D(i) from the values at `_STEPS`; see the module."""
    plus, minus, far_plus, far_minus = (values.astype(np.float64) for values in maps)
    near, far = (plus - minus) / _STEP, (far_plus - far_minus) / (2 * _STEP)
    return near, near - (1 + _STEP**2) / (3 * _STEP**2) * (far - near)


def _estimate_mean(
    plain_map: np.ndarray, maps: Sequence[np.ndarray], mask: np.ndarray
) -> ScoreEstimate:
    """Estimate a mean over a mask, from the image's map and the maps at `_STEPS`."""
    size = np.count_nonzero(mask)
    if not size:
        return ScoreEstimate(math.nan, math.nan, 1.0, math.nan, math.nan)
    (error, freedom), (value_error, value_freedom) = (
        _error_of_sum(np.where(mask, odd, 0.0)) for odd in _odd_responses(maps)
    )
    plain, plus, minus = (
        float(values[mask].mean(dtype=np.float64)) for values in (plain_map, *maps[:2])
    )
    bias = (plus + minus - 2 * plain) / (2 * _STEP**2)
    return ScoreEstimate(plain, error / size, freedom, bias, value_error / size, value_freedom)


def _error_of_sum(blocks: np.ndarray) -> tuple[float, float]:
    """Standard error of a map's sum from its odd response, and its degrees of freedom."""
    for axis in (0, 1):
        blocks = np.add.reduceat(blocks, np.arange(0, blocks.shape[axis], _BLOCK_PX), axis=axis)
    squares = np.square(blocks)
    freedom = freedom_of_sum(squares.sum(), np.square(squares).sum())
    return math.sqrt(_COUPLING * float(squares.sum())) / 2, float(freedom)


def _estimate_without_maps(
    reference: _ImageAndNoise,
    test: _ImageAndNoise,
    values: Mapping[str, float],
    viewing: Viewing | None,
) -> dict[str, ScoreEstimate]:
    """Estimate scores without a map, given by key, from blocks shifted with random signs."""
    if not values:
        return {}
    random = np.random.default_rng(0)
    rows, columns = reference[0].shape[:2]
    blocks = math.ceil(rows / _BLOCK_PX), math.ceil(columns / _BLOCK_PX)
    samples: dict[str, list[list[float]]] = {key: [] for key in values}
    for _ in range(_PATTERNS):
        block_signs = random.choice(np.array([-1, 1], np.float32), blocks)
        signs = np.repeat(np.repeat(block_signs, _BLOCK_PX, 0), _BLOCK_PX, 1)
        signs = signs[:rows, :columns, None]
        scores = [
            score_maps(_shift(*reference, step), _shift(*test, step), [*values], viewing)
            for step in (np.float32(size) * signs for size in _STEPS)
        ]
        for key, rows_of_key in samples.items():
            rows_of_key.append([float(score[key]) for score in scores])
    return {key: _estimate_whole(values[key], np.array(rows)) for key, rows in samples.items()}


def _estimate_whole(plain: float, samples: np.ndarray) -> ScoreEstimate:
    """Estimate a score from its values at `_STEPS` for each pattern, (patterns, 4)."""
    error, value_error = (
        math.sqrt(_COUPLING * float(np.square(odd).mean())) / 2
        for odd in _odd_responses([*samples.T])
    )
    freedom = float(len(samples))
    bias = (float(samples[:, :2].mean()) - plain) / _STEP**2
    return ScoreEstimate(plain, error, freedom, bias, value_error, freedom)


def _score_from_mean(metric: Metric, mean: ScoreEstimate) -> ScoreEstimate:
    """Convert a map's mean to the metric's score, with errors and biases."""
    if metric.score_from_mean is None:
        return mean
    plain, slope = metric.score_from_mean(mean.plain)
    if not slope:
        return ScoreEstimate(plain, 0.0, 1.0, 0.0, 0.0)
    least = mean.plain / _MOST_CORRECTED
    value, value_slope = metric.score_from_mean(max(mean.value, least))
    farthest, _ = metric.score_from_mean(max(mean.value - mean.remaining_bias, least))
    return replace(
        mean,
        plain=plain,
        error=abs(slope) * mean.error,
        bias=plain - value,
        value_error=abs(value_slope) * mean.value_error,
        remaining_bias=value - farthest,
    )


def score_interval(score: ScoreEstimate, level: float = INTERVAL_LEVEL) -> tuple[float, float]:
    """Interval of the score with unlimited samples, at confidence ``1 - level``.

    It is longer on the side towards which the bias was corrected.
    """
    half, rest = scatter(score, level), score.remaining_bias
    return score.value - half - max(rest, 0.0), score.value + half - min(rest, 0.0)


def scatter(score: ScoreEstimate, level: float = INTERVAL_LEVEL) -> float:
    """Half width of the range of the score under fresh seeds, at confidence ``1 - level``."""
    return _half_width(level, 0.0, 1.0, score.value_error, score.value_freedom)


def is_above(score: ScoreEstimate, other: ScoreEstimate, tests: int = 1) -> bool:
    """True if a score is significantly above another, in one of several tests."""
    errors = other.value_error, other.value_freedom, score.value_error, score.value_freedom
    rest = max(score.remaining_bias, 0.0) - min(other.remaining_bias, 0.0)
    return score.value - other.value > _half_width(sidak(INTERVAL_LEVEL, tests), *errors) + rest


def _half_width(level: float, *errors: float) -> float:
    """Half width of a difference's interval, from both errors and their degrees of freedom."""
    error_a, freedom_a, error_b, freedom_b = map(np.asarray, errors)
    return float(welch_half_width(error_a, freedom_a, error_b, freedom_b, level))


def compare_scores(
    baseline: Mapping[str, Mapping[str, ScoreEstimate]],
    candidate: Mapping[str, Mapping[str, ScoreEstimate]],
    noise_ratio: float = 1.0,
) -> list[Check]:
    """Verdicts on the baseline's scores; a score that rises is as suspicious as one that falls.

    Scores are by scored object ("template/left"), then by score name ("ssim_to_reference"); one
    that the candidate lacks fails. `noise_ratio` is the ratio of the candidate's standard errors to
    the baseline's.
    """
    tests = sum(len(scores) for scores in baseline.values())
    level = sidak(FALSE_ALARM_RATE, tests)
    scale = noise_ratio**2 if math.isfinite(noise_ratio) else 1.0
    scale = min(max(scale, _SCALES[0]), _SCALES[1])
    return [
        _verdict(
            f"{scored}: {_label(name)}",
            name,
            old,
            candidate.get(scored, {}).get(name),
            level,
            scale,
        )
        for scored, scores in baseline.items()
        for name, old in scores.items()
    ]


def _verdict(
    label: str, name: str, old: ScoreEstimate, new: ScoreEstimate | None, level: float, scale: float
) -> Check:
    metric = find(name)
    smallest, unit = (metric.tolerance, metric.unit) if metric else (0.0, "")
    label = f"{label} against the baseline"
    if new is None or metric is None:
        detail = "the score is missing" if metric else "its metric is not installed"
        return within(label, "score", math.nan, math.nan, smallest, unit=unit, detail=detail)
    if old.plain == new.plain == math.inf:
        # Both equal the reference exactly: there is no error.
        return within(label, "score", 0.0, 0.0, smallest, unit=unit, detail="identical pictures")
    expected = (old.bias + new.bias / scale) / 2 * (scale - 1)
    change = new.plain - old.plain - expected
    errors = old.error, old.freedom, new.error, new.freedom
    is_finite = math.isfinite(change)
    half = _half_width(level, *errors) if is_finite else math.nan
    p = float(welch_p_value(*map(np.asarray, (change, *errors)))) if is_finite else None
    detail = f"{new.plain:.4f}, baseline {old.plain:.4f}"
    if abs(expected) > smallest / 10:
        detail += f", {expected:+.4f} of it due to the number of samples"
    return within(label, "score", change, half, smallest, unit=unit, p_value=p, detail=detail)


def _label(name: str) -> str:
    """Label of a score: ``psnr_on_relic_to_reference_db`` is "PSNR on relic to reference"."""
    metric = find(name)
    first, _, rest = name.partition("_")
    words = rest.removesuffix(metric.unit.lower() if metric else "").replace("_", " ").strip()
    against = [] if words.endswith("to reference") else ["to ground truth"]
    return " ".join(filter(None, [metric.label if metric else first.upper(), words, *against]))
