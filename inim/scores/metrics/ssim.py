"""SSIM: structural similarity."""

from __future__ import annotations

import numpy as np

from inim.scores.metrics.base import Metric, maps_of

#: Side of the window in pixels, which ends at 3.5 sigma; smallest side of an image.
SSIM_WINDOW = 11
# The score as Wang et al. 2004 define it, in the arguments of scikit-image's structural_similarity.
_SETTINGS = {
    "data_range": 1.0,
    "channel_axis": -1,
    "gaussian_weights": True,
    "sigma": 1.5,
    "use_sample_covariance": False,
}
# Constants of the paper, which keep both fractions finite, for values in 0..1.
_C1, _C2 = 0.01**2, 0.03**2
# Subtracted before squaring: a variance in float32 loses least where the values are near zero.
_SHIFT = np.float32(0.25)


def _similarity(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    red, green, blue = map(
        _channel_similarity, np.moveaxis(reference, -1, 0), np.moveaxis(test, -1, 0)
    )
    mean: np.ndarray = (red + green + blue) / np.float32(3)
    return mean


def _channel_similarity(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Similarity of two (rows, columns) images: equations 6 and 13 of the paper."""
    from inim.scores.metrics.filters import separable_filter

    steps = np.arange(-(SSIM_WINDOW // 2), SSIM_WINDOW // 2 + 1)
    window = np.exp(-((steps / 1.5) ** 2) / 2)
    window /= window.sum()
    x, y = (np.pad(image - _SHIFT, SSIM_WINDOW // 2, mode="symmetric") for image in (first, second))
    mean_x, mean_y, square_x, square_y, product = (
        separable_filter(values, window, window) for values in (x, y, x * x, y * y, x * y)
    )
    covariance = product - mean_x * mean_y
    variances = (square_x - mean_x * mean_x) + (square_y - mean_y * mean_y)
    mean_x, mean_y = mean_x + _SHIFT, mean_y + _SHIFT
    similarity: np.ndarray = (2 * mean_x * mean_y + _C1) * (2 * covariance + _C2)
    similarity /= (mean_x * mean_x + mean_y * mean_y + _C1) * (variances + _C2)
    return similarity


metric = Metric(
    "ssim",
    _similarity,
    better="higher",
    range=(-1.0, 1.0),
    # Half of a hundredth; algorithms differ by hundredths.
    tolerance=0.005,
    reference="Wang, Bovik, Sheikh and Simoncelli, IEEE TIP 2004",
    has_eia_score=True,
    has_relic_score=True,
    border=SSIM_WINDOW // 2,  # same as scikit-image's mean
    reach=SSIM_WINDOW // 2,
    equal_value=1.0,
    min_size_px=SSIM_WINDOW,
    settings=_SETTINGS,
)


def ssim_map(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    """Structural similarity of each pixel, (rows, columns) float32, mean over the channels.

    * `reference`, `test`, (rows, columns, 3) float32, linear RGB

    Source: Wang, Bovik, Sheikh and Simoncelli, IEEE TIP 2004, as in scikit-image, without the
    sample-covariance correction, as the paper defines it.
    """
    return maps_of([metric], reference, test)[metric.key]


def ssim(reference: np.ndarray, test: np.ndarray, region: np.ndarray | None = None) -> float:
    """Mean of `ssim_map` without a border of 5 pixels, as in scikit-image.

    With a (rows, columns) bool region, the mean over its pixels inside the border.
    """
    return metric.score(ssim_map(reference, test), region)
