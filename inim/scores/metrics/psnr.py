"""PSNR: peak signal-to-noise ratio."""

import math

import numpy as np

from inim.image.color import srgb_from_linear
from inim.scores.metrics.base import Metric, check_images, left_out_changes, mean_of_products
from inim.system.row_bands import row_bands


def _squared_error(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    squares = reference.astype(np.float64) - test
    np.square(squares, out=squares)
    # Same as `mean(axis=-1)` over three colours, ten times as fast.
    mean: np.ndarray = (squares[..., 0] + squares[..., 1] + squares[..., 2]) / 3
    return mean


def _noise_free_squared_error(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    """Squared error without noise: products of the errors of different replicates."""
    error = reference - test
    square, changes = (f(error).mean(axis=-1) for f in (mean_of_products, left_out_changes))
    return np.stack([square, square, np.zeros_like(square), *changes])


def _decibels(squared_error: float) -> tuple[float, float]:
    """PSNR of a mean squared error, and its derivative; infinite and 0 for equal images."""
    if squared_error == 0:
        return math.inf, 0.0
    return -10 * math.log10(squared_error), -10 / math.log(10) / squared_error


def psnr_db(reference: np.ndarray, test: np.ndarray) -> float:
    """Peak signal-to-noise ratio of sRGB in 0..1, dB; infinite for equal images.

    * `reference`, `test`, (rows, columns, 3) float32, linear RGB
    """
    check_images(reference, test)
    by_row: list[float] = []  # summed exactly, so that the height of bands has no effect
    for band in row_bands(*reference.shape[:2]):
        first, second = (srgb_from_linear(image[band]) for image in (reference, test))
        squares = np.square(first.astype(np.float64) - second)
        by_row += squares.reshape(len(squares), -1).sum(axis=1).tolist()
    return _decibels(math.fsum(by_row) / reference.size)[0]


metric = Metric(
    "psnr",
    _squared_error,
    better="higher",
    range=(0.0, math.inf),
    unit="dB",
    digits=2,
    tolerance=0.1,  # a smaller change is invisible
    has_eia_score=True,
    has_relic_score=True,
    score_from_mean=_decibels,
    noise_free=_noise_free_squared_error,
    # Exact but for the sRGB curve, which compresses rare bright samples.
    remaining_bias=0.5,
    whole_image_score=psnr_db,
    reach=0,
    dtype=np.float64,
    settings={"data_range": 1.0},
)
