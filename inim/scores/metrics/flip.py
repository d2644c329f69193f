"""LDR-FLIP: the difference that an observer sees when flipping between two images."""

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from inim.scores.metrics.base import Metric, maps_of

# Viewing distance of 0.7 m from an ordinary monitor, 0.7 m wide with 3840 pixels.
_PIXELS_PER_DEGREE = 67.0
# Contrast sensitivity of luminance, red-green and blue-yellow, table 1 of the paper: amplitudes and
# widths [square degrees] of a sum of Gaussians.
_SENSITIVITY = (
    ((1.0, 0.0047),),
    ((1.0, 0.0053),),
    ((34.1, 0.04), (13.5, 0.025)),
)
#: Reach of its filters in pixels: three sigma of the widest Gaussian.
FLIP_REACH = math.ceil(3 * math.sqrt(0.04 / 2) / math.pi * _PIXELS_PER_DEGREE)
# Standard deviation of the detectors of edges and points: half the width of an edge, 0.082 degrees.
_FEATURE_SIGMA = 0.5 * 0.082 * _PIXELS_PER_DEGREE


class _Appearance(NamedTuple):
    """An image as an observer sees it; each field (channels, rows, columns)."""

    color: np.ndarray  #: L*a*b* without invisible detail, Hunt-adjusted.
    features: np.ndarray  #: Strength of edges and points.


def _error(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    from inim.scores.metrics.flip_kernels import compare_appearances

    return compare_appearances(*_appearance(reference), *_appearance(test))


def _appearance(image: np.ndarray) -> _Appearance:
    """Colour and features of an image, (rows, columns, 3) float32 linear RGB in 0..1."""
    from inim.scores.metrics.filters import separable_filter
    from inim.scores.metrics.flip_kernels import hunt_lab, padded_opponent

    padded = padded_opponent(image, FLIP_REACH)
    visible = [
        sum(separable_filter(plane, weights * share, weights) for share, weights in gaussians)
        for plane, gaussians in zip(padded, _color_filters(), strict=True)
    ]
    smooth, slope, curvature = _feature_filters()
    edge = FLIP_REACH - len(smooth) // 2
    luminance = padded[0, edge : -edge or None, edge : -edge or None] / np.float32(116)
    features = [
        np.hypot(
            separable_filter(luminance, detector, smooth),
            separable_filter(luminance, smooth, detector),
        )
        for detector in (slope, curvature)
    ]
    return _Appearance(hunt_lab(np.stack(visible)), np.stack(features))


@cache
def _color_filters() -> list[list[tuple[float, np.ndarray]]]:
    """Gaussians of each channel: their shares, and weights along an axis that sum up to 1."""
    squares = (np.arange(-FLIP_REACH, FLIP_REACH + 1) / _PIXELS_PER_DEGREE) ** 2
    filters = []
    for terms in _SENSITIVITY:
        profiles = [np.exp(-(np.pi**2) / width * squares) for _, width in terms]
        sums = [
            amplitude * math.sqrt(math.pi / width) * profile.sum() ** 2
            for (amplitude, width), profile in zip(terms, profiles, strict=True)
        ]
        filters.append([(s / sum(sums), p / p.sum()) for s, p in zip(sums, profiles, strict=True)])
    return filters


@cache
def _feature_filters() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A Gaussian, and its first and second derivative; each sign sums up to 1."""
    radius = math.ceil(3 * _FEATURE_SIGMA)
    steps = np.arange(-radius, radius + 1) / _FEATURE_SIGMA
    gaussian = np.exp(-(steps**2) / 2)

    def balanced(weights: np.ndarray) -> np.ndarray:
        ups, downs = np.maximum(weights, 0), np.maximum(-weights, 0)
        result: np.ndarray = ups / ups.sum() - downs / downs.sum()
        return result

    return (
        gaussian / gaussian.sum(),
        balanced(-steps * gaussian),
        balanced((steps**2 - 1) * gaussian),
    )


metric = Metric(
    "flip",
    _error,
    better="lower",
    tolerance=0.005,  # as SSIM's
    reference="Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström and Fairchild, HPG 2020",
    has_relic_score=True,
    takes_linear=True,
    remaining_bias=0.9,  # it takes a root of small errors
    reach=FLIP_REACH,
    settings={"ppd": _PIXELS_PER_DEGREE},
)


def flip_map(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    """LDR-FLIP error of each pixel, (rows, columns) float32, 0 (equal) to 1.

    * `reference`, `test`, (rows, columns, 3) float32, linear RGB

    Source: Andersson et al., HPG 2020, at 67 pixels per degree.
    """
    return maps_of([metric], reference, test)[metric.key]


def flip(reference: np.ndarray, test: np.ndarray) -> float:
    """Mean of `flip_map`."""
    return metric.score(flip_map(reference, test))
