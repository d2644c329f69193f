"""SSIM: structural similarity."""

from __future__ import annotations

import numpy as np

from inim.metrics.base import Metric, maps_of

#: Side of the window in pixels, as scikit-image cuts it off at 3.5 sigma; the least picture side.
SSIM_WINDOW = 11
# Arguments of skimage.metrics.structural_similarity, as Wang et al. 2004 define the score.
_SETTINGS = {
    "data_range": 1.0,
    "channel_axis": -1,
    "gaussian_weights": True,
    "sigma": 1.5,
    "use_sample_covariance": False,
}


def _similarity(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    from skimage.metrics import structural_similarity

    _, local = structural_similarity(reference, test, full=True, **_SETTINGS)
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
    border=SSIM_WINDOW // 2,  # as scikit-image's own mean
    reach=SSIM_WINDOW // 2,
    where_equal=1.0,
    least_px=SSIM_WINDOW,
    settings=_SETTINGS,
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


def ssim(reference: np.ndarray, test: np.ndarray, region: np.ndarray | None = None) -> float:
    """scikit-image's number: the mean of `ssim_map` without 5 pixels along each side.

    With a (rows, columns) bool region, over its pixels that are left.
    """
    return metric.score(ssim_map(reference, test), region)
