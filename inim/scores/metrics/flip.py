"""LDR-FLIP: the difference that an observer sees when flipping between two images."""

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from inim.image.color import linear_from_srgb
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
# Exponents of colour and feature differences; the large colour differences, from a share of the
# largest one on, are compressed into the last part of the scale.
_COLOR_EXPONENT, _FEATURE_EXPONENT = 0.7, 0.5
_LARGE_SHARE, _LARGE_PART = 0.4, 0.05

_XYZ = np.array(
    [
        [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
        [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
        [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
    ]
)
# Linear RGB to XYZ relative to white, and from there to YCxCz, whose Y has the offset -16.
_RELATIVE_XYZ = _XYZ / _XYZ.sum(axis=1, keepdims=True)
_OPPONENT = np.array([[0, 116, 0], [500, -500, 0], [0, 200, -200]]) @ _RELATIVE_XYZ
# Cube root of the intensity below which the curve of L*a*b* is straight.
_KNEE = 6 / 29
_RGB_OF_OPPONENT = np.linalg.inv(_OPPONENT).T.astype(np.float32)


class _Appearance(NamedTuple):
    """An image as an observer sees it; each field (channels, rows, columns)."""

    color: np.ndarray  #: L*a*b* without invisible detail, Hunt-adjusted.
    features: np.ndarray  #: Strength of edges and points.


def _error(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    first, second = _appearance(reference), _appearance(test)
    lightness, red_green, blue_yellow = np.abs(first.color - second.color)
    color = (lightness + np.hypot(red_green, blue_yellow)) ** np.float32(_COLOR_EXPONENT)
    largest = _largest_color_error()
    large = np.float32(_LARGE_SHARE * largest)
    color = np.where(
        color < large,
        color * ((1 - _LARGE_PART) / large),
        1 - _LARGE_PART + (color - large) * np.float32(_LARGE_PART / (largest - large)),
    )
    feature = np.abs(first.features - second.features).max(axis=0) / np.float32(math.sqrt(2))
    error: np.ndarray = np.minimum(color, 1) ** (1 - feature ** np.float32(_FEATURE_EXPONENT))
    return error


def _appearance(image: np.ndarray) -> _Appearance:
    """Colour and features of an image, (rows, columns, 3) float32 sRGB in 0..1."""
    from inim.scores.metrics.filters import separable_filter

    opponent = np.moveaxis(linear_from_srgb(image) @ _OPPONENT.T.astype(np.float32), -1, 0)
    margin = ((0, 0), (FLIP_REACH, FLIP_REACH), (FLIP_REACH, FLIP_REACH))
    padded = np.pad(opponent, margin, mode="edge")
    visible = np.stack(
        [
            sum(separable_filter(plane, weights * share, weights) for share, weights in gaussians)
            for plane, gaussians in zip(padded, _color_filters(), strict=True)
        ]
    )
    linear = np.clip(np.moveaxis(visible, 0, -1) @ _RGB_OF_OPPONENT, 0, 1)
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
    return _Appearance(_hunt_lab(linear), np.stack(features))


def _hunt_lab(linear: np.ndarray) -> np.ndarray:
    """L*a*b* of linear RGB, (3, rows, columns); colours count less where it is dark (Hunt)."""
    relative = np.moveaxis(linear @ _RELATIVE_XYZ.T.astype(np.float32), -1, 0)
    # The curve of L*a*b* less its value for black, which would cancel.
    x, y, z = np.where(
        relative > _KNEE**3,
        np.cbrt(relative) - np.float32(4 / 29),
        relative / np.float32(3 * _KNEE**2),
    )
    return np.stack([116 * y, 580 * y * (x - y), 232 * y * (y - z)])


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


@cache
def _largest_color_error() -> float:
    """Colour error between pure green and pure blue."""
    green, blue = _hunt_lab(np.eye(3, dtype=np.float32)[None, 1:])[:, 0].T
    return float((abs(green[0] - blue[0]) + math.hypot(*(green - blue)[1:])) ** _COLOR_EXPONENT)


metric = Metric(
    "flip",
    _error,
    better="lower",
    tolerance=0.005,  # as SSIM's
    reference="Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström and Fairchild, HPG 2020",
    has_relic_score=True,
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
