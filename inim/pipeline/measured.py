"""What a round of samples found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from inim.backend import Backend
from inim.pipeline.capture import Capture
from inim.pipeline.evaluate import MethodResult, ViewScores
from inim.pipeline.generate import Reference
from inim.pipeline.ground_truth import GroundTruth
from inim.pipeline.plan import Plan
from inim.pipeline.stage import Run
from inim.regression import ScoreEstimate

__all__ = ["Measured"]


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
    ceiling : dict of str to ViewScores
        By viewpoint.
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
    ceiling: dict[str, ViewScores]
    results: dict[str, MethodResult]
    more_warnings: tuple[str, ...] = ()

    @property
    def references(self) -> dict[str, Reference]:
        """What generators make of the reference input, by method."""
        results = self.results.items()
        return {name: one.reference for name, one in results if one.reference is not None}

    @property
    def algorithms(self) -> dict[str, Any]:
        """Scores by method, as in report.json."""
        return {name: result.scores for name, result in self.results.items()}

    @property
    def similarities(self) -> dict[str, ScoreEstimate]:
        """Every SSIM, by what it is of."""
        found = {f"ceiling/{name}": view.estimates["ssim"] for name, view in self.ceiling.items()}
        for result in self.results.values():
            for view, scores in result.statistics.scores.items():
                found |= {f"{view} {n}": one for n, one in scores.items() if n.startswith("ssim")}
        return found

    @property
    def checks(self) -> list[dict[str, Any]]:
        """Of capture, ground truth and methods, in this order."""
        own = [row for result in self.results.values() for row in result.checks]
        return [*self.capture.checks, *self.truth.checks, *own]

    @property
    def warnings(self) -> list[str]:
        """Of capture, ground truth, methods and sampling, in this order."""
        own = [text for result in self.results.values() for text in result.warnings]
        return [*self.capture.warnings, *self.truth.warnings, *own, *self.more_warnings]
