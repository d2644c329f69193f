"""What a round of samples found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from inim.backend import Backend
from inim.documents.parts import Check
from inim.documents.report import AlgorithmResult
from inim.metrics.headline import HEADLINE_TO_SCENE, MAIN
from inim.pipeline.plan import Plan
from inim.pipeline.stages.capture import Capture
from inim.pipeline.stages.evaluate import MethodResult, Scores
from inim.pipeline.stages.generate import Reference
from inim.pipeline.stages.ground_truth import GroundTruth
from inim.pipeline.stages.stage import Run
from inim.regression import ScoreEstimate, is_above

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
    ceiling : dict of str to dict of str to ScoreEstimate
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
    ceiling: dict[str, Scores]
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
        views = {f"ceiling/{name}": found for name, found in self.ceiling.items()}
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
        above = self._above_the_ceiling()
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

    def _above_the_ceiling(self) -> list[str]:
        """Where a view is more like the scene than the ceiling's, and noise does not explain it."""
        keys = (HEADLINE_TO_SCENE, MAIN.key)
        pairs = [
            (name, view, key, result.statistics.scores[f"{name}/{view}"][key], scores[key])
            for name, result in self.results.items()
            for view, scores in self.ceiling.items()
            if f"{name}/{view}" in result.statistics.scores
            for key in keys
        ]
        return [
            f"{name}/{view}: {MAIN.label} to the scene{' on the relic' * (key != MAIN.key)}, "
            f"{own.value:.4f}, is above the ceiling's, {best.value:.4f}, by more than noise: the "
            "ceiling is no bound here"
            for name, view, key, own, best in pairs
            if is_above(own, best, len(pairs))
        ]
