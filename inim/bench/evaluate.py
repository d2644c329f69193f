"""How wrong an EIA is, in three ways: its sources, its EIA, the views of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from msgspec.structs import replace

from inim import metrics
from inim.display import Display
from inim.documents.bench import BenchAlgorithm, BenchScore
from inim.generators import HOLE, NO_LENS, SourceGenerator, Sources, find_sources
from inim.generators.raycast.supersampling import Supersampled
from inim.image.rgbd import RGBD, LayeredRGBD
from inim.metrics import Viewing
from inim.timing.methods import TimedMethod, linear_picture

# Scores with a panel of their own; those of other packages' metrics have one, too.
_PLOTTED = ("eia_psnr_db", "view_ssim_to_ceiling")


@dataclass(frozen=True)
class Score:
    """A metric of the EIA, against the true one, or of its views: their mean to the ceiling."""

    metric: metrics.Metric
    of_views: bool

    @property
    def key(self) -> str:
        """Its name in bench.json."""
        return f"view_{self.metric.to_ceiling_key}" if self.of_views else f"eia_{self.metric.key}"

    def described(self) -> BenchScore:
        """The score's description; `best` is None where that is infinite."""
        metric = self.metric
        best = metric.range[1 if metric.better == "higher" else 0]
        words = f"view {metric.label} to ceiling" if self.of_views else f"EIA {metric.label}"
        return BenchScore(
            key=self.key,
            label=f"{words} {metric.unit}".rstrip(),
            title="Views" if self.of_views else "Elemental images",
            better=metric.better,
            best=best if math.isfinite(best) else None,
            digits=metric.digits,
            plotted=self.key in _PLOTTED or metric.name in metrics.foreign_identities(),
        )


def all_scores() -> list[Score]:
    """All that there are, in the order of the tables: of the EIA, then of its views."""
    of_eia = [Score(metric, False) for metric in metrics.all_metrics() if metric.of_eia]
    return of_eia + [Score(metric, True) for metric in metrics.all_metrics()]


#: Views of an EIA, one for each viewpoint: (rows, columns, 3) float32, linear RGB.
ViewsOf = Callable[[np.ndarray], Sequence[np.ndarray]]


@dataclass(frozen=True)
class Reference:
    """What the EIAs of all methods are compared with.

    Attributes
    ----------
    exact : Sources
        By the exact traversal.
    eia : (rows, columns, 3) float32
        Ground truth, linear RGB.
    views_of : callable
        The views of an EIA.
    ceiling : sequence of array
        Views of the ground-truth EIA.
    viewing : sequence of Viewing, optional
        How each view is seen, for metrics of perception; they are left out without.
    """

    exact: Sources
    eia: np.ndarray
    views_of: ViewsOf
    ceiling: Sequence[np.ndarray]
    viewing: Sequence[Viewing] = ()


def make_reference(
    rgbd: RGBD,
    eia: np.ndarray,
    display: Display,
    views_of: ViewsOf,
    viewing: Sequence[Viewing] = (),
) -> Reference:
    """What EIAs made from a display-ready RGB-D picture are compared with.

    Parameters
    ----------
    rgbd : RGBD
        Display-ready.
    eia : (rows, columns, 3) float32
        Ground truth, linear RGB.
    display : Display
    views_of : callable
        The views of an EIA.
    viewing : sequence of Viewing, optional
        How each view is seen.
    """
    exact = find_sources(rgbd, display)
    return Reference(exact, eia, views_of, views_of(eia), viewing)


def evaluate(method: TimedMethod, reference: Reference) -> dict[str, Any]:
    """Errors of the EIA that was timed, by field of `BenchAlgorithm`."""
    made = linear_picture(method.out)
    sources = _sources(method)
    empty = method.out[..., 3] == 0 if sources is None else sources == HOLE
    wrong = None if sources is None else _lensed_share(sources != reference.exact, reference.exact)
    return {
        "wrong_source": wrong,
        "hole_fraction": _lensed_share(empty, reference.exact),
        "averaged_share": _averaged_share(method),
        "scores": _scores(
            reference.eia, made, reference.ceiling, reference.views_of(made), reference.viewing
        ),
    }


def noise_floor(
    first: np.ndarray, second: np.ndarray, views_of: ViewsOf, viewing: Sequence[Viewing] = ()
) -> dict[str, float | None]:
    """One half of the ground truth's samples against the other, by the same measures."""
    return _scores(first, second, views_of(first), views_of(second), viewing)


def _scores(
    true_eia: np.ndarray,
    eia: np.ndarray,
    true_views: Sequence[np.ndarray],
    views: Sequence[np.ndarray],
    viewing: Sequence[Viewing],
) -> dict[str, float | None]:
    """All scores, by key."""
    of_eia = metrics.eia_scores(true_eia, eia)
    seen: Sequence[Viewing | None] = viewing or [None] * len(views)
    of_views = [
        metrics.score(truth, view, viewing=how)
        for truth, view, how in zip(true_views, views, seen, strict=True)
    ]
    return {
        one.key: float(np.mean([view[one.metric.key] for view in of_views]))
        if one.of_views
        else of_eia[one.metric.key]
        for one in all_scores()
        if viewing or not one.metric.viewed
    }


def _sources(method: TimedMethod) -> Sources | None:
    """Which pixels of the picture the colours come from; None if that does not say it."""
    if isinstance(method.generator, SourceGenerator) and not isinstance(method.rgbd, LayeredRGBD):
        return method.generator.sources(method.rgbd)
    return None


def _averaged_share(method: TimedMethod) -> float | None:
    """Share of the panel's pixels whose rays meet unlike things; None of those with one ray."""
    if not isinstance(method.generator, Supersampled):
        return None
    sources = method.generator.samples(method.rgbd)
    return float((sources != sources[0]).any(axis=0).mean())


def _lensed_share(chosen: np.ndarray, exact: Sources) -> float:
    """Share of the lensed panel pixels."""
    lensed = exact != NO_LENS
    return int((chosen & lensed).sum()) / max(1, int(lensed.sum()))


# -- time against error -------------------------------------------------------------------------


def mark_fronts(algorithms: Sequence[BenchAlgorithm]) -> list[BenchAlgorithm]:
    """The algorithms with their `fronts` by error, and `pareto`: on any of them."""
    errors: dict[str, list[float | None]] = {
        "wrong_source": [algorithm.wrong_source for algorithm in algorithms]
    }
    for score in all_scores():
        sign = 1 if score.metric.better == "lower" else -1
        values = [algorithm.scores.get(score.key) for algorithm in algorithms]
        errors[score.key] = [None if value is None else sign * value for value in values]
    fronts: list[list[str]] = [[] for _ in algorithms]
    for name, error in errors.items():
        points = [(a.median_ms, e) for a, e in zip(algorithms, error, strict=True)]
        for front, is_on in zip(fronts, pareto(points), strict=True):
            front += [name] * is_on
    return [
        replace(algorithm, fronts=front, pareto=bool(front))
        for algorithm, front in zip(algorithms, fronts, strict=True)
    ]


def pareto(points: Sequence[tuple[float, float | None]]) -> list[bool]:
    """Which points (time, error) no other beats: none is as good in both and better in one.

    A point without an error (None) is never on the front.
    """

    def beaten(mine: tuple[float, float]) -> bool:
        return any(
            other[1] is not None and other[0] <= mine[0] and other[1] <= mine[1] and other != mine
            for other in points
        )

    return [error is not None and not beaten((t, error)) for t, error in points]
