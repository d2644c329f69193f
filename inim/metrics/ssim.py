"""SSIM: structural similarity."""

from __future__ import annotations

import numpy as np

from inim.metrics.base import Metric, maps_of

#: Side of the window in pixels, cut off at 3.5 sigma by scikit-image; smallest side of an image.
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
    # Same as `mean(axis=-1)` over three colours, ten times as fast.
    mean: np.ndarray = (local[..., 0] + local[..., 1] + local[..., 2]) / 3
    return mean


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
