"""Growth of time with the numbers of display pixels and picture pixels, and peak memory."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from scipy.stats import linregress

from inim.display import Display
from inim.pipeline.timing import REFERENCE_KERNEL, Rounds, prepare_method, time_methods
from inim.system.errors import WorkerError
from reports.bench.process import run_measured
from reports.bench.study import method_data, picture_of, square_display

#: Lenses along a side, 17 pixels each: up to 4080 x 4080, the largest published array.
LENS_COUNTS = (16, 24, 32, 48, 64, 96, 128, 176, 240)
#: Picture pixels per lens pitch, on `_FIXED_LENSES` lenses along a side.
PIXELS_PER_PITCH = (1, 2, 3, 4, 5, 6, 7, 8)
_FIXED_LENSES = 64
_FIXED_PIXELS_PER_PITCH = 2
_ALGORITHM = "template"
# Largest accepted peak memory in addition to the imports, for an array of 4080 x 4080.
_MEMORY_LIMIT = 2**30


def bench_scaling(
    rounds: Rounds,
    lens_counts: Sequence[int] = LENS_COUNTS,
    pixels_per_pitch: Sequence[int] = PIXELS_PER_PITCH,
    fixed_lenses: int = _FIXED_LENSES,
) -> dict[str, Any]:
    """Time `template` and the reference kernel over both sizes; measure the largest's memory."""
    by_display = [_point(square_display(n), _FIXED_PIXELS_PER_PITCH, rounds) for n in lens_counts]
    by_scene = [_point(square_display(fixed_lenses), n, rounds) for n in pixels_per_pitch]
    larger = max(2, (len(by_display) + 1) // 2)
    return {
        "algorithm": _ALGORITHM,
        "display": by_display,
        "scene": by_scene,
        "growth": {
            # Only the larger half: on small displays the threads' start dominates.
            "display_pixels": power_law(by_display[-larger:], "display_pixels").power,
            "scene_pixels": power_law(by_scene, "scene_pixels").power,
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


# Bound of the rounding errors of a power, from those of the logarithms of sizes and times.
_ROUNDING = 1e-12


class PowerLaw(NamedTuple):
    """Exponent of the growth of time with a size: 1 is linear, 0 is constant.

    `error` is the standard error of `power`, from the points' scatter about the line. Two points
    have no scatter.
    """

    power: float
    error: float

    def is_below(self, other: PowerLaw) -> bool:
        """True if this power is smaller by more than the sum of both errors."""
        return self.power + self.error < other.power - other.error


def power_law(points: Sequence[Mapping[str, Any]], size: str) -> PowerLaw:
    """Fit a power law to two or more sizes by least squares of logarithms.

    The fit uses the fastest runs: sizes are measured one after another, so that the load may differ
    between the medians of two sizes.
    """
    sizes, times = ([math.log(point[key]) for point in points] for key in (size, "min_ms"))
    line = linregress(sizes, times)
    return PowerLaw(float(line.slope), float(line.stderr) + _ROUNDING)


def peak_memory(lenses: int) -> dict[str, Any]:
    """Peak memory of a new process that generates one EIA, and of one that only imports [bytes].

    The difference includes the compilation or loading of the kernels, the picture, the prepared
    tables and the EIA.
    """
    peaks = []
    for count in (0, lenses):
        run = run_measured([sys.executable, "-m", __name__, str(count)], os.environ)
        if run["code"]:
            raise WorkerError(f"memory of {count} x {count} lenses: {run['message']}")
        peaks.append(run["peak_bytes"])
    return {
        "lenses": lenses,
        "imported_bytes": peaks[0],
        "peak_bytes": peaks[1],
        "above_import_bytes": peaks[1] - peaks[0],
        "eia_bytes": 4 * math.prod(square_display(lenses).eia_shape),
        "limit_bytes": _MEMORY_LIMIT,
    }


def _generate(lenses: int) -> None:
    """Generate one EIA, in the process whose memory is measured."""
    from inim.generators.raycast import strips  # noqa: F401

    if lenses:
        display = square_display(lenses)
        rgbd = picture_of(display, _FIXED_PIXELS_PER_PITCH)
        prepare_method(_ALGORITHM, rgbd, display).run()


if __name__ == "__main__":
    _generate(int(sys.argv[1]))
