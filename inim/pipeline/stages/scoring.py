"""Scores: of a method's EIA and views, of the reference, and of the ground truth against itself."""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from inim.image.noisy_image import NoisyImage
from inim.pipeline.stages.capture import nonfinite_checks
from inim.pipeline.stages.generation import GeneratedEIA, ReferenceOutput
from inim.pipeline.stages.ground_truth import (
    BLACK,
    CLIPPED_SHARE,
    GroundTruth,
    any_colour,
    out_of_range_share,
)
from inim.pipeline.stages.stage import SCORING, Run, stage
from inim.report.document import AlgorithmResult, NoiseFloor
from inim.scores import metrics
from inim.scores.document_parts import Check, ScorePrecision, check
from inim.scores.metrics import HEADLINE, HEADLINE_WORDS, Viewing
from inim.scores.regression.fingerprints import Fingerprint
from inim.scores.regression.light import light_scores
from inim.scores.regression.scores import ScoreEstimate, headline_half_width, view_scores
from inim.scores.regression.tiles import TileStatistics, eia_tile, tile_statistics, view_tile
from inim.system.process.machine import memory_limit_bytes
from inim.system.process.threads import Submit, threads

# Scoring takes about 100 bytes per pixel. All images scored at once take 0.4 GB, or an eighth of
# the memory if that is more.
_BYTES_PER_PIXEL = 100
_LEAST_BYTES = 2**22 * _BYTES_PER_PIXEL
# Scores by their name in report.json.
Scores = dict[str, ScoreEstimate]


@dataclass(frozen=True)
class Statistics:
    """Statistics of a method or of the ground truth, for comparisons with later runs.

    `scores` and light scores are by ``NAME/VIEWPOINT``, then by score name.
    """

    pictures: dict[str, TileStatistics] = field(default_factory=dict)
    scores: dict[str, dict[str, ScoreEstimate]] = field(default_factory=dict)
    fingerprints: dict[str, Fingerprint] = field(default_factory=dict)
    light: dict[str, dict[str, ScoreEstimate]] = field(default_factory=dict)


@dataclass(frozen=True)
class MethodResult:
    """Scores of a method, as in report.json, with its statistics, checks and warnings.

    `reference_output` is None unless the method is a generator.
    """

    scores: AlgorithmResult
    statistics: Statistics = field(default_factory=Statistics)
    reference_output: ReferenceOutput | None = None
    checks: tuple[Check, ...] = ()
    warnings: tuple[str, ...] = ()


@stage("scores of a view", code=SCORING, result_types=(ScoreEstimate,))
def score_view(
    reference: NoisyImage, test: NoisyImage, region: np.ndarray, viewing: Viewing | None
) -> Scores:
    """Score a view, whole and on the relic; the region is (rows, columns) bool.

    `viewing` is None if no metric needs viewing conditions.
    """
    return view_scores(reference, test, region, viewing=viewing)


@stage("light of a view", code=SCORING, result_types=(ScoreEstimate,))
def _score_light(reference: NoisyImage, test: NoisyImage, region: np.ndarray) -> Scores:
    """Compare the mean colours on the relic; the region is (rows, columns) bool."""
    return light_scores(reference, test, region)


def _score_light_of_views(
    name: str,
    truth: GroundTruth,
    references: Mapping[str, NoisyImage],
    views: Mapping[str, NoisyImage],
    run: Run,
) -> dict[str, Scores]:
    """Light scores of views, by ``NAME/VIEWPOINT``."""
    return {
        f"{name}/{viewpoint}": _score_light(
            references[viewpoint], view, truth.regions[viewpoint], run=run
        )
        for viewpoint, view in views.items()
    }


@stage("uncertainty of a headline score", code=SCORING)
def headline_uncertainty(reference: NoisyImage, test: NoisyImage, region: np.ndarray) -> float:
    """Half width of the interval of a headline score; the region is (rows, columns) bool."""
    return headline_half_width(reference, test, region)


@stage("scores of two halves", code=SCORING)
def _score_halves(
    image: NoisyImage, region: np.ndarray, viewing: Viewing | None
) -> dict[str, float]:
    """Score one half of the samples against the other by every metric."""
    return metrics.score(image.first, image.second, region, viewing)


@stage("scores of an EIA", code=SCORING)
def _score_eia_pixels(reference: np.ndarray, test: np.ndarray) -> dict[str, float]:
    """Score panel pixels by the metrics that apply to them."""
    return metrics.eia_scores(reference, test)


def score_method(
    name: str,
    output: GeneratedEIA,
    views: Mapping[str, NoisyImage],
    truth: GroundTruth,
    limit: float | None = None,
    *,
    run: Run,
) -> MethodResult:
    """Score a method's EIA against the ground truth, its views against ground truth and reference.

    Views are given by viewpoint; `limit` is the smallest headline score that passes.
    """
    eia = output.eia
    with _scoring_threads(truth, run) as submit:
        # Submit the longest task first.
        tiles = submit(_eia_tiles, f"eia/{name}", eia, truth, True, run)
        eia_scores = submit(_score_eia, truth, run, eia.image)
        futures = {
            viewpoint: submit(_score_against_truth, truth, viewpoint, view, run)
            for viewpoint, view in views.items()
        }
        light = submit(_score_light_of_views, name, truth, truth.reference_views, views, run)
        reference = output.reference_output
        fingerprints = {} if reference is None else {name: reference.fingerprint}
        scores_by_view = {viewpoint: future.result() for viewpoint, future in futures.items()}
        view_values, precision = reported_scores(scores_by_view)
        result = AlgorithmResult(
            eia=eia_scores.result() | {"hole_fraction": output.hole_fraction},
            views=view_values,
            precision=precision,
            seconds=output.seconds,
            unlit_fraction=_unlit_fraction(eia.image, truth) if truth.is_whole else None,
            terms=output.terms,
        )
        scores = {f"{name}/{viewpoint}": s for viewpoint, s in scores_by_view.items()}
        statistics = Statistics(tiles.result(), scores, fingerprints, light.result())
    checks = [
        *nonfinite_checks(f"eia/{name}", eia.nonfinite),
        *missing_viewpoints(name, [*truth.views], views),
        _content_check(name, output),
        *_criteria(name, limit, scores_by_view),
    ]
    warnings = [*filter(None, [output.remark]), *_range_warnings(name, eia.image, truth)]
    return MethodResult(result, statistics, reference, tuple(checks), tuple(warnings))


def reported_scores(
    views: Mapping[str, Scores],
) -> tuple[dict[str, dict[str, float | None]], dict[str, dict[str, ScorePrecision]]]:
    """Noise-corrected scores and their precision, by viewpoint, as in report.json."""
    values: dict[str, dict[str, float | None]] = {}
    precision = {}
    for view, scores in views.items():
        values[view] = {key: score.value for key, score in scores.items()}
        precision[view] = {
            key: ScorePrecision(plain=score.plain, interval=score.interval)
            for key, score in scores.items()
        }
    return values, precision


def _score_against_truth(truth: GroundTruth, viewpoint: str, view: NoisyImage, run: Run) -> Scores:
    """Score a view against the ground-truth view and against the reference view."""
    to_scene = _score_view(truth.views[viewpoint], view, truth, viewpoint, run)
    to_reference = _score_view(truth.reference_views[viewpoint], view, truth, viewpoint, run)
    names = {metric.key: metric.to_reference_key for metric in metrics.all_metrics()}
    names |= {m.on_relic_key: m.on_relic_to_reference_key for m in metrics.all_metrics()}
    return to_scene | {names[key]: score for key, score in to_reference.items()}


def _score_view(
    reference: NoisyImage, test: NoisyImage, truth: GroundTruth, viewpoint: str, run: Run
) -> Scores:
    scores = score_view(reference, test, *truth.conditions(viewpoint), run=run)
    if truth.has_intervals:
        return scores
    return {name: score.without_interval for name, score in scores.items()}


def _score_eia(
    truth: GroundTruth, run: Run, eia: np.ndarray | None = None
) -> dict[str, float | None]:
    """Score an EIA, or the noise floor without one; all None if the run renders only a part."""
    if not truth.is_whole:
        return {metric.key: None for metric in metrics.all_metrics() if metric.has_eia_score}
    if eia is None:
        return dict(_score_eia_pixels(truth.eia.first, truth.eia.second, run=run))
    return dict(_score_eia_pixels(truth.eia.image, eia, run=run))


def score_reference_views(truth: GroundTruth, *, run: Run) -> dict[str, Scores]:
    """Score the reference views against the ground-truth views, by viewpoint."""
    calls = {
        name: partial(_score_view, view, truth.reference_views[name], truth, name, run)
        for name, view in truth.views.items()
    }
    return run_in_threads(truth, calls, run)


def compute_noise_floor(truth: GroundTruth, *, run: Run) -> NoiseFloor | None:
    """Score one half of the ground truth's samples against the other; None if it has no noise."""
    if not truth.is_rendered:
        return None
    calls = {"": partial(_score_eia, truth, run)} | {
        name: partial(_score_halves, view, *truth.conditions(name), run=run)
        for name, view in truth.views.items()
    }
    views = run_in_threads(truth, calls, run)
    return NoiseFloor(eia=views.pop(""), views=views)


def compute_truth_statistics(
    truth: GroundTruth, reference_scores: Mapping[str, Scores], *, run: Run
) -> Statistics:
    """Compute the statistics of the ground truth, including the scores of the reference views."""
    calls = {"": partial(_eia_tiles, "truth/eia", truth.eia, truth, False, run)} | {
        f"truth/{name}": partial(_tiles, view, view_tile(view.shape), False, run=run)
        for name, view in truth.views.items()
    }
    views = run_in_threads(truth, calls, run)
    scores = {f"reference/{name}": scores for name, scores in reference_scores.items()}
    light = _score_light_of_views("reference", truth, truth.views, truth.reference_views, run)
    return Statistics(views.pop("") | views, scores, light=light)


def run_in_threads(
    truth: GroundTruth, calls: Mapping[str, Callable[[], Any]], run: Run
) -> dict[str, Any]:
    """Results of calls, by name, in parallel."""
    with _scoring_threads(truth, run) as submit:
        futures = {name: submit(call) for name, call in calls.items()}
        return {name: future.result() for name, future in futures.items()}


@contextmanager
def _scoring_threads(truth: GroundTruth, run: Run) -> Iterator[Submit]:
    """Threads for scoring a run's images, limited by memory."""
    largest = max(math.prod(image.shape) for image in (truth.eia, *truth.views.values()))
    allowed = max(_LEAST_BYTES, memory_limit_bytes() // 8)
    with run.observer.timed("score"), threads(allowed // (_BYTES_PER_PIXEL * largest)) as submit:
        yield submit


def missing_viewpoints(name: str, expected: Sequence[str], views: Collection[str]) -> list[Check]:
    """A failed check if views are missing; otherwise empty."""
    missing = [view for view in expected if view not in views]
    if not missing and views:
        return []
    detail = ", ".join(missing) or "no views"
    return [check(f"{name}: viewpoints missing", max(1, len(missing)), "<=", 0, detail)]


def _unlit_fraction(eia: np.ndarray, truth: GroundTruth) -> float:
    """Share of the pixels with light in the ground-truth EIA that are black in another EIA."""
    lit = any_colour(truth.eia.image > BLACK)
    unlit = lit & ~any_colour(eia > BLACK)
    return int(np.count_nonzero(unlit)) / max(1, int(np.count_nonzero(lit)))


def _content_check(name: str, output: GeneratedEIA) -> Check:
    """Check that the EIA is neither black nor all holes."""
    if output.hole_fraction is None:
        return check(
            f"{name}: brightest value", float(output.eia.image.max()), ">=", BLACK, "not black"
        )
    share = 1 - output.hole_fraction
    return check(f"{name}: share of pixels shown", share, ">=", 1e-6, "not all holes")


def _range_warnings(name: str, eia: np.ndarray, truth: GroundTruth) -> list[str]:
    # The ground truth has its own warning for light that the scene itself clips.
    share = out_of_range_share(eia)
    if share - truth.clipped_share <= CLIPPED_SHARE:
        return []
    return [
        f"eia/{name}: {share:.1%} of the pixels are below black or brighter than the panel's "
        "white, which no panel shows; clip them, or check that they are linear"
    ]


def _criteria(name: str, limit: float | None, scores_by_view: Mapping[str, Scores]) -> list[Check]:
    """Check each view's headline score against the smallest that passes."""
    if limit is None:
        return []
    return [
        check(
            f"{name}/{view}: {HEADLINE_WORDS}",
            scores[HEADLINE].value,
            ">=",
            limit,
            interval=scores[HEADLINE].interval,
            criterion=True,
        )
        for view, scores in scores_by_view.items()
    ]


@stage("tile statistics", code=SCORING, result_types=(TileStatistics,))
def _tiles(image: NoisyImage, tile: tuple[int, int], generated: bool) -> TileStatistics:
    return tile_statistics(image, tile, generated=generated)


def _eia_tiles(
    name: str, eia: NoisyImage, truth: GroundTruth, generated: bool, run: Run
) -> dict[str, TileStatistics]:
    """Tile statistics of an EIA; empty if the run renders only a part of it."""
    display = truth.display
    tile = eia_tile(display.eia_shape, display.layout.grid)
    return {name: _tiles(eia, tile, generated, run=run)} if truth.is_whole else {}
