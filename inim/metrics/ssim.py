"""SSIM: structural similarity."""

from __future__ import annotations

import numpy as np

from inim.metrics.base import Metric, maps_of, mean_of

__all__ = ["SSIM_WINDOW", "metric", "ssim", "ssim_map"]

# Wang et al. 2004: Gaussian window of 1.5 pixels.
_SIGMA = 1.5
#: Side of that window in pixels, as scikit-image cuts it off at 3.5 sigma; the least picture side.
SSIM_WINDOW = 11


def _similarity(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    from skimage.metrics import structural_similarity

    _, local = structural_similarity(
        reference,
        test,
        data_range=1.0,
        channel_axis=-1,
        gaussian_weights=True,
        sigma=_SIGMA,
        use_sample_covariance=False,
        full=True,
    )
    # As `mean(axis=-1)`, which takes ten times as long over three.
    mean: np.ndarray = (local[..., 0] + local[..., 1] + local[..., 2]) / 3
    return mean


metric = Metric(
    "ssim",
    _similarity,
    better="higher",
    range=(-1.0, 1.0),
    # Half of the last digit but one that reports quote; where algorithms differ, they differ by
    # hundredths.
    tolerance=0.005,
    reference="Wang, Bovik, Sheikh and Simoncelli, IEEE TIP 2004",
    of_eia=True,
    on_relic=True,
    reach=SSIM_WINDOW // 2,
    where_equal=1.0,
    least_px=SSIM_WINDOW,
)


def ssim_map(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    """Structural similarity of each pixel, (rows, columns) float32, mean over the channels.

    Parameters
    ----------
    reference, test : (rows, columns, 3) float32, linear RGB

    Source: Wang, Bovik, Sheikh and Simoncelli, IEEE TIP 2004, as in scikit-image, without the
    sample-covariance correction, as the paper defines it.
    """
    return maps_of([metric], reference, test)[metric.key]


def ssim(reference: np.ndarray, test: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Mean of `ssim_map`, over a (rows, columns) bool mask if one is given."""
    return mean_of(ssim_map(reference, test), mask)
