"""Scores of one picture against another, on display-referred sRGB.

A metric is one file with one value, a `Metric`. Other packages announce theirs through the
entry-point group ``inim.metrics``, under the metric's name::

    [project.entry-points."inim.metrics"]
    mine = "my_package.score:metric"

Every metric that is installed is computed in every run; ColorVideoVDP where its package is. All
parameters are pinned: window, data range, viewing conditions. Scores are compared with the same
scene's reference only, never across scenes.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, wraps
from threading import Lock
from typing import Any

import numpy as np

from inim.backend.choice import versions
from inim.errors import UsageError
from inim.image.color import srgb_from_linear
from inim.metrics import cvvdp
from inim.metrics.base import Metric, Viewing, maps_of
from inim.metrics.flip import flip, flip_map
from inim.metrics.flip import metric as _flip
from inim.metrics.psnr import metric as _psnr
from inim.metrics.psnr import psnr_db
from inim.metrics.ssim import SSIM_WINDOW, ssim, ssim_map
from inim.metrics.ssim import metric as _ssim
from inim.plugins import announced, attribute_errors, identity, load

__all__ = [
    "RELIC_MARGIN_PX",
    "SSIM_WINDOW",
    "Metric",
    "Viewing",
    "all_metrics",
    "eia_scores",
    "find",
    "flip",
    "flip_map",
    "foreign_identities",
    "heat_map",
    "perception_packages",
    "psnr_db",
    "relic_region",
    "score",
    "score_maps",
    "ssim",
    "ssim_map",
]

#: Pixels around the relic that its scores count, too: half of SSIM's window.
RELIC_MARGIN_PX = SSIM_WINDOW // 2
_OWN = (_ssim, _psnr, _flip)
_ENTRY_POINTS = "inim.metrics"
# Other packages' functions need not bear being called from several threads.
_ONE_AT_A_TIME = Lock()
# Beyond a declared range by this share of it, a score is not rounded but wrong.


def all_metrics() -> tuple[Metric, ...]:
    """All metrics there are: the project's own, then those other packages announce, by name.

    Raises
    ------
    UsageError
        An announced one cannot be loaded, is no `Metric`, or has another's name.
    """
    return _all_metrics(tuple(sys.path))


@cache
def _all_metrics(path: tuple[str, ...]) -> tuple[Metric, ...]:  # noqa: ARG001
    """Those of a search path, looked up once."""
    perception = (cvvdp.metric,) if cvvdp.is_installed() else ()
    return (*_OWN, *perception, *_foreign_metrics())


def _foreign_metrics() -> tuple[Metric, ...]:
    return tuple(_foreign(name) for name in announced(_ENTRY_POINTS))


def _foreign(name: str) -> Metric:
    found = load(_ENTRY_POINTS, name, "metric")
    if not isinstance(found, Metric):
        raise UsageError(
            f"metric {name!r} is a {type(found).__name__}; announce an inim.metrics.Metric"
        )
    if found.name != name:
        raise UsageError(f"metric {name!r} calls itself {found.name!r}; give both one name")
    if name in {metric.name for metric in (*_OWN, cvvdp.metric)}:
        raise UsageError(f"metric {name!r} is one of inim's own; give the other one another name")
    return replace(
        found,
        function=_attributed(name, found.function, is_map=found.reach is not None),
        heat_map=found.heat_map and _attributed(name, found.heat_map, is_map=True),
    )


def _attributed(name: str, function: Callable[..., Any], *, is_map: bool) -> Callable[..., Any]:
    """Return another package's function, with the metric named in its errors."""

    @wraps(function)
    def attributed(reference: np.ndarray, test: np.ndarray, *viewing: Viewing) -> np.ndarray:
        shape = reference.shape[:2]
        with _ONE_AT_A_TIME, attribute_errors(_ENTRY_POINTS, "metric", name):
            values = np.asarray(function(reference, test, *viewing))
            if values.shape != shape and (is_map or values.shape):
                raise ValueError(f"the result has the shape {values.shape}, not {shape}")
            if np.isnan(values).any():
                raise ValueError("the result is NaN")
            return values

    return attributed


def perception_packages() -> tuple[str, ...]:
    """Distributions whose versions decide what ColorVideoVDP says; none where it is not there."""
    return cvvdp.PACKAGES if cvvdp.is_installed() else ()


def find(score_name: str) -> Metric | None:
    """The metric of a score, by its own name or any score's: ``psnr``, ``psnr_to_reference_db``."""
    name = score_name.partition("_")[0]
    return next((metric for metric in all_metrics() if metric.name == name), None)


def foreign_identities() -> dict[str, dict[str, str]]:
    """`inim.plugins.identity` of every metric of another package, for what decides results.

    Of ColorVideoVDP, where it is installed, the versions.
    """
    found = {m.name: identity(_ENTRY_POINTS, m.name) for m in _foreign_metrics()}
    packages = perception_packages()
    return found | ({cvvdp.metric.name: versions(packages)} if packages else {})


def score_maps(
    reference: np.ndarray,
    test: np.ndarray,
    keys: Sequence[str] | None = None,
    viewing: Viewing | None = None,
) -> dict[str, np.ndarray]:
    """What scores are made of, by the metrics' keys: maps whose means they are, or they themselves.

    Parameters
    ----------
    reference, test : (rows, columns, 3) float32, linear RGB
    keys : sequence of str, optional
        `Metric.key` of those wanted; all metrics without.
    viewing : Viewing, optional
        Without it, metrics that are `viewed` are left out.

    Returns
    -------
    dict of str to array
        (rows, columns); of PSNR, squared errors. () of a metric that has no map.

    Raises
    ------
    UsageError
        The pictures cannot be compared, or another package's metric failed.
    """
    metrics = {metric.key: metric for metric in all_metrics()}
    wanted = [metrics[key] for key in (metrics if keys is None else keys)]
    return maps_of(wanted, reference, test, viewing)


def score(
    reference: np.ndarray,
    test: np.ndarray,
    region: np.ndarray | None = None,
    viewing: Viewing | None = None,
) -> dict[str, float]:
    """Every metric's score under its key; with a region, those on the relic too.

    Parameters
    ----------
    reference, test : (rows, columns, 3) float32, linear RGB
    region : (rows, columns) bool, optional
        The relic's; see `relic_region`.
    viewing : Viewing, optional
        Without it, metrics that are `viewed` are left out.
    """
    maps = score_maps(reference, test, viewing=viewing)
    metrics = [metric for metric in all_metrics() if metric.key in maps]
    scores = {metric.key: metric.score(maps[metric.key]) for metric in metrics}
    if region is not None:
        for metric in metrics:
            if metric.on_relic and maps[metric.key].ndim:
                scores[metric.on_relic_key] = metric.score(maps[metric.key], region)
    return scores


def heat_map(
    metric: Metric, reference: np.ndarray, test: np.ndarray, viewing: Viewing | None
) -> np.ndarray:
    """A metric's `Metric.heat_map` of two pictures, (rows, columns), in shares of `heat_map_to`.

    Parameters
    ----------
    metric : Metric
    reference, test : (rows, columns, 3) float32, linear RGB
    viewing : Viewing, optional
        Needed by a metric that is `viewed`.
    """
    assert metric.heat_map is not None
    seen = (viewing,) if metric.viewed else ()
    found = metric.heat_map(srgb_from_linear(reference), srgb_from_linear(test), *seen)
    share: np.ndarray = np.asarray(found, np.float32) / metric.heat_map_to
    return share


def relic_region(relic: np.ndarray) -> np.ndarray:
    """The relic's region in a view: its pixels, and all within `RELIC_MARGIN_PX` of one.

    Every pixel into whose SSIM the relic enters, by scikit-image's window; on the ground beyond,
    pictures of a relic before black are equal.

    Parameters
    ----------
    relic : (rows, columns) bool
        Where the relic is.
    """
    from scipy.ndimage import maximum_filter

    side = 2 * RELIC_MARGIN_PX + 1
    region: np.ndarray = maximum_filter(relic, side, mode="constant", cval=False)
    return region


def eia_scores(reference: np.ndarray, test: np.ndarray) -> dict[str, float]:
    """Scores of panels' pixels, under the keys of the metrics that say something of them.

    Parameters
    ----------
    reference, test : (rows, columns, 3) float32, linear RGB
    """
    found = {}
    for metric in all_metrics():
        if metric.whole is not None and metric.of_eia:
            found[metric.key] = metric.whole(reference, test)
        elif metric.of_eia:
            found[metric.key] = metric.score(maps_of([metric], reference, test)[metric.key])
    return found
