"""Separable filters of images."""

import numpy as np

from inim.system.backend.kernels import compiled


def separable_filter(padded: np.ndarray, across: np.ndarray, down: np.ndarray) -> np.ndarray:
    """Correlate an image with the outer product of two filters.

    * `padded`, (rows + taps - 1, columns + taps - 1) float: the image with margins.
    * `across`, `down`, (taps,) float: weights along a row and along a column.

    Returns (rows, columns) array of the image's type.
    """
    rows, columns = (side - (len(across) - 1) for side in padded.shape)
    result = np.empty((rows, columns), padded.dtype)
    weights = (np.ascontiguousarray(side, padded.dtype) for side in (across, down))
    _filter(np.ascontiguousarray(padded), *weights, result)
    return result


@compiled
def _filter(padded, across, down, result):  # type: ignore[no-untyped-def]
    """Filter each row when it is first needed; keep as many as the filter is high."""
    rows, columns = result.shape
    taps = len(down)
    lines = np.empty((taps, columns), padded.dtype)
    for row in range(rows + taps - 1):
        _filter_line(padded[row], across, lines[row % taps])
        if row < taps - 1:
            continue
        target = result[row - taps + 1]
        target[:] = 0
        for tap in range(taps):
            line = lines[(row + 1 + tap) % taps]
            for column in range(columns):
                target[column] += down[tap] * line[column]


def pair_moments(
    first: np.ndarray,
    second: np.ndarray,
    mean_first: np.ndarray,
    mean_second: np.ndarray,
    weights: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Local moments of two images from products of different replicates.

    For replicates j != k, E is the local covariance of ``second - first`` between j and k, and D
    that of `first` plus that of `second`.

    * `first`, `second`, (K, rows + taps - 1, columns + taps - 1) float32: replicates with margins
    * `mean_first`, `mean_second`, (K, rows, columns) float32: their averages by `separable_filter`
    * `weights`, (taps,) float: of the filter, along both axes

    Returns the sums of E and of D over all k, (K, rows, columns) float32, and the sums of E D and
    of D^2 over the pairs j < k, (rows, columns) float32.
    """
    errors, spreads = np.zeros((2, *mean_first.shape), np.float32)
    products, squares = np.zeros((2, *mean_first.shape[1:]), np.float32)
    images = first, second, mean_first, mean_second
    _add_pairs(*images, weights.astype(np.float32), errors, spreads, products, squares)
    return errors, spreads, products, squares


@compiled
def _add_pairs(  # type: ignore[no-untyped-def]
    first, second, mean_first, mean_second, weights, errors, spreads, products, squares
):
    count, rows, columns = errors.shape
    taps, width = len(weights), first.shape[2]
    error, spread = np.empty((2, width), np.float32)
    error_lines, spread_lines = np.empty((2, taps, columns), np.float32)
    error_mean, spread_mean = np.empty((2, columns), np.float32)
    for j in range(count):
        for k in range(j + 1, count):
            for row in range(rows + taps - 1):
                for column in range(width):
                    x, y = first[j, row, column], second[j, row, column]
                    other_x, other_y = first[k, row, column], second[k, row, column]
                    error[column] = (y - x) * (other_y - other_x)
                    spread[column] = x * other_x + y * other_y
                _filter_line(error, weights, error_lines[row % taps])
                _filter_line(spread, weights, spread_lines[row % taps])
                if row < taps - 1:
                    continue
                error_mean[:] = 0
                spread_mean[:] = 0
                for tap in range(taps):
                    line = (row + 1 + tap) % taps
                    for column in range(columns):
                        error_mean[column] += weights[tap] * error_lines[line, column]
                        spread_mean[column] += weights[tap] * spread_lines[line, column]
                target = row - taps + 1
                for column in range(columns):
                    x, y = mean_first[j, target, column], mean_second[j, target, column]
                    other_x = mean_first[k, target, column]
                    other_y = mean_second[k, target, column]
                    e = error_mean[column] - (y - x) * (other_y - other_x)
                    d = spread_mean[column] - (x * other_x + y * other_y)
                    errors[j, target, column] += e
                    errors[k, target, column] += e
                    spreads[j, target, column] += d
                    spreads[k, target, column] += d
                    products[target, column] += e * d
                    squares[target, column] += d * d


@compiled(inline="always")
def _filter_line(source, weights, line):  # type: ignore[no-untyped-def]
    line[:] = 0
    for tap in range(len(weights)):
        for column in range(len(line)):
            line[column] += weights[tap] * source[column + tap]
