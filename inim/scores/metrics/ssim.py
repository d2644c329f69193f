"""SSIM: structural similarity."""

from typing import Any

import numpy as np

from inim.scores.metrics.base import Metric, left_out_changes, maps_of, mean_of_products

#: Side of the window in pixels, which ends at 3.5 sigma; smallest side of an image.
SSIM_WINDOW = 11
# The score as Wang et al. 2004 define it.
_SETTINGS: dict[str, Any] = {
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
_STEPS = np.arange(-(SSIM_WINDOW // 2), SSIM_WINDOW // 2 + 1)
_WINDOW = np.exp(-((_STEPS / 1.5) ** 2) / 2)
_WINDOW /= _WINDOW.sum()
# Smallest share of the noisy images' variance that is taken as the variance without noise, and
# largest second-order term of a window: in windows with a firefly both are mostly noise.
_LEAST_VARIANCE, _MOST_SECOND_ORDER = 0.5, 0.3


def _similarity(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    from skimage.metrics import structural_similarity

    _, similarity = structural_similarity(reference, test, full=True, **_SETTINGS)
    mean: np.ndarray = similarity.mean(axis=-1)
    return mean


def _pad(images: np.ndarray) -> np.ndarray:
    """Pad (K, rows, columns) images by half of the window, and shift their values."""
    half = SSIM_WINDOW // 2
    return np.pad(images - _SHIFT, ((0, 0), (half, half), (half, half)), mode="symmetric")


def _average(padded: np.ndarray) -> np.ndarray:
    """Average a padded image over the window."""
    from inim.scores.metrics.filters import separable_filter

    return separable_filter(padded, _WINDOW, _WINDOW)


def _noise_free_similarity(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    red, green, blue = map(
        _noise_free_channel, np.moveaxis(reference, -1, 0), np.moveaxis(test, -1, 0)
    )
    mean: np.ndarray = (red + green + blue) / np.float32(3)
    return mean


def _noise_free_channel(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Estimate the similarity without noise from (K, rows, columns) replicates of two images.

    The similarity is ``l (1 - E / D)``, where l compares the local means, E is the local variance
    of the difference of the images and D the sum of their variances plus a constant. Every moment
    is a mean of products of different replicates, whose noise is independent. The ratio's
    second-order bias is ``E var(D) / D^3 - cov(E, D) / D^2``. See docs/theory/scores.md.
    """
    from inim.scores.metrics.filters import pair_moments

    count = len(first)
    x, y = _pad(first), _pad(second)
    mean_x, mean_y = (np.stack([*map(_average, images)]) for images in (x, y))
    mean_difference = mean_y - mean_x
    errors, spreads, products, squares = pair_moments(x, y, mean_x, mean_y, _WINDOW)
    pairs = count * (count - 1)
    error, spread = errors.sum(axis=0) / pairs, spreads.sum(axis=0) / pairs
    # The product of two means, minus the mean of products of pairs without a common replicate.
    pairs_of_pairs = pairs * (count - 2) * (count - 3)
    covariance, variance = (
        mean * spread
        - (pairs * pairs * mean * spread - 4 * ((sums * spreads).sum(axis=0) - squared))
        / pairs_of_pairs
        for mean, sums, squared in ((error, errors, products), (spread, spreads, squares))
    )
    plain_x, plain_y = x.mean(axis=0), y.mean(axis=0)
    plain = _average(plain_x * plain_x + plain_y * plain_y)
    plain -= mean_x.mean(axis=0) ** 2 + mean_y.mean(axis=0) ** 2
    noise = 1 - (spread + _C2) / (plain.clip(0) + _C2)
    spread = np.maximum(spread, _LEAST_VARIANCE * plain.clip(0)).clip(0) + _C2

    distance = mean_of_products(mean_difference)
    mean_x, mean_y = mean_x + _SHIFT, mean_y + _SHIFT
    brightness = (mean_of_products(mean_x) + mean_of_products(mean_y)).clip(0) + _C1
    luminance = 1 - distance / brightness
    ratio = error / spread
    second_order = (ratio * variance - covariance) / (spread * spread)
    second_order = second_order.clip(-_MOST_SECOND_ORDER, _MOST_SECOND_ORDER)

    error_change, spread_change = (
        2 / (count - 2) * (sums / (count - 1) - sums.sum(axis=0) / pairs)
        for sums in (errors, spreads)
    )
    change = luminance / spread * (ratio * spread_change - error_change)
    brightness_change = left_out_changes(mean_x) + left_out_changes(mean_y)
    change += (
        (ratio - 1)
        / brightness
        * (left_out_changes(mean_difference) - distance / brightness * brightness_change)
    )
    first_order = luminance * (1 - ratio)
    estimate = first_order + luminance * second_order
    return np.stack([estimate, first_order, noise, *change])


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
    noise_free=_noise_free_similarity,
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
