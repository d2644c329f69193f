"""Growth of time with the numbers of display pixels and picture pixels, and peak memory."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from inim.apps.bench.evaluate import method_data
from inim.display import Display
from inim.pipeline.timing import REFERENCE_KERNEL, Rounds, prepare_method, time_methods
from inim.system.errors import WorkerError
from reports.bench.study import picture_of, square_display

#: Lenses along a side, 17 pixels each: up to 4080 x 4080, the largest published array.
LENS_COUNTS = (16, 24, 32, 48, 64, 96, 128, 176, 240)
#: Picture pixels per lens pitch, on `_FIXED_LENSES` lenses along a side.
PIXELS_PER_PITCH = (1, 2, 3, 4, 5, 6, 7, 8)
_FIXED_LENSES = 64
_FIXED_PIXELS_PER_PITCH = 2
_ALGORITHM = "template"
# Largest accepted peak memory in addition to the imports, for an array of 4080 x 4080.
_MEMORY_LIMIT = 2**30
# Time limit of the child process.
_TIMEOUT_S = 300
_ROOT = Path(__file__).parents[3]


def bench_scaling(
    rounds: Rounds,
    lens_counts: Sequence[int] = LENS_COUNTS,
    pixels_per_pitch: Sequence[int] = PIXELS_PER_PITCH,
    fixed_lenses: int = _FIXED_LENSES,
) -> dict[str, Any]:
    """Time `template` and the reference kernel over both sizes; measure the largest's memory."""
    by_display = [_point(square_display(n), _FIXED_PIXELS_PER_PITCH, rounds) for n in lens_counts]
    by_scene = [_point(square_display(fixed_lenses), n, rounds) for n in pixels_per_pitch]
    return {
        "algorithm": _ALGORITHM,
        "display": by_display,
        "scene": by_scene,
        "growth": {
            # Only the larger half: on small displays the threads' start dominates.
            "display_pixels": growth(by_display[len(by_display) // 2 :], "display_pixels"),
            "scene_pixels": growth(by_scene, "scene_pixels"),
        },
        "memory": peak_memory(max(lens_counts)),
    }


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


@dataclass(frozen=True)
class PowerLaw:
    """Exponent of the growth of time with a size: 1 is linear, 0 is constant.

    Attributes
    ----------
    power : float
    error : float
        Error of the power: its standard error from the points' scatter about the line, plus a bound
        of the rounding error. Two points have no scatter.
    """

    power: float
    error: float

    def is_below(self, other: PowerLaw) -> bool:
        """True if this power is smaller by more than the sum of both errors."""
        return self.power + self.error < other.power - other.error


def power_law(points: Sequence[Mapping[str, Any]], size: str) -> PowerLaw | None:
    """Fit a power law by least squares of logarithms; None for fewer than two sizes.

    The fit uses the fastest runs: sizes are measured one after another, so that the load may differ
    between the medians of two sizes.

    With ``x = log(size)`` and ``y = log(time)`` about their means, the power is
    ``b = sum(x y) / sum(x x)`` and its standard error ``sqrt(sum((y - b x)^2) / (n - 2) / sum(x
    x))``. Sizes, times and their logarithms have an error of one unit in the last place. Each x and
    y, including its mean, therefore has an error of at most ``d = 2 eps (1 + the largest
    logarithm)``. The sums are exact (`math.fsum`). To first order, the error of b is at most
    ``d (sum|x| + sum|y| + 2 |b| sum|x|) / sum(x x) + 4 eps |b|``.
    """
    sizes = [math.log(p[size]) for p in points]
    if len(set(sizes)) < 2:
        return None
    times = [math.log(p["min_ms"]) for p in points]
    x, y = ([v - math.fsum(values) / len(values) for v in values] for values in (sizes, times))
    squares = math.fsum(v * v for v in x)
    power = math.fsum(a * b for a, b in zip(x, y, strict=True)) / squares
    eps = sys.float_info.epsilon
    value_error = 2 * eps * (1 + max(map(abs, sizes + times)))
    sum_x, sum_y = (math.fsum(map(abs, v)) for v in (x, y))
    error = value_error * (sum_x + sum_y + 2 * abs(power) * sum_x) / squares + 4 * eps * abs(power)
    if len(points) > 2:
        residual = math.fsum((b - power * a) ** 2 for a, b in zip(x, y, strict=True))
        error += math.sqrt(residual / (len(points) - 2) / squares)
    return PowerLaw(power, error)


def growth(points: Sequence[Mapping[str, Any]], size: str) -> float | None:
    """Power of `power_law`; None for fewer than two sizes."""
    law = power_law(points, size)
    return None if law is None else law.power


def peak_memory(lenses: int) -> dict[str, Any]:
    """Peak memory of a new process that generates one EIA [bytes]."""
    command = [sys.executable, "-m", "reports.bench.paper.memory", str(lenses)]
    ended = subprocess.run(
        command,
        cwd=_ROOT,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=_TIMEOUT_S,
        check=False,
    )
    try:
        memory: dict[str, Any] = json.loads(ended.stdout)
    except ValueError:
        raise WorkerError(
            f"the process that measures memory ended with code {ended.returncode} at "
            f"{lenses} x {lenses} lenses"
        ) from None
    return {**memory, "limit_bytes": _MEMORY_LIMIT}
