"""Light on the relic: mean of each colour in a view, by region, and relative to a reference view.

SSIM and FLIP hardly respond to a brightness error of some per cent. The light of a region is the
mean V_c of colour c there, in per cent of white. Light to the reference, with means R_c and their
mean R over the colours, is

    100 (V_c - R_c) / R

In linear light, neither has a bias from noise. The regions are the relic and its upper, lower, left
and right half.

The error of a mean follows from the sums x of the noise over overlapping windows of side L, half of
the view with replicates and 16 pixels with halves. A window has 4 x 4 blocks, and each block is in
16 windows:

    error^2 = (1 - d / L)^-2 / 16 sum over windows (sum over replicates of x^2) / (K (K - 1))

Noise that is correlated over a distance d keeps (1 - d / L)^2 of its variance in the windows,
wherever it is. Disjoint ones would lose it at their borders: a lit edge in the middle of the
picture lies on one. Source: Politis and Romano, J. Multivariate Analysis 47, 1993.
"""

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from inim.image.noisy_image import NoisyImage
from inim.scores.regression.noise_free import sum_blocks
from inim.scores.regression.scores import LIGHT, ScoreEstimate, common_replicates
from inim.scores.regression.verdict import freedom_of_sum

# Blocks along a side of a window.
_WINDOW = 4
# Blocks along a side of a view of replicates, and their least side in pixels. Those of halves are
# small, because few windows of two parts would hardly tell the error.
_BLOCKS, _LEAST_PX, _HALVES_PX = 8, 8, 4
# Distance in pixels over which an algorithm's noise is correlated, about a lens
# (reports/regression).
_CORRELATED_PX = 4.4
_COLOURS = ("red", "green", "blue")


def light_scores(
    reference: NoisyImage, test: NoisyImage, region: np.ndarray
) -> dict[str, ScoreEstimate]:
    """Light on every region, and on the relic to the reference, in per cent; empty without light.

    Names are such as `light_on_relic_red` and `light_on_relic_red_to_reference`. The region is that
    of the relic, (rows, columns) bool.
    """
    old, new = _parts(reference, test)
    if not old[:, region].any():
        return {}
    scores, block_px = {}, _block_px(new)
    for name, mask in _regions(region).items():
        scale = 100 / np.count_nonzero(mask)
        for c, colour in enumerate(_COLOURS):
            sums = scale * _block_sums(new[..., c], mask)
            scores[f"{LIGHT}_on_{name}_{colour}"] = _estimate(sums, sums, block_px)
    greys = _block_sums(old.mean(axis=-1), region)
    light = greys.sum() / len(old)
    for c, colour in enumerate(_COLOURS):
        changes = 100 / light * _block_sums(new[..., c] - old[..., c], region)
        # The noise of R changes the score in proportion to it.
        share = changes.sum() / len(changes) / light
        score = _estimate(changes, changes - share * greys, block_px)
        scores[f"{LIGHT}_on_relic_{colour}_to_reference"] = score
    return scores


def _block_px(parts: np.ndarray) -> tuple[int, int]:
    """Rows and columns of the blocks of K images."""
    if len(parts) == 2:
        return _HALVES_PX, _HALVES_PX
    rows, columns = (max(_LEAST_PX, math.ceil(side / _BLOCKS)) for side in parts.shape[1:3])
    return rows, columns


def _block_sums(parts: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Sums of K images over a mask by block, (K, rows, columns) float64."""
    return np.stack([sum_blocks(np.where(mask, part, 0), _block_px(parts)) for part in parts])


def _estimate(sums: np.ndarray, noise: np.ndarray, block_px: tuple[int, int]) -> ScoreEstimate:
    """A sum over the blocks, mean of K parts, with its error from the differences of `noise`."""
    noise = noise - noise.mean(axis=0)
    # Windows reach over the border, so that each block is in equally many.
    frame = _WINDOW - 1
    framed = np.pad(noise, ((0, 0), (frame, frame), (frame, frame)))
    windows = sliding_window_view(framed, (_WINDOW, _WINDOW), (1, 2)).sum(axis=(-2, -1))
    count, overlap = len(noise), _WINDOW**2
    variances = np.square(windows).sum(axis=0) / (count * (count - 1))
    variance = variances.sum() / overlap
    freedom = freedom_of_sum(variance, np.square(variances).sum() / overlap, count - 1)
    variance_share = math.prod(1 - _CORRELATED_PX / (_WINDOW * side) for side in block_px)
    error = math.sqrt(float(variance) / variance_share)
    return ScoreEstimate(float(sums.sum()) / count, error, float(freedom), 0.0)


def _parts(reference: NoisyImage, test: NoisyImage) -> tuple[np.ndarray, np.ndarray]:
    """Independent parts of both images, as many of each: replicates, or halves."""
    if replicates := common_replicates(reference, test):
        return replicates
    old, new = (np.stack(image.halves()) for image in (reference, test))
    return old, new


def _regions(relic: np.ndarray) -> dict[str, np.ndarray]:
    """The relic and its halves, cut at the median row and column of its pixels."""
    rows, columns = np.nonzero(relic)
    if not rows.size:
        return {}
    row, column = np.median(rows), np.median(columns)
    y, x = np.indices(relic.shape)
    return {
        "relic": relic,
        "upper_half": relic & (y <= row),
        "lower_half": relic & (y >= row),
        "left_half": relic & (x <= column),
        "right_half": relic & (x >= column),
    }
