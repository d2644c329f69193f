"""Light on the relic: mean of each colour in a view, by region, and relative to a reference view.

SSIM and FLIP hardly respond to a brightness error of some per cent. The light of a region is the
mean V_c of colour c there, in per cent of white. Light to the reference, with means R_c and their
mean R over the colours, is

    100 (V_c - R_c) / R

In linear light, neither has a bias from noise. The regions are the relic and its upper, lower, left
and right half.
"""

import math

import numpy as np

from inim.image.noisy_image import NoisyImage
from inim.scores.regression.noise_free import error_of_responses, sum_blocks
from inim.scores.regression.scores import LIGHT, ScoreEstimate, common_replicates

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
    scores = {}
    for name, mask in _regions(region).items():
        scale = 100 / np.count_nonzero(mask)
        for c, colour in enumerate(_COLOURS):
            scores[f"{LIGHT}_on_{name}_{colour}"] = _estimate(scale * _sums(new[..., c], mask))
    greys = _sums(old.mean(axis=-1), region)
    light = greys.sum() / len(old)
    for c, colour in enumerate(_COLOURS):
        changes = 100 / light * _sums(new[..., c] - old[..., c], region)
        # The noise of R changes the score in proportion to it.
        share = changes.sum() / len(changes) / light
        score = _estimate(changes, changes - share * greys)
        scores[f"{LIGHT}_on_relic_{colour}_to_reference"] = score
    return scores


def _sums(parts: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Sums of K images over a mask by block, (K, rows, columns)."""
    return np.stack([sum_blocks(np.where(mask, part, 0)) for part in parts])


def _estimate(sums: np.ndarray, noise: np.ndarray | None = None) -> ScoreEstimate:
    """A sum over the blocks, mean of K parts, with its error from their differences."""
    noise = sums if noise is None else noise
    responses = (noise - noise.mean(axis=0)) / math.sqrt(len(noise) * (len(noise) - 1))
    return ScoreEstimate(float(sums.sum()) / len(sums), *error_of_responses(responses), 0.0)


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
