"""Scores of views without noise, with intervals; scores with noise, with standard errors.

A rendered view has K replicates, whose scores without noise are estimated by
`inim.scores.regression.noise_free`. Runs are compared by their uncorrected scores, which scatter
least. Such a score is the mean of a local map m. The difference of the halves a, b is pure noise,
so images shifted by ``h (a - b) / 2`` and its opposite measure how the score responds to the run's
own noise:

    D(h) = (m(+h) - m(-h)) / h                expectation 0 in every block, symmetric in sign
    error^2 = c sum over blocks (sum of D in the block)^2 / (4 N^2)
    bias = (mean of m(+h) + mean of m(-h) - 2 mean of m) / (2 h^2)

If sample counts differ, a score is expected to change by ``bias (r^2 - 1)``, where r is the ratio
of the ground truth's standard errors. A score without a map responds as a whole: its D^2 is the
mean over fixed random patterns of signs by which the blocks are shifted.

For images without replicates, the score without noise is the mean of m minus the bias: the
extrapolation from ``1 + h^2`` times the variance to none, h^2 = -1. Its own error follows from D,
extrapolated to the same point:

    D(i) = D(h) - (1 + h^2) (D(2 h) - D(h)) / (3 h^2)         at h^2 = -1

Derivation and sources: docs/theory/scores.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from inim.image.noisy_image import NoisyImage
from inim.scores.document_parts import Check, Direction, Kind
from inim.scores.metrics import MAIN, Metric, Viewing, all_metrics, find, score_maps
from inim.scores.regression.document import EstimateRecord
from inim.scores.regression.noise_free import (
    BLOCK_PX,
    COUPLING,
    Estimator,
    MeanEstimate,
    error_of_responses,
    estimators,
    sum_blocks,
)
from inim.scores.regression.verdict import (
    BETTER,
    FAMILY_RATE,
    sidak,
    welch_half_width,
    welch_p_value,
    within,
)

#: One minus the confidence of the interval of a single score.
INTERVAL_LEVEL = 0.05
#: First word of the names of light scores (`inim.scores.regression.light`).
LIGHT = "light"
# Smallest change of light that counts, half of the error that a check must find: as a share of the
# light, per cent to the reference, and per cent of white (a third of an 8-bit code at black).
_LIGHT_SHARE, _LIGHT_TO_REFERENCE, _LIGHT_OF_WHITE = 0.005, 0.5, 0.01
# Largest ratio of a map's mean to its noise-corrected mean, if the score is not the mean: scores
# of images that differ by noise only would be infinite.
_MOST_CORRECTED = 50.0
# Variance ratios outside this range do not come from sample counts and have their own verdict.
_SCALES = (0.5, 2.0)
# Patterns of signs for a score without a map, two evaluations each: its degrees of freedom.
_PATTERNS = 8
# The step h: noise grows by h^2, and differences are far above float32's rounding.
_STEP = 0.25
_STEPS = (_STEP, -_STEP, 2 * _STEP, -2 * _STEP)


@dataclass(frozen=True)
class ScoreEstimate:
    """A score with its uncertainty.

    `plain`, `error`, `freedom` and `bias` are of the noisy images, for comparisons of runs. The
    others are of the score without noise; a baseline lacks them.
    """

    plain: float  #: Score of the noisy images.
    error: float  #: Standard error of `plain`.
    freedom: float  #: Degrees of freedom of `error`.
    bias: float  #: Change of `plain` if the noise's variance doubled.
    value: float = math.nan  #: Score without noise, within the metric's range.
    #: Interval of the score with unlimited samples at confidence ``1 - INTERVAL_LEVEL``, within the
    #: metric's range.
    interval: tuple[float, float] = (-math.inf, math.inf)
    value_error: float = math.inf  #: Standard error of `value`.
    value_freedom: float = 1.0  #: Degrees of freedom of `value_error`.
    #: By how much the interval is longer below and above: bias that `value` may keep.
    extension: tuple[float, float] = (0.0, 0.0)
    #: `MeanEstimate.responses` of the score; None without replicates.
    responses: np.ndarray | None = None

    @property
    def without_interval(self) -> ScoreEstimate:
        """The same with an unknown interval."""
        return replace(self, interval=(-math.inf, math.inf), value_error=math.inf, responses=None)

    def as_record(self) -> EstimateRecord:
        """Return the compared values for a baseline's JSON, to nine digits; null: not finite."""
        values = {
            name: float(f"{getattr(self, name):.9g}") for name in EstimateRecord.__struct_fields__
        }
        return EstimateRecord(**{k: v if math.isfinite(v) else None for k, v in values.items()})

    @classmethod
    def of(cls, record: EstimateRecord) -> ScoreEstimate:
        """Inverse of `as_record`; null becomes NaN, which passes no check.

        A score without a value, but with an error of 0, is infinite: its images are identical.
        """
        values = msgspec.structs.astuple(record)
        plain, error, freedom, bias = (math.nan if v is None else v for v in values)
        if record.plain is None and error == 0:
            plain = math.inf
        return cls(plain, error, freedom, bias)


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

    Scores without noise come from the replicates if both images have them, the same number, else
    from the halves.

    * `region`, (rows, columns) bool: the relic's region, for additional scores by `on_relic_key`.
    * `keys`: `inim.scores.metrics.Metric.key` of the metrics to compute; default: all.
    * `viewing`: without it, metrics with `needs_viewing` are left out.
    """
    metrics = [m for m in all_metrics() if keys is None or m.key in keys]
    truth, view = _image_and_noise(reference), _image_and_noise(test)
    maps = score_maps(truth[0], view[0], [metric.key for metric in metrics], viewing)
    metrics = [metric for metric in metrics if metric.key in maps]
    with_map = [metric for metric in metrics if maps[metric.key].ndim]

    noise_free: Mapping[str, Estimator] = {}
    if replicates := common_replicates(reference, test):
        noise_free = estimators(metrics, *replicates, viewing)
    steps = _STEPS[:2] if noise_free else _STEPS
    step_maps = [
        score_maps(_shift(*truth, step), _shift(*view, step), [metric.key for metric in with_map])
        for step in map(np.float32, steps)
    ]
    values = {metric.key: float(maps[metric.key]) for metric in metrics if metric not in with_map}
    estimates = _estimate_without_maps(truth, view, values, viewing, steps)
    scores = {}
    for metric in metrics:
        key = metric.key
        areas: dict[str, np.ndarray | None] = {key: None}
        if metric.has_relic_score and region is not None and metric in with_map:
            areas[metric.on_relic_key] = region
        for name, area in areas.items():
            if metric in with_map:
                mask = metric.score_mask(maps[key].shape, area)
                plain, mean = _estimate_mean(maps[key], [step[key] for step in step_maps], mask)
            else:
                mask = np.ones((1, 1), bool)
                plain, mean = estimates[key]
            if noise_free and mask.any():
                mean = noise_free[key](mask)
            else:
                rest = metric.remaining_bias * plain.bias
                mean = replace(mean, extension=(max(rest, 0.0), max(-rest, 0.0)))
            scores[name] = _score_from_mean(metric, plain, mean)
    return scores


def headline_half_width(reference: NoisyImage, test: NoisyImage, region: np.ndarray) -> float:
    """Half width of the interval of `view_scores` for the headline score.

    With replicates, the score with noise, which such an interval does not need, is not computed.
    """
    replicates = common_replicates(reference, test)
    if not replicates or MAIN.noise_free is None:
        scores = view_scores(reference, test, region, [MAIN.key])
        return half_width(scores[MAIN.on_relic_key])
    mask = MAIN.score_mask(region.shape, region)
    if not mask.any():
        return 0.0
    mean = estimators([MAIN], *replicates, None)[MAIN.key](mask)
    return half_width(_score_from_mean(MAIN, ScoreEstimate(math.nan, math.nan, 1, math.nan), mean))


def common_replicates(
    reference: NoisyImage, test: NoisyImage
) -> tuple[np.ndarray, np.ndarray] | tuple[()]:
    """Replicates of both images, or nothing if an image has none."""
    if reference.replicates is None or test.replicates is None:
        return ()
    return reference.replicates, test.replicates


def _image_and_noise(image: NoisyImage) -> _ImageAndNoise:
    first, second = image.halves()
    return image.image, first - second


def _shift(image: np.ndarray, difference: np.ndarray, step: np.ndarray | np.float32) -> np.ndarray:
    """Shift an image towards its first half by a step, or by (rows, columns, 1) steps."""
    result: np.ndarray = image + step / 2 * difference
    return result


def _odd_responses(maps: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """D(h) and D(i) from the values at `_STEPS`; see the module.

    Without the values at twice the step, which replicates make superfluous, D(i) is D(h).
    """
    plus, minus, *far_maps = (values.astype(np.float64) for values in maps)
    near = (plus - minus) / _STEP
    far = (far_maps[0] - far_maps[1]) / (2 * _STEP) if far_maps else near
    return near, near - (1 + _STEP**2) / (3 * _STEP**2) * (far - near)


# The mean of the noisy images, and the mean without noise by the halves.
_Estimates = tuple[ScoreEstimate, MeanEstimate]


def _estimate_mean(
    plain_map: np.ndarray, maps: Sequence[np.ndarray], mask: np.ndarray
) -> _Estimates:
    """Estimate a mean over a mask, from the image's map and the maps at `_STEPS`."""
    size = np.count_nonzero(mask)
    if not size:
        nan = math.nan
        return ScoreEstimate(nan, nan, 1.0, nan), MeanEstimate(nan, nan, 1.0, (0.0, 0.0))
    (error, freedom), (value_error, value_freedom) = (
        error_of_responses(sum_blocks(np.where(mask, odd, 0.0))[None] / (2 * size))
        for odd in _odd_responses(maps)
    )
    plain, plus, minus = (
        float(values[mask].mean(dtype=np.float64)) for values in (plain_map, *maps[:2])
    )
    bias = (plus + minus - 2 * plain) / (2 * _STEP**2)
    return (
        ScoreEstimate(plain, error, freedom, bias),
        MeanEstimate(plain - bias, value_error, value_freedom, (0.0, 0.0)),
    )


def _estimate_without_maps(
    reference: _ImageAndNoise,
    test: _ImageAndNoise,
    values: Mapping[str, float],
    viewing: Viewing | None,
    steps: Sequence[float],
) -> dict[str, _Estimates]:
    """Estimate scores without a map, given by key, from blocks shifted with random signs."""
    if not values:
        return {}
    random = np.random.default_rng(0)
    rows, columns = reference[0].shape[:2]
    blocks = math.ceil(rows / BLOCK_PX), math.ceil(columns / BLOCK_PX)
    samples: dict[str, list[list[float]]] = {key: [] for key in values}
    for _ in range(_PATTERNS):
        block_signs = random.choice(np.array([-1, 1], np.float32), blocks)
        signs = np.repeat(np.repeat(block_signs, BLOCK_PX, 0), BLOCK_PX, 1)
        signs = signs[:rows, :columns, None]
        scores = [
            score_maps(_shift(*reference, step), _shift(*test, step), [*values], viewing)
            for step in (np.float32(size) * signs for size in steps)
        ]
        for key, rows_of_key in samples.items():
            rows_of_key.append([float(score[key]) for score in scores])
    return {key: _estimate_whole(values[key], np.array(rows)) for key, rows in samples.items()}


def _estimate_whole(plain: float, samples: np.ndarray) -> _Estimates:
    """Estimate a score from its values at `_STEPS` for each pattern, (patterns, 4 or 2)."""
    error, value_error = (
        math.sqrt(COUPLING * float(np.square(odd).mean())) / 2
        for odd in _odd_responses([*samples.T])
    )
    freedom = float(len(samples))
    bias = (float(samples[:, :2].mean()) - plain) / _STEP**2
    return (
        ScoreEstimate(plain, error, freedom, bias),
        MeanEstimate(plain - bias, value_error, freedom, (0.0, 0.0)),
    )


def _score_from_mean(metric: Metric, plain: ScoreEstimate, mean: MeanEstimate) -> ScoreEstimate:
    """Convert the means of a map, with and without noise, to the metric's score."""
    convert = metric.score_from_mean or (lambda value: (value, 1.0))
    score, slope = convert(plain.plain)
    if not slope:  # identical images
        return ScoreEstimate(score, 0.0, 1.0, 0.0, score, (score, score), 0.0)
    least = -math.inf if metric.score_from_mean is None else plain.plain / _MOST_CORRECTED
    value, value_slope = convert(max(mean.mean, least))
    half = _half_width(INTERVAL_LEVEL, 0.0, 1.0, mean.error, mean.freedom)
    low, high = metric.range
    interval = (-math.inf, math.inf)
    if math.isfinite(half):
        below, above = mean.mean - half - mean.extension[0], mean.mean + half + mean.extension[1]
        # A mean below the least may be anything down to none, the best score.
        best = high if metric.better == "higher" else low
        ends = [convert(below)[0] if below > least else best, convert(max(above, least))[0]]
        first, last = np.clip(sorted(ends), low, high)
        interval = float(first), float(last)
    extension = [abs(value_slope) * part for part in mean.extension]
    return ScoreEstimate(
        plain=score,
        error=abs(slope) * plain.error,
        freedom=plain.freedom,
        bias=score - convert(max(plain.plain - plain.bias, least))[0],
        value=min(max(value, low), high),
        interval=interval,
        value_error=abs(value_slope) * mean.error,
        value_freedom=mean.freedom,
        extension=(extension[0], extension[1]) if value_slope > 0 else (extension[1], extension[0]),
        responses=None if mean.responses is None else value_slope * mean.responses,
    )


def half_width(score: ScoreEstimate) -> float:
    """Half width of a score's interval; infinite if unknown, 0 without a score."""
    low, high = score.interval
    return 0.0 if math.isnan(score.value) else (high - low) / 2


def difference(
    score: ScoreEstimate, other: ScoreEstimate, level: float = INTERVAL_LEVEL
) -> tuple[float, tuple[float, float]]:
    """Difference of two scores of one view by one metric without noise, and its interval.

    Both scores have the replicates of the ground truth, and perhaps of a capture, in common. Their
    noise cancels in the responses of equal blocks and replicates. Without replicates, the errors
    are those of independent scores.
    """
    change = score.value - other.value
    if score.responses is None or other.responses is None:
        errors = score.value_error, score.value_freedom, other.value_error, other.value_freedom
    else:
        is_known = math.isfinite(score.value_error + other.value_error)
        error, freedom = error_of_responses(score.responses - other.responses)
        errors = 0.0, 1.0, error if is_known else math.inf, freedom
    half = _half_width(level, *errors)
    # A bias in one direction, which both scores may keep, cancels. Others do not.
    (below, above), (other_below, other_above) = score.extension, other.extension
    either_way = min(below, above) + min(other_below, other_above)
    upwards = (above - below) - (other_above - other_below)
    below, above = either_way + max(-upwards, 0.0), either_way + max(upwards, 0.0)
    return change, (change - half - below, change + half + above)


def is_above(score: ScoreEstimate, other: ScoreEstimate, tests: int = 1) -> bool:
    """True if a score is significantly above another, in one of several tests."""
    return difference(score, other, sidak(INTERVAL_LEVEL, tests))[1][0] > 0


def _half_width(level: float, *errors: float) -> float:
    """Half width of a difference's interval, from both errors and their degrees of freedom."""
    error_a, freedom_a, error_b, freedom_b = map(np.asarray, errors)
    return float(welch_half_width(error_a, freedom_a, error_b, freedom_b, level))


def compare_scores(
    baseline: Mapping[str, Mapping[str, ScoreEstimate]],
    candidate: Mapping[str, Mapping[str, ScoreEstimate]],
    noise_ratio: float = 1.0,
) -> list[Check]:
    """Verdicts on the baseline's scores, with the direction of each change.

    Scores are by scored object ("template/left"), then by score name ("ssim_to_reference"); one
    that the candidate lacks fails. `noise_ratio` is the ratio of the candidate's standard errors to
    the baseline's.
    """
    tests = sum(len(scores) for scores in baseline.values())
    level = sidak(FAMILY_RATE, tests)
    scale = noise_ratio**2 if math.isfinite(noise_ratio) else 1.0
    scale = min(max(scale, _SCALES[0]), _SCALES[1])
    return [
        _verdict(
            f"{scored}: {score_label(name)}",
            name,
            old,
            candidate.get(scored, {}).get(name),
            level,
            scale,
            (_target(baseline, scored, name), _target(candidate, scored, name)),
        )
        for scored, scores in baseline.items()
        for name, old in scores.items()
    ]


def _target(
    scores: Mapping[str, Mapping[str, ScoreEstimate]], scored: str, light_name: str
) -> float:
    """Best value of a light: 0 to the reference, else the reference view's; NaN if unknown."""
    if light_name.endswith("_to_reference"):
        return 0.0
    reference = f"reference/{scored.rpartition('/')[2]}"
    target = scores.get(reference, {}).get(light_name)
    return math.nan if target is None or scored == reference else target.plain


def _verdict(
    label: str,
    name: str,
    old: ScoreEstimate,
    new: ScoreEstimate | None,
    level: float,
    scale: float,
    targets: tuple[float, float],
) -> Check:
    metric = find(name)
    smallest, unit = (metric.tolerance, metric.unit) if metric else (0.0, "")
    kind: Kind = "score"
    is_light, to_reference = name.startswith(f"{LIGHT}_"), name.endswith("_to_reference")
    if is_light and to_reference:
        smallest, unit = _LIGHT_TO_REFERENCE, "%"
    elif is_light:
        smallest, unit = max(_LIGHT_SHARE * abs(old.plain), _LIGHT_OF_WHITE), "% of white"
        kind = "light"
    label = f"{label} against the baseline"
    if new is None or not (metric or is_light):
        detail = "the score is missing" if new is None else "its metric is not installed"
        return within(label, kind, math.nan, math.nan, smallest, unit=unit, detail=detail)
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
    if kind == "light" and old.plain:
        detail += f", {100 * change / abs(old.plain):+.1f} % of it".replace("-", "−")
    if abs(expected) > smallest / 10:
        detail += f", {expected:+.4f} of it due to the number of samples"
    verdict = within(label, kind, change, half, smallest, unit=unit, p_value=p, detail=detail)
    before, after = abs(old.plain - targets[0]), abs(new.plain - targets[1])
    is_better = metric.is_better(change) if metric else after < before
    is_worse = metric is not None or after >= before
    direction: Direction = BETTER if is_better else "worse" if is_worse else ""
    return msgspec.structs.replace(verdict, direction="" if verdict.passed else direction)


def score_label(name: str) -> str:
    """Label of a score: ``psnr_on_relic_to_reference_db`` is "PSNR on relic to reference"."""
    if name.startswith(f"{LIGHT}_"):
        return name.replace("_", " ")
    metric = find(name)
    first, _, rest = name.partition("_")
    words = rest.removesuffix(metric.unit.lower() if metric else "").replace("_", " ").strip()
    against = [] if words.endswith("to reference") else ["to ground truth"]
    return " ".join(filter(None, [metric.label if metric else first.upper(), words, *against]))
