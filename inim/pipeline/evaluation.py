"""Results of a run before its report: images, scores, checks and warnings."""

import math
from dataclasses import dataclass
from statistics import fmean
from typing import Any

from inim.generators.registry import is_optimal
from inim.pipeline.plan import Plan
from inim.pipeline.stages.capture import Capture
from inim.pipeline.stages.generation import ReferenceOutput
from inim.pipeline.stages.ground_truth import GroundTruth
from inim.pipeline.stages.scoring import MethodResult, Scores
from inim.pipeline.stages.stage import Run
from inim.report.document import AlgorithmResult, ScoreDifference
from inim.scores.document_parts import Check
from inim.scores.metrics import HEADLINE, HEADLINE_TO_SCENE, HEADLINE_WORDS, MAIN, best_algorithm
from inim.scores.regression.scores import difference, half_width, is_above
from inim.system.backend import Backend

# Rays through the edges of splat shells; Mitsuba's `ellipsoids` counts half of all pixels twice.
_MAX_COUNTED_TWICE = 0.02


@dataclass(frozen=True)
class Evaluation:
    """Results of a run, with the settings and samples that it used, and its skipped steps.

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
    def checks(self) -> list[Check]:
        """Checks of the capture, the ground truth and the methods, in this order."""
        method_checks = [check for result in self.results.values() for check in result.checks]
        return [*self.capture.checks, *self.truth.checks, *method_checks]

    @property
    def warnings(self) -> list[str]:
        """Warnings of capture, ground truth, methods and sampling, in this order."""
        method_warnings = [text for result in self.results.values() for text in result.warnings]
        return [
            *self.source.get("warnings", []),
            *self.capture.warnings,
            *self.truth.warnings,
            *method_warnings,
            *self._splat_warnings(),
            *self._reference_warnings(),
            *self._sampling_warnings(),
        ]

    def _sampling_warnings(self) -> list[str]:
        """Warn if the scores needed more than the most samples."""
        error = self.plan.settings.score_error
        if not self.plan.by_need or not error:
            return []
        widths = {
            name: fmean(half_width(s[HEADLINE]) for s in result.statistics.scores.values())
            for name, result in self.results.items()
        }
        name = max(widths, key=lambda name: widths[name])
        width = f"{widths[name]:.3g}"  # a width that equals the limit in three digits is enough
        if float(width) <= error:
            return []
        width = width if widths[name] < math.inf else "unknown"
        return [
            f"{name}: {HEADLINE_WORDS}, is uncertain by {width}, more than inim.score_error, "
            f"{error:g}; set more samples than were used, inim.eia_spp="
            f"{self.plan.settings.eia_spp} and inim.capture_spp={self.plan.settings.capture_spp}"
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
