"""FLIP by pixel: opponent colours, Hunt-adjusted L*a*b*, and the error between two appearances."""

import math
from functools import cache

import numpy as np

from inim.system.backend.kernels import compiled

# Exponent of colour differences. The large ones, from a share of the largest one on, are compressed
# into the last part of the scale.
_COLOR_EXPONENT, _LARGE_SHARE, _LARGE_PART = 0.7, 0.4, 0.05

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
# Matrices by rows: products of single numbers round alike for every shape of image.
_FROM_RGB, _TO_RGB, _TO_XYZ = (
    tuple(map(tuple, matrix.astype(np.float32)))
    for matrix in (_OPPONENT, np.linalg.inv(_OPPONENT), _RELATIVE_XYZ)
)


def padded_opponent(linear: np.ndarray, margin: int) -> np.ndarray:
    """Opponent colours YCxCz of linear RGB, with a margin that repeats the nearest pixel.

    * `linear`, (rows, columns, 3) float32

    Returns (3, rows + 2 margin, columns + 2 margin) float32 array.
    """
    rows, columns, _ = linear.shape
    padded = np.empty((3, rows + 2 * margin, columns + 2 * margin), np.float32)
    _to_opponent(np.ascontiguousarray(linear), margin, padded)
    return padded


def hunt_lab(opponent: np.ndarray) -> np.ndarray:
    """L*a*b* of opponent colours, which are clipped to RGB in 0..1; (3, rows, columns) float32.

    Colours count less where it is dark (Hunt).
    """
    lab = np.empty_like(opponent)
    _to_hunt_lab(opponent, lab)
    return lab


def compare_appearances(
    color: np.ndarray, features: np.ndarray, other_color: np.ndarray, other_features: np.ndarray
) -> np.ndarray:
    """FLIP error between two appearances.

    * `color`, (3, rows, columns) float32: Hunt-adjusted L*a*b*
    * `features`, (2, rows, columns) float32: strength of edges and of points

    Returns (rows, columns) float32 array.
    """
    error = np.empty(color.shape[1:], np.float32)
    largest = np.float32(_largest_color_error())
    _compare(color, features, other_color, other_features, largest, error)
    return error


@cache
def _largest_color_error() -> float:
    """Colour error between pure green and pure blue."""
    green, blue = hunt_lab(_OPPONENT.astype(np.float32)[:, None, 1:])[:, 0].T
    return float((abs(green[0] - blue[0]) + math.hypot(*(green - blue)[1:])) ** _COLOR_EXPONENT)


@compiled(inline="always")
def _product(matrix, row, x, y, z):  # type: ignore[no-untyped-def]
    return matrix[row][0] * x + matrix[row][1] * y + matrix[row][2] * z


@compiled
def _to_opponent(linear, margin, padded):  # type: ignore[no-untyped-def]
    rows, columns, _ = linear.shape
    for row in range(rows + 2 * margin):
        source = linear[min(max(row - margin, 0), rows - 1)]
        for column in range(columns):
            red, green, blue = source[column]
            padded[0, row, margin + column] = _product(_FROM_RGB, 0, red, green, blue)
            padded[1, row, margin + column] = _product(_FROM_RGB, 1, red, green, blue)
            padded[2, row, margin + column] = _product(_FROM_RGB, 2, red, green, blue)
        for channel in range(3):
            line = padded[channel, row]
            line[:margin] = line[margin]
            line[margin + columns :] = line[margin + columns - 1]


@compiled(inline="always")
def _clip(value):  # type: ignore[no-untyped-def]
    return min(max(value, np.float32(0)), np.float32(1))


@compiled(inline="always")
def _lab_curve(share):  # type: ignore[no-untyped-def]
    """The curve of L*a*b* less its value for black, which would cancel.

    Halley's iteration triples the digits of the cube root, from one above the knee.
    """
    root = np.float32(0.28) + np.float32(0.75) * share
    for _ in range(3):
        cube = root * root * root
        root *= (cube + share + share) / (cube + cube + share)
    curved = root - np.float32(4 / 29)
    return curved if share > np.float32(_KNEE**3) else share * np.float32(1 / (3 * _KNEE**2))


@compiled(error_model="numpy")
def _to_hunt_lab(opponent, lab):  # type: ignore[no-untyped-def]
    _, rows, columns = opponent.shape
    for row in range(rows):
        for column in range(columns):
            first, second = opponent[0, row, column], opponent[1, row, column]
            third = opponent[2, row, column]
            red = _clip(_product(_TO_RGB, 0, first, second, third))
            green = _clip(_product(_TO_RGB, 1, first, second, third))
            blue = _clip(_product(_TO_RGB, 2, first, second, third))
            x = _lab_curve(_product(_TO_XYZ, 0, red, green, blue))
            y = _lab_curve(_product(_TO_XYZ, 1, red, green, blue))
            z = _lab_curve(_product(_TO_XYZ, 2, red, green, blue))
            lab[0, row, column] = np.float32(116) * y
            lab[1, row, column] = np.float32(580) * y * (x - y)
            lab[2, row, column] = np.float32(232) * y * (y - z)


@compiled(error_model="numpy")
def _compare(color, features, other_color, other_features, largest, error):  # type: ignore[no-untyped-def]
    large = np.float32(_LARGE_SHARE) * largest
    low_slope = np.float32(1 - _LARGE_PART) / large
    high_slope = np.float32(_LARGE_PART) / (largest - large)
    exponent, half_root = np.float32(_COLOR_EXPONENT), np.float32(math.sqrt(0.5))
    rows, columns = error.shape
    for row in range(rows):
        for column in range(columns):
            lightness = color[0, row, column] - other_color[0, row, column]
            red_green = color[1, row, column] - other_color[1, row, column]
            blue_yellow = color[2, row, column] - other_color[2, row, column]
            chroma = np.sqrt(red_green * red_green + blue_yellow * blue_yellow)
            difference = (abs(lightness) + chroma) ** exponent
            if difference < large:
                difference *= low_slope
            else:
                difference = np.float32(1 - _LARGE_PART) + (difference - large) * high_slope
            edge = abs(features[0, row, column] - other_features[0, row, column])
            point = abs(features[1, row, column] - other_features[1, row, column])
            feature = np.sqrt(max(edge, point) * half_root)
            error[row, column] = min(difference, np.float32(1)) ** (np.float32(1) - feature)
