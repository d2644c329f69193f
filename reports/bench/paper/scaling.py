"""How time grows: with the display's pixels, with the picture's, and what memory it takes."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from inim.bench.evaluate import method_data
from inim.display import Display
from inim.errors import WorkerError
from inim.timing import REFERENCE_KERNEL, Rounds, prepare_method, time_methods
from reports.bench.study import picture_of, square_display

#: Lenses along a side, 17 pixels each: up to 4080 x 4080, the largest array measured in print.
LENS_COUNTS = (16, 24, 32, 48, 64, 96, 128, 176, 240)
#: Picture pixels per lens pitch, on `_FIXED_LENSES` lenses along a side.
PIXELS_PER_PITCH = (1, 2, 3, 4, 5, 6, 7, 8)
_FIXED_LENSES = 64
_FIXED_PIXELS_PER_PITCH = 2
_ALGORITHM = "template"
# Peak memory above that of the imports that an array of 4080 x 4080 may take.
_MOST_ABOVE_IMPORT = 2**30
# Time a child may take to generate once.
_PATIENCE_S = 300
_ROOT = Path(__file__).parents[3]


def bench_scaling(
    rounds: Rounds,
    listener: Any,
    lens_counts: Sequence[int] = LENS_COUNTS,
    pixels_per_pitch: Sequence[int] = PIXELS_PER_PITCH,
    fixed_lenses: int = _FIXED_LENSES,
) -> dict[str, Any]:
    """Times of `template` and the reference kernel over both sizes; peak memory at the largest."""
    by_display = []
    for lenses in lens_counts:
        listener.stage(f"{lenses} x {lenses} lenses")
        by_display.append(_point(square_display(lenses), _FIXED_PIXELS_PER_PITCH, rounds))
        listener.line(_in_words(by_display[-1]))
    by_scene = []
    for count in pixels_per_pitch:
        listener.stage(f"{count} picture pixels per pitch")
        by_scene.append(_point(square_display(fixed_lenses), count, rounds))
        listener.line(_in_words(by_scene[-1]))
    listener.stage("memory")
    return {
        "algorithm": _ALGORITHM,
        "display": by_display,
        "scene": by_scene,
        "growth": {
            # The larger half: on small displays, starting the threads takes longer than the work.
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


def _in_words(point: Mapping[str, Any]) -> str:
    return (
        f"{point['name']}  {point['display_pixels']:9} display pixels  {point['scene_pixels']:7} "
        f"scene pixels  {point['median_ms']:7.2f} ms  {point['ratio']:6.2f} yardsticks"
    )


@dataclass(frozen=True)
class PowerLaw:
    """By which power time grows with a size: 1 is linear, 0 flat.

    Attributes
    ----------
    power : float
    error : float
        How far the power may be off: its standard error, from how the points scatter about the
        line, and besides what rounding can do to it. Two points do not scatter.
    """

    power: float
    error: float

    def is_below(self, other: PowerLaw) -> bool:
        """Whether this power is the smaller one by more than both errors; else they are equal."""
        return self.power + self.error < other.power - other.error


def power_law(points: Sequence[Mapping[str, Any]], size: str) -> PowerLaw | None:
    """Fit a power law by least squares of logarithms; None for fewer than two sizes.

    By the fastest runs: sizes are not measured in turn, so the medians of two sizes need not have
    met the same load.

    With ``x = log(size)`` and ``y = log(time)`` about their means, the power is
    ``b = sum(x y) / sum(x x)`` and its standard error ``sqrt(sum((y - b x)^2) / (n - 2) / sum(x
    x))``. A size, a time and the logarithm of either are within one unit in the last place, so
    each x and y is within ``d = 2 eps (1 + the largest logarithm)``, its mean included; the sums
    are exact (`math.fsum`). To first order b is then within
    ``d (sum|x| + sum|y| + 2 |b| sum|x|) / sum(x x) + 4 eps |b|``.
    """
    sizes = [math.log(p[size]) for p in points]
    if len(set(sizes)) < 2:
        return None
    times = [math.log(p["min_ms"]) for p in points]
    x, y = ([v - math.fsum(all_) / len(all_) for v in all_] for all_ in (sizes, times))
    squares = math.fsum(v * v for v in x)
    power = math.fsum(a * b for a, b in zip(x, y, strict=True)) / squares
    eps = sys.float_info.epsilon
    each = 2 * eps * (1 + max(map(abs, sizes + times)))
    wide, high = (math.fsum(map(abs, v)) for v in (x, y))
    error = each * (wide + high + 2 * abs(power) * wide) / squares + 4 * eps * abs(power)
    if len(points) > 2:
        off = math.fsum((b - power * a) ** 2 for a, b in zip(x, y, strict=True))
        error += math.sqrt(off / (len(points) - 2) / squares)
    return PowerLaw(power, error)


def growth(points: Sequence[Mapping[str, Any]], size: str) -> float | None:
    """The power of `power_law`."""
    law = power_law(points, size)
    return None if law is None else law.power


def peak_memory(lenses: int) -> dict[str, Any]:
    """Peak memory of a fresh process that makes one EIA and nothing else, bytes."""
    words = [sys.executable, "-m", "reports.bench.paper.memory", str(lenses)]
    ended = subprocess.run(
        words,
        cwd=_ROOT,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=_PATIENCE_S,
        check=False,
    )
    try:
        found: dict[str, Any] = json.loads(ended.stdout)
    except ValueError:
        raise WorkerError(
            f"the process that measures memory ended with code {ended.returncode} at "
            f"{lenses} x {lenses} lenses"
        ) from None
    return {**found, "limit_bytes": _MOST_ABOVE_IMPORT}
