"""Scores: of a method's EIA and views, of the reference, and of the ground truth against itself."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from inim import metrics
from inim.documents.parts import Check, ScorePrecision
from inim.documents.report import AlgorithmResult, NoiseFloor
from inim.image.noisy_image import NoisyImage
from inim.metrics import Viewing
from inim.metrics.headline import HEADLINE, HEADLINE_WORDS
from inim.pipeline.stages.checks import (
    BLACK,
    CLIPPED_SHARE,
    check,
    missing_viewpoints,
    nonfinite_checks,
    share_outside,
)
from inim.pipeline.stages.generate import GeneratedEIA, Reference
from inim.pipeline.stages.ground_truth import GroundTruth
from inim.pipeline.stages.stage import SCORING, Run, stage
from inim.process.threads import Submit, threads
from inim.regression import (
    Fingerprint,
    ScoreEstimate,
    TileStatistics,
    eia_tile,
    score_interval,
    tile_statistics,
    view_scores,
    view_tile,
)

# A score takes some 100 bytes a pixel while it is made: 0.4 GB for all of them together.
_PIXELS_AT_ONCE = 2**22
# Scores by their names in report.json.
Scores = dict[str, ScoreEstimate]


@dataclass(frozen=True)
class Statistics:
    """What later runs can be compared with, of one method or of the ground truth.

    Attributes
    ----------
    pictures : dict of str to TileStatistics
    scores : dict of str to dict of str to ScoreEstimate
        By ``NAME/VIEWPOINT``.
    fingerprints : dict of str to Fingerprint
    """

    pictures: dict[str, TileStatistics] = field(default_factory=dict)
    scores: dict[str, dict[str, ScoreEstimate]] = field(default_factory=dict)
    fingerprints: dict[str, Fingerprint] = field(default_factory=dict)


@dataclass(frozen=True)
class MethodResult:
    """What a method is worth.

    Attributes
    ----------
    scores : AlgorithmResult
        As in report.json.
    statistics : Statistics
        That later runs can be compared with.
    reference : Reference, optional
        What it makes of the reference input, where it is a generator.
    checks : tuple of Check
    warnings : tuple of str
    """

    scores: AlgorithmResult
    statistics: Statistics = field(default_factory=Statistics)
    reference: Reference | None = None
    checks: tuple[Check, ...] = ()
    warnings: tuple[str, ...] = ()


@stage("scores of a view", code=SCORING, makes=(ScoreEstimate,))
def score_view(
    reference: NoisyImage, test: NoisyImage, region: np.ndarray, viewing: Viewing | None
) -> Scores:
    """Scores of a view, of the whole and on the relic.

    Parameters
    ----------
    reference, test : NoisyImage
    region : (rows, columns) bool
        The relic's; see `inim.metrics.relic_region`.
    viewing : Viewing, optional
        How it is seen; None if no metric asks for it.
    """
    return view_scores(reference, test, region, viewing=viewing)


@stage("scores of two halves", code=SCORING)
def _score_halves(
    image: NoisyImage, region: np.ndarray, viewing: Viewing | None
) -> dict[str, float]:
    """One half of the samples against the other, by every metric."""
    return metrics.score(image.first, image.second, region, viewing)


@stage("scores of an EIA", code=SCORING)
def _score_eia(reference: np.ndarray, test: np.ndarray) -> dict[str, float]:
    """Scores of a panel by the metrics that apply to one."""
    return metrics.eia_scores(reference, test)


def evaluate(
    name: str,
    made: GeneratedEIA,
    views: Mapping[str, NoisyImage],
    truth: GroundTruth,
    limit: float | None = None,
    *,
    run: Run,
) -> MethodResult:
    """Score a method: its EIA against the true one, its views against the scene and the reference.

    Parameters
    ----------
    name : str
    made : GeneratedEIA
    views : mapping of str to NoisyImage
        By viewpoint.
    truth : GroundTruth
    limit : float, optional
        The smallest headline score that passes.
    run : Run
    """
    eia = made.eia
    with _scoring_threads(truth, run) as submit:
        # The longest first.
        statistics = submit(_eia_tiles, f"eia/{name}", eia, truth, True, run)
        whole = submit(_eia_scores, truth, run, eia.image)
        pending = {view: submit(_against, truth, view, one, run) for view, one in views.items()}
        # In this thread: a generator of another package may count on its own.
        reference = made.reference
        prints = {} if reference is None else {name: reference.fingerprint()}
        found = {view: one.result() for view, one in pending.items()}
        views_scores, precision = reported_scores(found)
        scores = AlgorithmResult(
            eia=whole.result() | {"hole_fraction": made.hole_fraction},
            views=views_scores,
            precision=precision,
            seconds=made.seconds,
        )
        judged = {f"{name}/{view}": one for view, one in found.items()}
        kept = Statistics(statistics.result(), judged, prints)
    checks = [
        *nonfinite_checks(f"eia/{name}", eia.nonfinite),
        *missing_viewpoints(name, [*truth.views], views),
        _shows_something(name, made),
        *_limits(name, limit, found),
    ]
    warnings = _too_bright(name, eia.image, truth)
    return MethodResult(scores, kept, reference, tuple(checks), tuple(warnings))


def reported_scores(
    views: Mapping[str, Scores],
) -> tuple[dict[str, dict[str, float | None]], dict[str, dict[str, ScorePrecision]]]:
    """Scores without noise and their precision, by viewpoint, as in report.json."""
    values: dict[str, dict[str, float | None]] = {}
    precision = {}
    for view, scores in views.items():
        values[view] = {key: score.value for key, score in scores.items()}
        precision[view] = {
            key: ScorePrecision(plain=score.plain, interval=score_interval(score))
            for key, score in scores.items()
        }
    return values, precision


def _against(truth: GroundTruth, name: str, view: NoisyImage, run: Run) -> Scores:
    """Scores of a view against the rendered view, and against the reference's."""
    conditions = truth.conditions(name)
    to_scene = score_view(truth.views[name], view, *conditions, run=run)
    to_reference = score_view(truth.reference_views[name], view, *conditions, run=run)
    names = {metric.key: metric.to_reference_key for metric in metrics.all_metrics()}
    names |= {m.on_relic_key: m.on_relic_to_reference_key for m in metrics.all_metrics()}
    return to_scene | {names[key]: one for key, one in to_reference.items()}


def _eia_scores(
    truth: GroundTruth, run: Run, eia: np.ndarray | None = None
) -> dict[str, float | None]:
    """Scores of an EIA; none where the run makes only what is observed of it.

    Without an EIA, the noise floor's.
    """
    if not truth.whole:
        return {metric.key: None for metric in metrics.all_metrics() if metric.of_eia}
    if eia is None:
        return dict(_score_eia(truth.eia.first, truth.eia.second, run=run))
    return dict(_score_eia(truth.eia.image, eia, run=run))


@stage("heat map of a view", code=SCORING)
def _heat_map(
    reference: np.ndarray, test: np.ndarray, viewing: Viewing | None, metric: str
) -> np.ndarray:
    """What a metric finds lost where, (rows, columns), in shares of what is shown at most."""
    found = metrics.find(metric)
    assert found is not None
    return metrics.heat_map(found, reference, test, viewing)


def heat_maps(
    truth: GroundTruth,
    references: Mapping[str, NoisyImage],
    views: Mapping[str, NoisyImage],
    *,
    run: Run,
) -> dict[str, np.ndarray]:
    """Where views lose to what they are compared with, by metric and viewpoint: ``cvvdp/left``.

    Of metrics that have a `heat_map`; see there.
    """
    shown = [metric.name for metric in metrics.all_metrics() if metric.heat_map is not None]
    with _scoring_threads(truth, run) as submit:
        pending = {
            f"{metric}/{eye}": submit(
                _heat_map, references[eye].image, view.image, truth.viewing[eye], metric, run=run
            )
            for metric in shown
            for eye, view in views.items()
        }
        return {name: one.result() for name, one in pending.items()}


def reference_scores(truth: GroundTruth, *, run: Run) -> dict[str, Scores]:
    """What perfect elemental images show, against the rendered view, by viewpoint."""
    with _scoring_threads(truth, run) as submit:
        pending = {
            name: submit(
                score_view, view, truth.reference_views[name], *truth.conditions(name), run=run
            )
            for name, view in truth.views.items()
        }
        return {name: one.result() for name, one in pending.items()}


def noise_floor(truth: GroundTruth, *, run: Run) -> NoiseFloor:
    """The ground truth against itself, one half of its samples against the other."""
    with _scoring_threads(truth, run) as submit:
        whole = submit(_eia_scores, truth, run)
        pending = {
            name: submit(_score_halves, view, *truth.conditions(name), run=run)
            for name, view in truth.views.items()
        }
        views: dict[str, dict[str, float | None]] = {
            name: {**one.result()} for name, one in pending.items()
        }
        return NoiseFloor(eia=whole.result(), views=views)


def truth_statistics(
    truth: GroundTruth, reference: Mapping[str, Scores], *, run: Run
) -> Statistics:
    """Statistics of the ground truth, and scores of the reference, by viewpoint."""
    with _scoring_threads(truth, run) as submit:
        whole = submit(_eia_tiles, "truth/eia", truth.eia, truth, False, run)
        pending = {
            name: submit(_tiles, view, view_tile(view.shape), False, run=run)
            for name, view in truth.views.items()
        }
        views = {f"truth/{name}": one.result() for name, one in pending.items()}
        pictures = whole.result() | views
    return Statistics(pictures, {f"reference/{name}": found for name, found in reference.items()})


@contextmanager
def _scoring_threads(truth: GroundTruth, run: Run) -> Iterator[Submit]:
    """Threads to score a run's images in, as many as their memory allows."""
    largest = max(math.prod(image.shape) for image in (truth.eia, *truth.views.values()))
    with run.observer.timed("score"), threads(_PIXELS_AT_ONCE // largest) as submit:
        yield submit


def _shows_something(name: str, made: GeneratedEIA) -> Check:
    """An EIA that shows nothing is a failure to report."""
    if made.hole_fraction is None:
        return check(
            f"{name}: brightest value", float(made.eia.image.max()), ">=", BLACK, "not black"
        )
    shown = 1 - made.hole_fraction
    return check(f"{name}: share of pixels shown", shown, ">=", 1e-6, "not all holes")


def _too_bright(name: str, eia: np.ndarray, truth: GroundTruth) -> list[str]:
    # What the scene's own light clips has its warning already.
    outside = share_outside(eia)
    if outside - truth.clipped <= CLIPPED_SHARE:
        return []
    return [
        f"eia/{name}: {outside:.1%} of the pixels are below black or brighter than the panel's "
        "white, which no panel shows; clip them, or check that they are linear"
    ]


def _limits(name: str, limit: float | None, found: Mapping[str, Scores]) -> list[Check]:
    """Each view's headline score against the smallest that passes."""
    if limit is None:
        return []
    return [
        check(
            f"{name}/{view}: {HEADLINE_WORDS}",
            scores[HEADLINE].value,
            ">=",
            limit,
            interval=score_interval(scores[HEADLINE]),
            criterion=True,
        )
        for view, scores in found.items()
    ]


@stage("tile statistics", code=SCORING, makes=(TileStatistics,))
def _tiles(image: NoisyImage, tile: tuple[int, int], generated: bool) -> TileStatistics:
    return tile_statistics(image, tile, generated=generated)


def _eia_tiles(
    name: str, eia: NoisyImage, truth: GroundTruth, generated: bool, run: Run
) -> dict[str, TileStatistics]:
    """Statistics of an EIA by the two halves of its samples; none where the run makes a part."""
    display = truth.display
    tile = eia_tile(display.eia_shape, (display.lens_rows, display.lens_columns))
    return {name: _tiles(eia, tile, generated, run=run)} if truth.whole else {}
