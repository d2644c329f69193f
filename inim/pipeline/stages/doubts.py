"""Reasons why the scores of a run allow no conclusion."""

from collections.abc import Mapping

import numpy as np

from inim.image.noisy_image import NoisyImage
from inim.pipeline.stages.ground_truth import GroundTruth
from inim.pipeline.stages.scoring import MethodResult
from inim.report.document import NoiseFloor
from inim.scores.metrics import MAIN

#: Least SSIM of two halves of a ground-truth view; below it, scores are mostly those of the noise.
LEAST_NOISE_FLOOR = 0.7
# Largest share of an image's light that exceeds white in one half of the samples only.
_MOST_FIREFLIES = 0.02
# Largest share of the lit panel pixels that stay black with every generator.
_MOST_UNLIT = 0.25


def find_doubts(
    truth: GroundTruth, results: Mapping[str, MethodResult], noise_floor: NoiseFloor | None
) -> list[str]:
    """Reasons to doubt all scores: a noisy ground truth, fireflies, or an incomplete capture."""
    doubts = []
    floors = {} if noise_floor is None else noise_floor.views
    levels = {name: scores.get(MAIN.on_relic_key) for name, scores in floors.items()}
    low = {n: s for n, s in levels.items() if s is not None and s < LEAST_NOISE_FLOOR}
    if low:
        worst = min(low, key=lambda name: low[name])
        doubts.append(
            f"the noise floor of the view {worst} is {low[worst]:.2f}, below "
            f"{LEAST_NOISE_FLOOR:g}; raise inim.view_spp"
        )
    shares = {name: firefly_share(view) for name, view in truth.views.items()}
    if shares and max(shares.values()) > _MOST_FIREFLIES:
        worst = max(shares, key=lambda name: shares[name])
        doubts.append(
            f"fireflies: {shares[worst]:.0%} of the light in the view {worst} is brighter than "
            "white in one half of the samples only; remove mirrored paths of small lights"
        )
    unlit = [
        result.scores.unlit_fraction
        for result in results.values()
        if result.reference_output is not None and result.scores.unlit_fraction is not None
    ]
    if unlit and min(unlit) > _MOST_UNLIT:
        doubts.append(
            f"the capture misses surfaces that the display shows: {min(unlit):.0%} of the panel "
            "pixels with light stay black with every algorithm; turn the relic to the camera"
        )
    return doubts


def firefly_share(image: NoisyImage) -> float:
    """Share of an image's light above white that only one half of the samples has, 0 to 1.

    Such light comes from single samples. Scores clip it, and more samples spread it over its
    neighbours, so scores with more samples differ.
    """
    first, second = image.halves()
    low, high = np.minimum(first, second), np.maximum(first, second)
    excess = np.maximum(high - np.maximum(low, 1), 0).sum(dtype=np.float64) / 2
    light = float(np.maximum(image.image, 0).sum(dtype=np.float64))
    return float(excess) / light if light > 0 else 0.0
