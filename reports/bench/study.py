"""Functions shared by the benchmark studies: command line, conditions, test pictures."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from inim.apps.bench.page import milliseconds
from inim.display import Display
from inim.image.rgbd import RGBD
from inim.pipeline.timing import REFERENCE_KERNEL, Rounds, TimedMethod, Timing, ratios
from inim.render.scene_files.two_spheres import two_spheres
from inim.report.labels import MISSING, number, per_cent
from inim.system.errors import EXIT_CHECK_FAILED, EXIT_PASSED, WorkerError
from reports.bench.process import run_measured


def add_rounds(parser: argparse.ArgumentParser) -> None:
    """Add the numbers of runs and threads to the arguments of a study."""
    add = parser.add_argument
    add("--runs", type=int, default=Rounds.runs, metavar="N", help="timed runs (9)")
    add("--warmups", type=int, default=Rounds.warmups, metavar="N", help="runs before (2)")
    add("--threads", type=int, metavar="T", help="threads to time with (all)")


def rounds_of(args: argparse.Namespace) -> dict[str, int | None]:
    """Options of `Rounds`."""
    return {name: getattr(args, name) for name in ("runs", "warmups", "threads")}


# Times are doubtful if other processes used more than this share of the cores before the start.
_BUSY = 0.25


def doubts() -> list[str]:
    """Warn if other processes are busy."""
    load, cores = os.getloadavg()[0], os.cpu_count() or 1
    if load <= _BUSY * cores:
        return []
    return [f"the machine was busy: load average {load:.2f} on {cores} cores at the start"]


def run_validation(words: Sequence[str], variables: Mapping[str, str], name: str) -> dict[str, Any]:
    """Run a Python module that validates a scene; return the results of `run_measured`.

    `words` follow ``python -m``; `name` is that of the run in error messages. Raises `WorkerError`
    if the run is incomplete. A check may fail, on a small display.
    """
    run = run_measured([sys.executable, "-m", *words], variables)
    if run["code"] not in (EXIT_PASSED, EXIT_CHECK_FAILED):
        raise WorkerError(f"{name}: exit code {run['code']}: {run['message']}")
    return run


def square_display(lenses: int, pixels: int = 17, **changes: Any) -> Display:
    """Display of `lenses` by `lenses` of the paper's lenses, with `pixels` by `pixels` each."""
    display = Display(
        pitch_mm=1.0,
        focal_length_mm=3.0,
        gap_mm=3.3,
        pixel_pitch_mm=1.0 / pixels,
        lens_columns=lenses,
        lens_rows=lenses,
        name=f"{lenses} x {lenses} lenses",
    )
    return display.replace(**changes) if changes else display


def picture_of(display: Display, pixels_per_pitch: int) -> RGBD:
    """Display-ready picture of the two spheres with `pixels_per_pitch` pixels per lens pitch."""
    shape = display.capture_shape(pixels_per_pitch)
    return two_spheres(display, shape, display.pitch_mm / pixels_per_pitch)


#: Parts of a validation, with the beginnings of the stages in report.json that they sum up.
RUN_PARTS = {
    "rendering": ("capture ", "ground-truth "),
    "reconstruction": ("reconstruct ",),
    "generating": ("generate ",),
    "scoring": ("score",),
}


def run_parts(timings: Mapping[str, float]) -> dict[str, float]:
    """Seconds of the parts of a validation, from `timings` of its report.json."""
    return {
        part: sum(seconds for name, seconds in timings.items() if name.startswith(stages))
        for part, stages in RUN_PARTS.items()
    }


def method_data(
    method: TimedMethod, times: Mapping[str, Timing], display: Display
) -> dict[str, Any]:
    """Times of a method, under the names of bench.json."""
    timing = times[method.name]
    pixels = display.eia_shape[0] * display.eia_shape[1]
    return {
        "name": method.name,
        "prepare_s": method.prepare_s,
        **timing.as_data(),
        "mpx_per_s": pixels / 1e6 / timing.median_s,
        **ratios(timing, times[REFERENCE_KERNEL]),
    }


def times(value: float | None) -> str:
    """A ratio."""
    return MISSING if value is None else f"{number(value, 2 if value < 100 else 0)} ×"


def _rate(value: float | None) -> str:
    return MISSING if value is None else number(value, 1 if value < 100 else 0)


#: Columns with the times of an algorithm, of `method_data`.
TIME_COLUMNS: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "ms per EIA": lambda timing: milliseconds(timing["median_ms"]),
    "fastest": lambda timing: milliseconds(timing["min_ms"]),
    "spread": lambda timing: f"± {per_cent(timing['spread'], 1)}",
    "runs": lambda timing: str(timing["runs"]),
    "Mpx/s": lambda timing: _rate(timing["mpx_per_s"]),
    "kernel times": lambda timing: times(timing["ratio"]),
    "by fastest": lambda timing: times(timing["ratio_min"]),
}
