"""Adaptive sampling: a run uses only the samples that its scores need.

docs/theory/skipping.md describes it. The uncertainty of a score is the half width of its interval
plus a bound of its bias. The bias estimate of `inim.scores.regression.scores` is correct while the
score falls linearly with the noise's variance V. SSIM falls less and less as noise grows, so that
estimate is too small. For a bias ``c V^p`` it is ``p c V^p`` at any V; therefore the change of the
score between rounds, divided by the change of the estimate, is 1 / p.

Scatter falls with the square root of the number of samples, bias with the number.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from inim.display.settings import Settings
from inim.generators.registry import is_optimal
from inim.image.rgbd import LayeredRGBD
from inim.pipeline.plan import Plan
from inim.pipeline.stages.capture import Capture
from inim.pipeline.stages.generation import ReferenceOutput
from inim.pipeline.stages.ground_truth import GroundTruth
from inim.pipeline.stages.picture import PictureFile
from inim.pipeline.stages.scene import Renderer
from inim.pipeline.stages.scoring import MethodResult, Scores
from inim.pipeline.stages.stage import Run
from inim.report.document import AlgorithmResult, ScoreDifference
from inim.scores.document_parts import Check
from inim.scores.metrics import HEADLINE, HEADLINE_TO_SCENE, MAIN, best_algorithm
from inim.scores.regression.scores import ScoreEstimate, difference, is_above, scatter
from inim.system.backend import Backend

if TYPE_CHECKING:
    from inim.pipeline.output import Images

#: Share of all samples that the first round uses.
FIRST_SHARE = 1 / 16
#: Settings that are sample counts.
SAMPLE_COUNTS = ("capture_spp", "eia_spp", "view_spp", "reconstruction_spp")
# 1 / p for forecasts: measured values are 1.1 to 1.6; a round that is too short costs the most.
_USUAL_BEND = 2.0


def sample_until_precise(
    evaluate: Callable[[Plan, Renderer, Images, Run], Evaluation],
    plan: Plan,
    renderer: Renderer,
    images: Images,
    run: Run,
) -> Evaluation:
    """Evaluate with the samples that the target error needs; with all samples without one."""
    settings, error = plan.settings, plan.settings.score_error if renderer.skip else 0.0
    observer = run.observer
    if not error:
        observer.begin(stage_names(plan))
        return evaluate(plan, renderer, images, run)

    def evaluate_share(share: float, eyes: int | None = None) -> Evaluation:
        round_settings = scale_samples(settings, share)
        round_plan = replace(plan, settings=round_settings, viewpoints=plan.viewpoints[:eyes])
        # The number of rounds is not known in advance; the first is almost never the last.
        observer.begin(stage_names(round_plan) + (stage_names(plan) if eyes else []))
        return evaluate(round_plan, renderer, images, run.for_round())

    share = FIRST_SHARE
    previous = evaluate_share(share, eyes=1).ssim_scores
    while True:
        share = next_share(share, previous, error)
        evaluation = evaluate_share(share)
        scores = evaluation.ssim_scores
        uncertainty = largest_uncertainty(scores, previous)
        if uncertainty <= error or evaluation.plan.settings == settings:
            return _record_sampling(evaluation, settings, uncertainty)
        previous = scores


def _record_sampling(evaluation: Evaluation, full: Settings, uncertainty: float) -> Evaluation:
    """Return the evaluation with its skipped samples, and a warning if it misses the target."""
    settings, error = evaluation.plan.settings, full.score_error
    warnings = list(evaluation.sampling_warnings)
    if not uncertainty <= error:
        value = f"{uncertainty:.2g}" if uncertainty < math.inf else "unknown"
        warnings.append(
            f"SSIM uncertainty with all samples is {value}, above the target of {error:g}; raise "
            "inim.eia_spp and inim.view_spp, or inim.score_error"
        )
    used = f"{settings.eia_spp} per EIA pixel, {settings.view_spp} per view pixel"
    unused = (full.eia_spp - settings.eia_spp, full.view_spp - settings.view_spp)
    skipped, reason = "none", f"SSIM needs all samples for an uncertainty of {error:g}"
    if any(unused):
        skipped = f"{unused[0]} and {unused[1]} more"
        reason = f"the uncertainty of every SSIM is at most {uncertainty:.2g}; target {error:g}"
    evaluation.run.skipped.add("samples", used, skipped, reason)
    return replace(evaluation, sampling_warnings=tuple(warnings))


def stage_names(plan: Plan) -> list[str]:
    """Stages of one round and of its report, in execution order."""
    methods = [f"{method.verb} {method.name}" for method in plan.methods]
    eyes = len(plan.viewpoints)
    views = ["reconstruct views"] * eyes
    if isinstance(plan.file, PictureFile):
        truth = ["exact EIA", *["warp picture"] * eyes]
    else:
        truth = ["open scene", "capture RGB-D"]
        truth += ["capture layers"] * (LayeredRGBD in plan.inputs)
        truth += ["capture cameras" for views in plan.inputs if isinstance(views, str)]
        truth += ["ground-truth EIA", *["ground-truth views"] * eyes]
    names = [*["trace views"] * eyes, *methods, *truth]
    names += [*views, "score"]
    for method in methods:
        names += [method, *views, "score", "score"]
    return [*names, "score", *(["time"] if plan.request.time else []), "score", "write report"]


def scale_samples(settings: Settings, share: float) -> Settings:
    """Return settings with a share of the samples, each count even for the two halves."""
    counts = {name: getattr(settings, name) for name in SAMPLE_COUNTS}
    reduced_counts = {n: min(c, 2 * max(1, math.ceil(share * c / 2))) for n, c in counts.items()}
    return replace(settings, **reduced_counts)


def largest_uncertainty(
    scores: Mapping[str, ScoreEstimate], previous: Mapping[str, ScoreEstimate]
) -> float:
    """Largest uncertainty of a round's scores, given those of the previous round; see the module.

    It is infinite for a first round and if a value is not a number. `previous` may lack scores.
    """
    bends = {}
    for name in scores.keys() & previous.keys():
        new, old = scores[name], previous[name]
        bias_change = abs(old.bias) - abs(new.bias)
        if bias_change > 0:
            bends[name] = abs(new.plain - old.plain) / bias_change
    usual = max([1.0, *bends.values()]) if bends else _USUAL_BEND
    uncertainties = []
    for name, score in scores.items():
        bias = abs(score.bias) * max(1.0, bends.get(name, usual))
        if name in previous and name not in bends:
            # Negligible noise, or so much that the score no longer depends on it.
            bias = max(bias, abs(score.plain - previous[name].plain))
        uncertainties.append(bias + scatter(score))
    undefined = [math.isnan(score.plain) for score in scores.values()]
    if not previous or any(undefined) or any(map(math.isnan, uncertainties)):
        return math.inf
    return max(uncertainties, default=math.inf)


def next_share(share: float, scores: Mapping[str, ScoreEstimate], error: float) -> float:
    """Share of the samples at which the uncertainty of all scores is forecast to be `error`.

    It is the `share` behind `scores`, doubled at least once to keep the samples evenly spread, and
    1 at most.
    """
    share_needed = max(
        (_needed_share(share, score, error) for score in scores.values()), default=1.0
    )
    share *= 2
    while share < min(share_needed, 1):
        share *= 2
    return min(share, 1.0)


def _needed_share(share: float, score: ScoreEstimate, error: float) -> float:
    """Solve ``bias x^2 + half_width x = error`` for ``share / x^2``."""
    bias, half = _USUAL_BEND * abs(score.bias), scatter(score)
    root = half + math.sqrt(half**2 + 4 * bias * error)
    if math.isnan(root):
        return 1.0
    return share * (root / (2 * error)) ** 2


# Rays through the edges of splat shells; Mitsuba's `ellipsoids` counts half of all pixels twice.
_MAX_COUNTED_TWICE = 0.02


@dataclass(frozen=True)
class Evaluation:
    """Results of one round of samples, with its settings and skipped steps.

    `source` describes the scene or the picture for the report, `reference_scores` are by viewpoint
    and score name, and `results` by method.
    """

    plan: Plan
    backend: Backend
    run: Run
    source: dict[str, Any]
    capture: Capture
    truth: GroundTruth
    reference_scores: dict[str, Scores]
    results: dict[str, MethodResult]
    sampling_warnings: tuple[str, ...] = ()

    @property
    def reference_outputs(self) -> dict[str, ReferenceOutput]:
        """Outputs of the generators for the reference input, by method."""
        outputs = {name: result.reference_output for name, result in self.results.items()}
        return {name: output for name, output in outputs.items() if output is not None}

    @property
    def algorithms(self) -> dict[str, AlgorithmResult]:
        """Scores by method, as in report.json."""
        return {name: result.scores for name, result in self.results.items()}

    @property
    def differences(self) -> list[ScoreDifference]:
        """Differences of the headline score between the best algorithm and the others, by view."""
        headlines = {
            name: {key.removeprefix(f"{name}/"): s[HEADLINE] for key, s in scores.items()}
            for name, scores in ((n, r.statistics.scores) for n, r in self.results.items())
        }
        finite = {
            name: [score.value for score in scores.values() if math.isfinite(score.value)]
            for name, scores in headlines.items()
        }
        best = best_algorithm(finite)
        if best is None:
            return []
        differences = []
        for other in [name for name in headlines if name != best]:
            for view in [view for view in headlines[other] if view in headlines[best]]:
                value, interval = difference(headlines[best][view], headlines[other][view])
                differences.append(
                    ScoreDifference(
                        algorithm=best, other=other, viewpoint=view, value=value, interval=interval
                    )
                )
        return differences

    @property
    def ssim_scores(self) -> dict[str, ScoreEstimate]:
        """SSIM scores of all views, by view and score name."""
        views = {f"reference/{name}": scores for name, scores in self.reference_scores.items()}
        for result in self.results.values():
            views |= result.statistics.scores
        return {
            f"{view} {name}": score
            for view, scores in views.items()
            for name, score in scores.items()
            if name.startswith("ssim")
        }

    @property
    def checks(self) -> list[Check]:
        """Checks of the capture, the ground truth and the methods, in this order."""
        method_checks = [check for result in self.results.values() for check in result.checks]
        return [*self.capture.checks, *self.truth.checks, *method_checks]

    @property
    def warnings(self) -> list[str]:
        """Warnings of capture, ground truth, methods and sampling, in this order."""
        method_warnings = [text for result in self.results.values() for text in result.warnings]
        return [
            *self.capture.warnings,
            *self.truth.warnings,
            *method_warnings,
            *self._splat_warnings(),
            *self._reference_warnings(),
            *self.sampling_warnings,
        ]

    def _splat_warnings(self) -> list[str]:
        """Warn if the renderer counts splats twice, which makes them too opaque."""
        share = self.source.get("splats", {}).get("counted_twice_fraction", 0)
        if share <= _MAX_COUNTED_TWICE:
            return []
        return [
            f"splats: the renderer counts a splat twice in {share:.1%} of the pixels, due to "
            "rounding; use the shape 'ellipsoidsmesh', and scale the scene to about 100 units"
        ]

    def _reference_warnings(self) -> list[str]:
        """Warn of views that score significantly above the reference view."""
        keys = (HEADLINE_TO_SCENE, MAIN.key)
        pairs = [
            (name, view, key, result.statistics.scores[f"{name}/{view}"][key], scores[key])
            for name, result in self.results.items()
            if not is_optimal(name)  # it exceeds the reference by its definition
            for view, scores in self.reference_scores.items()
            if f"{name}/{view}" in result.statistics.scores
            for key in keys
        ]
        return [
            f"{name}/{view}: {MAIN.label} to the scene{' on the relic' * (key != MAIN.key)}, "
            f"{score.value:.4f}, is significantly above the reference's, {reference.value:.4f}; "
            "here the reference is not an upper bound"
            for name, view, key, score, reference in pairs
            if is_above(score, reference, len(pairs))
        ]
