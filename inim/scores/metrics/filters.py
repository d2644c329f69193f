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
        line, source = lines[row % taps], padded[row]
        line[:] = 0
        for tap in range(taps):
            for column in range(columns):
                line[column] += across[tap] * source[column + tap]
        if row < taps - 1:
            continue
        target = result[row - taps + 1]
        target[:] = 0
        for tap in range(taps):
            line = lines[(row + 1 + tap) % taps]
            for column in range(columns):
                target[column] += down[tap] * line[column]
