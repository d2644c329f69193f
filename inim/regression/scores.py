"""Scores free of noise, with their standard errors, from the two halves of a run's samples.

A score is the mean of a local map m (SSIM's, FLIP's, or the squared error of PSNR). The run is
split into two halves a, b that share no random number: ground truth, capture, reconstruction.
Their difference is noise and nothing else, so pictures moved along it, by ``h (a - b) / 2`` either
way, tell how the score answers to noise of the run's own kind. A small step h = 1/4 tells it at the
run's own level:

    D(h) = (m(+h) - m(-h)) / h                expectation 0 in every block, either sign alike
    error^2 = c sum over blocks (sum of D in the block)^2 / (4 N^2)
    bias = (mean of m(+h) + mean of m(-h) - 2 mean of m) / (2 h^2)

That is the infinitesimal jackknife (Jaeckel, Bell Laboratories MM 72-1215-11, 1972). Blocks are
wider than what SSIM's window and a lens couple; `c` makes up for what they couple across the
blocks' borders.

Moved pictures have ``1 + h^2`` times the noise's variance. So the bias is by how much the score
moves as the variance grows by its own amount, SSIM of noisy pictures being too low. The score free
of noise is found by going the other way, to none, h^2 = -1: it is the mean of m less the bias. With
h = 1 that would be twice the score of all samples, less the mean of the halves'; the small step
leaves half of the second order (docs/theory/scores.md).

The bias scatters, too, and not independently of the mean of m: where the pictures' noise bends m,
it moves both. What error the score free of noise has, its own odd answer tells, from the same two
steps h and 2 h and to the same end:

    D(i) = D(h) - (1 + h^2) (D(2 h) - D(h)) / (3 h^2)         at h^2 = -1
    value_error^2 = c sum over blocks (sum of D(i) in the block)^2 / (4 N^2)

To third order in the noise that is its variance, no more and no less; error^2 is above the mean's
by the bias' own.

Runs are compared by the scores of their pictures as they are, which scatter least: of unlike sample
counts, a score is expected to move by ``bias (r^2 - 1)`` where the ground truth's standard errors
grew r times.

A score that is no mean of a map answers as a whole. There D^2 is the mean over some patterns of
signs, drawn once and for all, by which the blocks are moved: its expectation over all patterns is
the sum of the blocks' own squares (Hutchinson, Commun. Statist. Simul. 18, 1989).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from inim.documents.compare import Estimate
from inim.image.noisy_image import NoisyImage
from inim.metrics import Metric, Viewing, all_metrics, find, score_maps
from inim.regression.verdict import (
    FALSE_ALARM_RATE,
    Verdict,
    freedom_of_sum,
    sidak,
    welch_half_width,
    welch_p_value,
    within,
)

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
# The same of one that is slow.
_PATTERNS_OF_SLOW = 2
# The step h: noise grows by h^2, and differences are far above float32's rounding.
_STEP = 0.25
# Where pictures are moved to.
_STEPS = (_STEP, -_STEP, 2 * _STEP, -2 * _STEP)


@dataclass(frozen=True)
class ScoreEstimate:
    """A score and how sure it is.

    Attributes
    ----------
    plain : float
        Of the pictures as they are, with their noise.
    error : float
        Standard error of `plain`.
    freedom : float
        Degrees of freedom of `error`.
    bias : float
        What as much noise again would add to `plain`.
    value_error : float
        Standard error of `value`; infinite where it is not known, as in a baseline.
    value_freedom : float
        Degrees of freedom of `value_error`.
    """

    plain: float
    error: float
    freedom: float
    bias: float
    value_error: float = math.inf
    value_freedom: float = 1.0

    @property
    def value(self) -> float:
        """The score: what `plain` would be without noise, to first order in its variance."""
        return self.plain - self.bias

    def as_record(self) -> Estimate:
        """For a baseline's JSON, the compared values. Not finite is null."""
        values = {name: getattr(self, name) for name in Estimate.__struct_fields__}
        return Estimate(**{k: v if math.isfinite(v) else None for k, v in values.items()})

    @classmethod
    def of(cls, record: Estimate) -> ScoreEstimate:
        """From `as_record`; null is NaN, which passes nothing."""
        values = msgspec.structs.asdict(record).items()
        return cls(**{name: math.nan if value is None else value for name, value in values})


# An image, and the difference of its halves.
_Moving = tuple[np.ndarray, np.ndarray]


def view_scores(
    reference: NoisyImage,
    test: NoisyImage,
    region: np.ndarray | None = None,
    keys: Sequence[str] | None = None,
    viewing: Viewing | None = None,
) -> dict[str, ScoreEstimate]:
    """Scores of a view, with their errors, by `inim.metrics.Metric.key`.

    Parameters
    ----------
    reference, test : NoisyImage
    region : (rows, columns) bool, optional
        The relic's: scores of it, too, by `on_relic_key`.
    keys : sequence of str, optional
        `inim.metrics.Metric.key` of those wanted; all metrics without.
    viewing : Viewing, optional
        Without it, metrics that are `viewed` are left out.
    """
    wanted = [m for m in all_metrics() if keys is None or m.key in keys]
    truth, view = _moving(reference), _moving(test)
    maps = score_maps(truth[0], view[0], [metric.key for metric in wanted], viewing)
    metrics = [metric for metric in wanted if metric.key in maps]
    local = [metric for metric in metrics if maps[metric.key].ndim]

    moved = [
        score_maps(_moved(*truth, by), _moved(*view, by), [metric.key for metric in local])
        for by in map(np.float32, _STEPS)
    ]
    means: dict[str, ScoreEstimate] = {}
    for slow, patterns in ((False, _PATTERNS), (True, _PATTERNS_OF_SLOW)):
        others = {m.key: float(maps[m.key]) for m in metrics if m not in local and m.slow is slow}
        means |= _without_maps(truth, view, others, viewing, patterns)
    found = {}
    for metric in metrics:
        key = metric.key
        areas: dict[str, np.ndarray | None] = {key: None}
        if metric.on_relic and region is not None and metric in local:
            areas[metric.on_relic_key] = region
        for name, area in areas.items():
            mean = means.get(key) or _estimate(
                maps[key], [one[key] for one in moved], metric.counted(maps[key].shape, area)
            )
            found[name] = _of_mean(metric, mean)
    return found


def _moving(image: NoisyImage) -> _Moving:
    first, second = image.halves()
    return image.image, first - second


def _moved(image: np.ndarray, difference: np.ndarray, by: np.ndarray | np.float32) -> np.ndarray:
    """The image, so many steps towards its first half: everywhere, or by (rows, columns, 1)."""
    moved: np.ndarray = image + by / 2 * difference
    return moved


def _odd_answers(moved: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """D(h) and D(i) of what was found at `_STEPS`; see the module."""
    plus, minus, far_plus, far_minus = (one.astype(np.float64) for one in moved)
    near, far = (plus - minus) / _STEP, (far_plus - far_minus) / (2 * _STEP)
    return near, near - (1 + _STEP**2) / (3 * _STEP**2) * (far - near)


def _estimate(whole: np.ndarray, moved: Sequence[np.ndarray], counted: np.ndarray) -> ScoreEstimate:
    """Of the pixels that count, from the maps of the picture and at `_STEPS`; see the module."""
    size = np.count_nonzero(counted)
    if not size:
        return ScoreEstimate(math.nan, math.nan, 1.0, math.nan, math.nan)
    (error, freedom), (value_error, value_freedom) = (
        _error_of_sum(np.where(counted, odd, 0.0)) for odd in _odd_answers(moved)
    )
    plain, above, below = (
        float(one[counted].mean(dtype=np.float64)) for one in (whole, *moved[:2])
    )
    bias = (above + below - 2 * plain) / (2 * _STEP**2)
    return ScoreEstimate(plain, error / size, freedom, bias, value_error / size, value_freedom)


def _error_of_sum(blocks: np.ndarray) -> tuple[float, float]:
    """Standard error of a map's sum by its odd answer, and its degrees of freedom."""
    for axis in (0, 1):
        blocks = np.add.reduceat(blocks, np.arange(0, blocks.shape[axis], _BLOCK_PX), axis=axis)
    squares = np.square(blocks)
    freedom = freedom_of_sum(squares.sum(), np.square(squares).sum())
    return math.sqrt(_COUPLING * float(squares.sum())) / 2, float(freedom)


def _without_maps(
    reference: _Moving,
    test: _Moving,
    values: Mapping[str, float],
    viewing: Viewing | None,
    patterns: int,
) -> dict[str, ScoreEstimate]:
    """Estimates of scores that have no map, from blocks moved with signs by chance; see the module.

    Parameters
    ----------
    reference, test : two (rows, columns, 3) float32
        The image, and the difference of its halves.
    values : mapping of str to float
        The scores, by key.
    viewing : Viewing, optional
    patterns : int
        How many.
    """
    if not values:
        return {}
    random = np.random.default_rng(0)
    rows, columns = reference[0].shape[:2]
    blocks = math.ceil(rows / _BLOCK_PX), math.ceil(columns / _BLOCK_PX)
    moved: dict[str, list[list[float]]] = {key: [] for key in values}
    for _ in range(patterns):
        drawn = random.choice(np.array([-1, 1], np.float32), blocks)
        signs = np.repeat(np.repeat(drawn, _BLOCK_PX, 0), _BLOCK_PX, 1)[:rows, :columns, None]
        found = [
            score_maps(_moved(*reference, by), _moved(*test, by), [*values], viewing)
            for by in (np.float32(step) * signs for step in _STEPS)
        ]
        for key, answers in moved.items():
            answers.append([float(one[key]) for one in found])
    return {key: _by_patterns(values[key], np.array(one)) for key, one in moved.items()}


def _by_patterns(plain: float, moved: np.ndarray) -> ScoreEstimate:
    """From the score and what it was at `_STEPS` by each pattern, (patterns, 4)."""
    error, value_error = (
        math.sqrt(_COUPLING * float(np.square(odd).mean())) / 2 for odd in _odd_answers([*moved.T])
    )
    freedom = float(len(moved))
    bias = (float(moved[:, :2].mean()) - plain) / _STEP**2
    return ScoreEstimate(plain, error, freedom, bias, value_error, freedom)


def _of_mean(metric: Metric, mean: ScoreEstimate) -> ScoreEstimate:
    """From a map's mean to the score that is made of it, errors and bias to first order."""
    if metric.of_mean is None:
        return mean
    plain, slope = metric.of_mean(mean.plain)
    if not slope:
        return ScoreEstimate(plain, 0.0, 1.0, 0.0, 0.0)
    return replace(
        mean,
        plain=plain,
        error=abs(slope) * mean.error,
        bias=slope * mean.bias,
        value_error=abs(slope) * mean.value_error,
    )


def score_interval(score: ScoreEstimate, level: float = SHOWN_LEVEL) -> tuple[float, float]:
    """Where the score would lie with fresh seeds, at confidence ``1 - level``."""
    half = _half_width(level, 0.0, 1.0, score.value_error, score.value_freedom)
    return score.value - half, score.value + half


def is_above(score: ScoreEstimate, other: ScoreEstimate, tests: int = 1) -> bool:
    """Whether a score lies above another by more than the noise of both, in one of some tests."""
    sides = other.value_error, other.value_freedom, score.value_error, score.value_freedom
    return score.value - other.value > _half_width(sidak(SHOWN_LEVEL, tests), *sides)


def _half_width(level: float, *sides: float) -> float:
    """Of a difference's interval, by error and degrees of freedom of either side."""
    error_a, freedom_a, error_b, freedom_b = map(np.asarray, sides)
    return float(welch_half_width(error_a, freedom_a, error_b, freedom_b, level))


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
        By what was scored ("template/left"), then by the score's name ("ssim_to_reference"). One
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
    if old.plain == new.plain == math.inf:
        # Both show the very reference: no difference is left to have an error.
        return within(label, "score", 0.0, 0.0, smallest, unit=unit, detail="identical pictures")
    expected = (old.bias + new.bias / scale) / 2 * (scale - 1)
    change = new.plain - old.plain - expected
    sides = old.error, old.freedom, new.error, new.freedom
    half = _half_width(level, *sides) if math.isfinite(change) else math.nan
    p = float(welch_p_value(*map(np.asarray, (change, *sides)))) if math.isfinite(change) else None
    detail = f"{new.plain:.4f}, baseline {old.plain:.4f}"
    if abs(expected) > smallest / 10:
        detail += f", of which {expected:+.4f} by the number of samples"
    return within(label, "score", change, half, smallest, unit=unit, p_value=p, detail=detail)


def _words(name: str) -> str:
    """Label of a score: ``psnr_on_relic_to_reference_db`` is "PSNR on relic to reference"."""
    metric = find(name)
    first, _, rest = name.partition("_")
    words = rest.removesuffix(metric.unit.lower() if metric else "").replace("_", " ").strip()
    against = [] if words.endswith("to reference") else ["to scene"]
    return " ".join(filter(None, [metric.label if metric else first.upper(), words, *against]))
