"""How wrong an EIA is, in three ways: its sources, its EIA, the views of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from inim import metrics
from inim.display import Display, Viewpoint
from inim.generators import HOLE, NO_LENS, SourceGenerator, Sources, find_sources
from inim.generators.raycast.supersampling import Supersampled
from inim.pipeline.timing import TimedMethod, linear_picture
from inim.rgbd import RGBD, LayeredRGBD
from inim.settings import Settings

__all__ = ["ERRORS", "Reference", "evaluate", "make_reference", "mark_fronts", "noise_floor"]

#: The errors that times stand against, each smaller the better, from a method's data.
ERRORS: dict[str, Callable[[Mapping[str, Any]], float]] = {
    "wrong_source": lambda c: c["wrong_source"],
    "eia_psnr_db": lambda c: -c["eia_psnr_db"],
    "eia_ssim": lambda c: 1 - c["eia_ssim"],
    "view_ssim_to_ceiling": lambda c: 1 - c["view_ssim_to_ceiling"],
}

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
    """

    exact: Sources
    eia: np.ndarray
    views_of: ViewsOf
    ceiling: Sequence[np.ndarray]


def make_reference(
    rgbd: RGBD,
    eia: np.ndarray,
    display: Display,
    viewpoints: Sequence[Viewpoint],
    settings: Settings | None = None,
) -> Reference:
    """What EIAs made from a display-ready RGB-D picture are compared with.

    Views are those of a validation with these settings; without, of 4 x 4 pixels to the lens
    and 64 samples through `thick` lenses.
    """
    from inim.render.reconstruct import exposed_views

    sampling: dict[str, Any] = {}
    if settings is not None:
        sampling = {
            "lens_model": settings.lens_model,
            "pixels_per_lens": settings.view_pixels_per_lens,
            "spp": settings.reconstruction_spp,
            "seed": settings.seed,
        }

    def views_of(shown: np.ndarray) -> list[np.ndarray]:
        return exposed_views(shown, display, viewpoints, **sampling)

    exact = find_sources(rgbd, display, "template")
    return Reference(exact, eia, views_of, views_of(eia))


def evaluate(method: TimedMethod, reference: Reference) -> dict[str, Any]:
    """Errors of the very EIA that was timed, under the names of bench.json."""
    made = linear_picture(method.out)
    sources = _sources(method)
    empty = method.out[..., 3] == 0 if sources is None else sources == HOLE
    wrong = None if sources is None else _lensed_share(sources != reference.exact, reference.exact)
    return {
        "wrong_source": wrong,
        "hole_fraction": _lensed_share(empty, reference.exact),
        "averaged_share": _averaged_share(method),
        **_scores(reference.eia, made, reference.ceiling, reference.views_of(made)),
    }


def noise_floor(first: np.ndarray, second: np.ndarray, views_of: ViewsOf) -> dict[str, float]:
    """One half of the ground truth's samples against the other, by the same measures."""
    return _scores(first, second, views_of(first), views_of(second))


def _scores(
    reference: np.ndarray,
    eia: np.ndarray,
    ceiling: Sequence[np.ndarray],
    views: Sequence[np.ndarray],
) -> dict[str, float]:
    """Every metric's score of the EIA, where it has one, and its mean over the views."""
    of_eia = metrics.eia_scores(reference, eia)
    of_views = [metrics.score(*pair) for pair in zip(ceiling, views, strict=True)]
    return {f"eia_{key}": value for key, value in of_eia.items()} | {
        f"view_{metric.to_ceiling_key}": float(np.mean([view[metric.key] for view in of_views]))
        for metric in metrics.all_metrics()
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


def mark_fronts(methods: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The methods' data with their place: `fronts` by error, and `pareto`, on any of them."""
    fronts: list[list[str]] = [[] for _ in methods]
    for name, error in ERRORS.items():
        points = [(m["median_ms"], None if m[name] is None else float(error(m))) for m in methods]
        for front, is_on in zip(fronts, pareto(points), strict=True):
            front += [name] * is_on
    return [
        {**m, "fronts": front, "pareto": bool(front)}
        for m, front in zip(methods, fronts, strict=True)
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
