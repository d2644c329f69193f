"""LDR-FLIP: the difference that an observer sees when flipping between two images."""

from __future__ import annotations

import math

import numpy as np

from inim.metrics.base import Metric, maps_of

# Viewing distance of 0.7 m from an ordinary monitor, 0.7 m wide with 3840 pixels.
_PIXELS_PER_DEGREE = 67.0
#: Reach of its filters in pixels: three sigma of the widest, the blue-yellow contrast sensitivity,
#: `sqrt(0.04 / (2 pi^2))` degrees.
FLIP_REACH = math.ceil(3 * math.sqrt(0.04 / 2) / math.pi * _PIXELS_PER_DEGREE)


def _error(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    import flip_evaluator

    # Floats: 8-bit input silently scores 0.
    local, _, _ = flip_evaluator.evaluate(
        reference,
        test,
        "LDR",
        inputsRGB=True,
        applyMagma=False,
        computeMeanError=False,
        parameters={"ppd": _PIXELS_PER_DEGREE},
    )
    return np.asarray(local, np.float32).reshape(reference.shape[:2])


metric = Metric(
    "flip",
    _error,
    better="lower",
    tolerance=0.005,  # as SSIM's
    reference="Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström and Fairchild, HPG 2020",
    has_relic_score=True,
    remaining_bias=1.2,  # it takes a root of small errors
    reach=FLIP_REACH,
    settings={"ppd": _PIXELS_PER_DEGREE},
)


def flip_map(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    """LDR-FLIP error of each pixel, (rows, columns) float32, 0 (equal) to 1.

    * `reference`, `test`, (rows, columns, 3) float32, linear RGB

    Source: Andersson et al., HPG 2020, at 67 pixels per degree.
    """
    return maps_of([metric], reference, test)[metric.key]


def flip(reference: np.ndarray, test: np.ndarray) -> float:
    """Mean of `flip_map`."""
    return metric.score(flip_map(reference, test))
