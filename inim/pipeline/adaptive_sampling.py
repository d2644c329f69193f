"""Adaptive sampling: as many samples as a run's scores need.

Noise does two things to a score: it scatters, and it is biased, as noisy pictures are less alike.
A run that says how well its scores are to be known (`inim.score_error`) goes by rounds. The
first, of one viewpoint and with a sixteenth of the samples, estimates how many it takes; later
ones, twice as many at least, end it once what they report *is* known so well. Each round renders
afresh.

How well a score is known: the half width of its interval, and a bound of its bias. What as much
noise again would add to a score (`inim.regression.scores`) is its bias while the score falls evenly
with the noise's variance. But even parts of a picture soon lose all similarity, so SSIM answers
less and less as noise grows, and that slope underrates the bias. If the bias is ``c V^p``, the
slope finds ``p c V^p``, whatever the variance V; so by what the score changes from round to round,
over what the slope changes by, is 1 / p.

Scatter falls with the root of the number of samples, bias with the number.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from inim.backend import Backend
from inim.documents.parts import Check
from inim.documents.report import AlgorithmResult
from inim.metrics.headline import HEADLINE_TO_SCENE, MAIN
from inim.pipeline.plan import Plan
from inim.pipeline.stages.capture import Capture
from inim.pipeline.stages.evaluate import MethodResult, Scores
from inim.pipeline.stages.generate import Reference
from inim.pipeline.stages.ground_truth import GroundTruth
from inim.pipeline.stages.scene import Renderer
from inim.pipeline.stages.stage import Run
from inim.regression import ScoreEstimate, is_above, score_interval
from inim.settings import Settings

if TYPE_CHECKING:
    from inim.pipeline.output.images import Images

#: Of all samples, in the first round.
FIRST_SHARE = 1 / 16
_COUNTS = ("capture_spp", "eia_spp", "view_spp", "reconstruction_spp")
# For forecasts: 1 / p was 1.1 to 1.6 where it was measured, and a round in vain costs the most.
_USUAL_BEND = 2.0


def measure_until_known(
    measure: Callable[[Plan, Renderer, Images, Run], Measured],
    plan: Plan,
    renderer: Renderer,
    images: Images,
    run: Run,
) -> Measured:
    """Measure with as many samples as the scores need; with all of them where no error is given."""
    wanted, error = plan.settings, plan.settings.score_error if renderer.skip else 0.0
    observer = run.observer
    if not error:
        observer.begin(stage_names(plan))
        return measure(plan, renderer, images, run)

    def measure_with(share: float, eyes: int | None = None) -> Measured:
        settings = with_share(wanted, share)
        fewer = replace(plan, settings=settings, viewpoints=plan.viewpoints[:eyes])
        # Nobody knows how many rounds it takes; the first is as good as always not the last.
        observer.begin(stage_names(fewer) + (stage_names(plan) if eyes else []))
        return measure(fewer, renderer, images, run.for_round())

    share = FIRST_SHARE
    before = measure_with(share, eyes=1).similarities
    while True:
        share = next_share(share, before, error)
        measured = measure_with(share)
        scores = measured.similarities
        known = known_within(scores, before)
        if known <= error or measured.plan.settings == wanted:
            return _with_words_on_samples(measured, wanted, known)
        before = scores


def _with_words_on_samples(measured: Measured, wanted: Settings, known: float) -> Measured:
    """The measurement, and what the report says of its samples."""
    taken, error = measured.plan.settings, wanted.score_error
    warnings = list(measured.more_warnings)
    if not known <= error:
        how_well = f"known to within {known:.2g}" if known < math.inf else "hardly known"
        warnings.append(
            f"with all samples, SSIM is {how_well}, {error:g} was asked for; raise inim.eia_spp "
            "and inim.view_spp, or inim.score_error"
        )
    done = f"{taken.eia_spp} a pixel of the EIA, {taken.view_spp} of a view"
    rest = (wanted.eia_spp - taken.eia_spp, wanted.view_spp - taken.view_spp)
    skipped = measured.run.skipped
    if any(rest):
        why = f"every SSIM is known to within {known:.2g}; {error:g} was asked for"
        skipped.add("samples", done, f"{rest[0]} and {rest[1]} more", why)
    else:
        skipped.add("samples", done, "none", f"fewer do not tell SSIM to within {error:g}")
    return replace(measured, more_warnings=tuple(warnings))


def stage_names(plan: Plan) -> list[str]:
    """Stages of one round of samples and of its report, in their order."""
    methods = [f"{method.verb} {method.name}" for method in plan.methods]
    eyes = len(plan.viewpoints)
    views = ["reconstruct views"] * eyes
    capture = ["capture RGB-D", "capture layers"] if plan.reads_layers else ["capture RGB-D"]
    names = [*methods, "open scene", *capture, "ground-truth EIA", *["ground-truth views"] * eyes]
    names += [*views, "score"]
    for method in methods:
        names += [method, *views, "score", "score"]
    return [*names, "score", *(["time"] if plan.request.time else []), "score", "write report"]


def with_share(settings: Settings, share: float) -> Settings:
    """Settings with a share of the samples: of each kind an even number, as there are two halves.

    Parameters
    ----------
    settings : Settings
    share : float
        1: just as they are.
    """
    counts = {name: getattr(settings, name) for name in _COUNTS}
    fewer = {n: min(c, 2 * max(1, math.ceil(share * c / 2))) for n, c in counts.items()}
    return replace(settings, **fewer)


def known_within(scores: Mapping[str, ScoreEstimate], before: Mapping[str, ScoreEstimate]) -> float:
    """How well the least known of a round's scores is known; see the module.

    Parameters
    ----------
    scores, before : mapping of str to ScoreEstimate
        Of this round, and of the one before it, which may lack some.

    Returns
    -------
    float
        Infinite for a first round, and where something is not a number.
    """
    bends = {}
    for name in scores.keys() & before.keys():
        now, then = scores[name], before[name]
        flatter = abs(then.bias) - abs(now.bias)
        if flatter > 0:
            bends[name] = abs(now.plain - then.plain) / flatter
    usual = max([1.0, *bends.values()]) if bends else _USUAL_BEND
    found = []
    for name, score in scores.items():
        bias = abs(score.bias) * max(1.0, bends.get(name, usual))
        if name in before and name not in bends:
            # No noise to speak of, or so much that the score no longer answers to it.
            bias = max(bias, abs(score.plain - before[name].plain))
        found.append(bias + _half_width(score))
    known = bool(before) and bool(found) and not any(map(math.isnan, found))
    return max(found) if known else math.inf


def next_share(share: float, scores: Mapping[str, ScoreEstimate], error: float) -> float:
    """The share of the samples at which all scores should be known to within `error`.

    Parameters
    ----------
    share : float
        Of the round that found the scores.
    scores : mapping of str to ScoreEstimate
    error : float

    Returns
    -------
    float
        At least twice `share`, by doubling, which keeps the samples evenly spread; 1 at most.
    """
    needed = max((_needed(share, score, error) for score in scores.values()), default=1.0)
    share *= 2
    while share < min(needed, 1):
        share *= 2
    return min(share, 1.0)


def _needed(share: float, score: ScoreEstimate, error: float) -> float:
    """Where ``bias x^2 + half_width x = error``, x^2 being this share over that."""
    bias, half = _USUAL_BEND * abs(score.bias), _half_width(score)
    root = half + math.sqrt(half**2 + 4 * bias * error)
    if math.isnan(root):
        return 1.0
    return share * (root / (2 * error)) ** 2


def _half_width(score: ScoreEstimate) -> float:
    low, high = score_interval(score)
    return (high - low) / 2


# Rays through edges of splats' shells; Mitsuba's `ellipsoids` does it to half of the pixels.
_COUNTED_TWICE = 0.02


@dataclass(frozen=True)
class Measured:
    """What a round of samples found.

    Attributes
    ----------
    plan : Plan
        With the round's numbers of samples.
    backend : Backend
    run : Run
        With what the round skipped.
    scene : dict
        What the report says of the scene: number of shapes, fit.
    capture : Capture
    truth : GroundTruth
    reference_scores : dict of str to dict of str to ScoreEstimate
        By viewpoint, by name.
    results : dict of str to MethodResult
        By method.
    more_warnings : tuple of str
        Of the number of samples.
    """

    plan: Plan
    backend: Backend
    run: Run
    scene: dict[str, Any]
    capture: Capture
    truth: GroundTruth
    reference_scores: dict[str, Scores]
    results: dict[str, MethodResult]
    more_warnings: tuple[str, ...] = ()

    @property
    def references(self) -> dict[str, Reference]:
        """What generators make of the reference input, by method."""
        results = self.results.items()
        return {name: one.reference for name, one in results if one.reference is not None}

    @property
    def algorithms(self) -> dict[str, AlgorithmResult]:
        """Scores by method, as in report.json."""
        return {name: result.scores for name, result in self.results.items()}

    @property
    def similarities(self) -> dict[str, ScoreEstimate]:
        """Every SSIM, by what it is of."""
        views = {f"reference/{name}": found for name, found in self.reference_scores.items()}
        for result in self.results.values():
            views |= result.statistics.scores
        return {
            f"{view} {name}": one
            for view, scores in views.items()
            for name, one in scores.items()
            if name.startswith("ssim")
        }

    @property
    def checks(self) -> list[Check]:
        """Of capture, ground truth and methods, in this order."""
        own = [row for result in self.results.values() for row in result.checks]
        return [*self.capture.checks, *self.truth.checks, *own]

    @property
    def warnings(self) -> list[str]:
        """Of capture, ground truth, methods and sampling, in this order."""
        own = [text for result in self.results.values() for text in result.warnings]
        before = [*self.capture.warnings, *self.truth.warnings, *own]
        above = self._above_the_reference()
        return [*before, *self._counted_twice(), *above, *self.more_warnings]

    def _counted_twice(self) -> list[str]:
        """Where the renderer meets splats twice, which makes them too opaque."""
        share = self.scene.get("splats", {}).get("counted_twice_fraction", 0)
        if share <= _COUNTED_TWICE:
            return []
        return [
            f"splats: in {share:.1%} of the pixels the renderer counts a splat twice, as it "
            "rounds; make the shape 'ellipsoidsmesh', and the scene some 100 units large"
        ]

    def _above_the_reference(self) -> list[str]:
        """Views that score above the reference view by more than noise explains."""
        keys = (HEADLINE_TO_SCENE, MAIN.key)
        pairs = [
            (name, view, key, result.statistics.scores[f"{name}/{view}"][key], scores[key])
            for name, result in self.results.items()
            for view, scores in self.reference_scores.items()
            if f"{name}/{view}" in result.statistics.scores
            for key in keys
        ]
        return [
            f"{name}/{view}: {MAIN.label} to the scene{' on the relic' * (key != MAIN.key)}, "
            f"{own.value:.4f}, is above the reference's, {best.value:.4f}, by more than noise: the "
            "reference is no bound here"
            for name, view, key, own, best in pairs
            if is_above(own, best, len(pairs))
        ]
