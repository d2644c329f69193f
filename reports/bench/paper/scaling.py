"""Growth of time with the numbers of display pixels and picture pixels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import linregress

from inim.display import Display
from inim.pipeline.timing import REFERENCE_KERNEL, Rounds, prepare_method, time_methods
from reports.bench.study import method_data, picture_of, square_display

#: Lenses along a side, 17 pixels each: up to 4080 x 4080, the largest published array.
LENS_COUNTS = (16, 24, 32, 48, 64, 96, 128, 176, 240)
#: Picture pixels per lens pitch, on `_FIXED_LENSES` lenses along a side.
PIXELS_PER_PITCH = (1, 2, 3, 4, 5, 6, 7, 8)
_FIXED_LENSES = 64
_FIXED_PIXELS_PER_PITCH = 2
_ALGORITHM = "template:samples=1:colour=nearest"


def bench_scaling(
    rounds: Rounds,
    lens_counts: Sequence[int] = LENS_COUNTS,
    pixels_per_pitch: Sequence[int] = PIXELS_PER_PITCH,
    fixed_lenses: int = _FIXED_LENSES,
) -> dict[str, Any]:
    """Time `template` with one ray and the reference kernel over both sizes."""
    by_display = [_point(square_display(n), _FIXED_PIXELS_PER_PITCH, rounds) for n in lens_counts]
    by_scene = [_point(square_display(fixed_lenses), n, rounds) for n in pixels_per_pitch]
    larger = max(2, (len(by_display) + 1) // 2)
    return {
        "algorithm": _ALGORITHM,
        "display": by_display,
        "scene": by_scene,
        "growth": {
            # Only the larger half: on small displays the threads' start dominates.
            "display_pixels": _growth(by_display[-larger:], "display_pixels"),
            "scene_pixels": _growth(by_scene, "scene_pixels"),
        },
    }


def _growth(points: Sequence[Mapping[str, Any]], size: str) -> float:
    """Exponent of the fastest runs: the load may differ between the medians of two sizes."""
    return power_law([p[size] for p in points], [p["min_ms"] for p in points])


def _point(display: Display, pixels_per_pitch: int, rounds: Rounds) -> dict[str, Any]:
    rgbd = picture_of(display, pixels_per_pitch)
    method = prepare_method(_ALGORITHM, rgbd, display)
    times = time_methods([method], rgbd, display, rounds)
    return {
        "lenses": display.lens_columns,
        "pixels_per_pitch": pixels_per_pitch,
        "display_pixels": display.eia_shape[0] * display.eia_shape[1],
        "scene_pixels": rgbd.shape[0] * rgbd.shape[1],
        "yardstick": times[REFERENCE_KERNEL].as_data(),
        **method_data(method, times, display),
    }


def power_law(sizes: ArrayLike, times: ArrayLike) -> float:
    """Fit the exponent of the growth of time with a size, by least squares of logarithms."""
    return float(linregress(np.log(sizes), np.log(times)).slope)
