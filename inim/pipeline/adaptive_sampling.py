"""Adaptive sampling: rounds of samples until the headline scores are precise.

docs/theory/skipping.md describes it. A round adds samples to those of all rounds before it, so
rounds waste nothing.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from statistics import fmean

from inim.image.noisy_image import NoisyImage, split_samples
from inim.image.rgbd import LayeredRGBD
from inim.pipeline.plan import Plan
from inim.pipeline.stages.doubts import LEAST_NOISE_FLOOR
from inim.pipeline.stages.ground_truth import GroundTruth
from inim.pipeline.stages.picture import PictureFile
from inim.pipeline.stages.scene import Rounds
from inim.pipeline.stages.scoring import headline_uncertainty, run_in_threads
from inim.pipeline.stages.stage import Run
from inim.scores.metrics import HEADLINE_WORDS, MAIN, score_maps

#: Samples of all rounds, at most, in units of `Layout.usual_samples`, which the first round has.
#: Intervals of fewer samples cannot be trusted where bright reflections are rare
#: (reports/coverage), and a round costs more than it saves.
MOST = 4


@dataclass(frozen=True)
class Sampling:
    """Samples of a run's rounds.

    `usual` are the samples per pixel by setting. The scores decide those `by_need`, up to `MOST`
    times as many; the others are taken as they are. `share` is that of all rounds so far, in units
    of the usual ones, and `rounds` are the samples of each, by setting. If `is_fixed`, a baseline
    has decided those by need: `usual` are its samples, and what exceeds the layout's is a second
    round, as in the baseline's own run.
    """

    usual: Mapping[str, int]
    by_need: Collection[str]
    share: int
    rounds: Mapping[str, Rounds]
    is_fixed: bool = False

    @classmethod
    def of(cls, plan: Plan, *, is_adaptive: bool) -> Sampling:
        """The first round of a plan; the only one unless scores decide and `is_adaptive`."""
        is_adaptive &= plan.settings.score_error > 0
        is_adaptive &= any(method.decides_samples for method in plan.methods)
        is_adaptive &= "eia_spp" in plan.by_need  # without further samples of it, nothing changes
        by_need = plan.by_need if is_adaptive else ()
        if plan.baseline is not None:
            usual = plan.display.layout.usual_samples
            exceeding = tuple(name for name in by_need if plan.samples[name] > usual[name])
            rounds = {n: (usual[n] if n in exceeding else c,) for n, c in plan.samples.items()}
            return cls(plan.samples, exceeding, 1, rounds, is_fixed=True)
        sampling = cls(plan.samples, by_need, 1, {})
        return replace(sampling, rounds={name: (n,) for name, n in sampling.totals.items()})

    @property
    def totals(self) -> dict[str, int]:
        """Samples per pixel of all rounds, by setting; whole numbers per replicate if by need."""
        totals = dict(self.usual)
        for name in self.by_need:
            totals[name] = math.prod(split_samples(self.share * totals[name]))
        return totals

    @property
    def is_last(self) -> bool:
        """True if no round may follow."""
        return not self.by_need or self.share >= MOST

    def next_round(self, excess: float) -> Sampling:
        """The sampling with another round, if intervals are `excess` times too wide.

        An interval shrinks at most as fast as the number of samples grows: noise of both images
        enters a score near 1 by its variance.
        """
        if self.is_fixed:
            further = replace(self, by_need=(), share=MOST)
        else:
            factor = 2 ** max(1, math.floor(math.log2(excess))) if math.isfinite(excess) else 2
            further = replace(self, share=min(factor * self.share, MOST))
        rounds = {
            name: (*self.rounds[name], more) if (more := total - sum(self.rounds[name])) else
            self.rounds[name]
            for name, total in further.totals.items()
        }  # fmt: skip
        return replace(further, rounds=rounds)

    def record(self, plan: Plan, run: Run) -> None:
        """Record the samples that the scores did not need among the skipped steps."""
        if not self.by_need:
            return
        used, most = self.totals, replace(self, share=MOST).totals
        words = {"capture_spp": "RGB-D", "eia_spp": "observed EIA", "view_spp": "view"}
        performed = ", ".join(f"{used[name]} per {word} pixel" for name, word in words.items())
        unused = ", ".join(f"{most[name] - used[name]}" for name in words)
        error = f"{plan.settings.score_error:g}"
        if self.is_last:
            run.skipped.add("samples", performed, "none", f"scores need all for +-{error}")
            return
        reason = (
            f"the mean interval of {HEADLINE_WORDS}, is within +-{error} for each of inim's own "
            "algorithms and finished EIAs"
        )
        run.skipped.add("samples", performed, f"{unused} more", reason)


def interval_excess(
    truth: GroundTruth, views: Sequence[Mapping[str, NoisyImage]], error: float, run: Run
) -> float:
    """Ratio of the half width of a method's headline intervals to the error; 1: precise enough.

    It is that of the worst method, in the mean over the viewpoints; `views` are those of each
    method, by viewpoint. It is infinite while an interval is unknown or the ground truth is mostly
    noise, which allows no conclusion.
    """

    def half_widths(viewpoint: str) -> list[float]:
        region = truth.regions[viewpoint]
        halves = score_maps(*truth.views[viewpoint].halves(), [MAIN.key])
        if MAIN.score(halves[MAIN.key], region) < LEAST_NOISE_FLOOR:
            return [math.inf] * len(views)
        reference, pictures = truth.reference_views[viewpoint], [v[viewpoint] for v in views]
        return [headline_uncertainty(reference, view, region, run=run) for view in pictures]

    calls = {viewpoint: partial(half_widths, viewpoint) for viewpoint in truth.views}
    by_viewpoint = run_in_threads(truth, calls, run).values()
    return max(map(fmean, zip(*by_viewpoint, strict=True))) / error


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
