"""Comparable run times: methods in alternation, warm, in multiples of a reference kernel's time.

The state of a machine (other programs, clock rate, heat) changes from second to second. All methods
and the reference kernel alternate in every round, so it affects them equally, and their ratios stay
constant. A kernel time is one run of `inim.render.reference_kernel`.

Generators run on the display-ready picture, 8-bit sRGB with alpha as in a media player, and write
into an existing EIA. Generators of other packages are timed in the same way.
"""

from __future__ import annotations

import math
import os
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from inim.display import Display
from inim.generators import Generator, parse_algorithm, prepare
from inim.image.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.image.rgbd import RGBD, LayeredRGBD
from inim.system.errors import UsageError
from inim.system.process.garbage import no_garbage_collection
from inim.system.process.machine import busy_seconds

#: Name of the reference kernel among the timings.
REFERENCE_KERNEL = "reference kernel"


@dataclass(frozen=True)
class TimedMethod:
    """A prepared algorithm with its input and output.

    The input `rgbd` is display-ready. `out`, (rows, columns, 4) uint8, is the EIA after a run, and
    `prepare_s` the time to prepare, once per display and picture size. `is_own` is False for a
    generator of another package.
    """

    name: str
    generator: Generator
    rgbd: RGBD
    out: np.ndarray
    prepare_s: float
    is_own: bool = True

    def run(self) -> None:
        """Generate an EIA once, timed; raises `UsageError` if another package's generator fails."""
        self.generator.generate(self.rgbd, self.out)


def prepare_method(
    name: str, rgbd: RGBD, display: Display, mask: np.ndarray | None = None
) -> TimedMethod:
    """Prepare an algorithm, by its name with options, for a display-ready picture.

    `mask`, (rows, columns) bool, selects the panel pixels to generate; all if None. Raises
    `UsageError` for an unknown algorithm or option.
    """
    start = time.perf_counter()
    algorithm = parse_algorithm(name)
    generator = prepare(display, algorithm, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm, mask=mask)
    prepare_s = time.perf_counter() - start
    out = np.zeros((*display.eia_shape, 4), np.uint8)
    return TimedMethod(name, generator, rgbd, out, prepare_s, algorithm.own)


def time_methods(
    methods: Sequence[TimedMethod], rgbd: RGBD, display: Display, rounds: Rounds
) -> dict[str, Timing]:
    """Time all methods and the reference kernel (`REFERENCE_KERNEL`), by name.

    `rgbd` is the display-ready input of the reference kernel.
    """
    from inim.render.reference_kernel import ReferenceKernel

    calls = {REFERENCE_KERNEL: ReferenceKernel(rgbd.color, display, rgbd.pixel_mm).run}
    calls |= {method.name: method.run for method in methods}
    with threads(rounds.threads):
        return time_calls(calls, rounds)


def to_srgb_rgba(rgbd: RGBD) -> RGBD:
    """Convert a linear picture to 8-bit sRGB with alpha, transparent where it is empty."""
    rgba = _rgba(rgbd.color, rgbd.covered)
    if not isinstance(rgbd, LayeredRGBD):
        return RGBD(rgba, rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm)
    deeper = [replace(layer, color=_rgba(layer.color, layer.covered)) for layer in rgbd.deeper]
    return replace(rgbd, color=rgba, deeper=tuple(deeper))


def _rgba(color: np.ndarray, covered: np.ndarray) -> np.ndarray:
    rgba = np.zeros((*covered.shape, 4), np.uint8)
    rgba[..., :3] = srgb_to_uint8(srgb_from_linear(color))
    rgba[..., 3] = 255
    rgba[~covered] = 0
    return rgba


def linear_picture(rgba: np.ndarray) -> np.ndarray:
    """Convert a display-ready EIA to linear RGB, float32, on a dark panel."""
    linear = linear_from_srgb(rgba[..., :3].astype(np.float32) / 255)
    return np.where(rgba[..., 3:] > 0, linear, np.float32(0))


# A run above this many seconds is slow; nine of them would take too long.
_SLOW_S = 2.0
_RUNS_WHEN_SLOW = 3
# A run above this many seconds is repeated once.
_VERY_SLOW_S = 10.0
_RUNS_WHEN_VERY_SLOW = 2
# The thread pools of Dr.Jit and numba spin after their work, and the next call has fewer cores:
# 14 ms became 22 ms with pauses of 3 ms, and 18 ms with 10 ms. So wait until they sleep.
_SETTLE_S = 0.03
# After waking up, a pool's threads often share a core for several milliseconds until the system
# balances the load: 1 ms became 5 ms. So each call gets untimed runs first, equally long for all.
_LEAD_IN_S = 0.02
# Longer runs need no lead-in.
_LEAD_IN_BELOW_S = 0.2


@dataclass(frozen=True)
class Rounds:
    """Timed rounds, untimed ones before them (at least one of each), and threads (None: all).

    Raises `UsageError` for fewer than one run or warm-up.
    """

    runs: int = 9
    warmups: int = 2
    threads: int | None = None

    def __post_init__(self) -> None:
        for name in ("runs", "warmups"):
            if getattr(self, name) < 1:
                raise UsageError(f"--{name} {getattr(self, name)}: must be at least 1")


class OtherPrograms:
    """Context that measures the load by other programs.

    * `share`: processor time of other programs during the block, as a share of all processors; None
      if unavailable.
    """

    def __enter__(self) -> OtherPrograms:
        self.share: float | None = None
        self._start = time.perf_counter(), busy_seconds(), time.process_time()
        return self

    def __exit__(self, *_: object) -> None:
        start, all_before, own_before = self._start
        own, busy = time.process_time() - own_before, busy_seconds()
        if busy is not None and all_before is not None:
            available = (time.perf_counter() - start) * (os.cpu_count() or 1)
            self.share = min(max((busy - all_before - own) / available, 0.0), 1.0)


@dataclass(frozen=True)
class Timing:
    """Run times of a call: the cold first one, and warm runs in order.

    `slow` is True if the number of runs was reduced.
    """

    cold_s: float
    times_s: tuple[float, ...]
    slow: bool = False

    @property
    def median_s(self) -> float:
        """Median of the warm runs."""
        return statistics.median(self.times_s)

    @property
    def min_s(self) -> float:
        """Fastest warm run."""
        return min(self.times_s)

    @property
    def spread(self) -> float:
        """Half of the interquartile range, relative to the median."""
        if len(self.times_s) < 2:
            return 0.0
        low, _, high = statistics.quantiles(self.times_s, n=4, method="inclusive")
        return (high - low) / 2 / self.median_s

    def as_data(self) -> dict[str, Any]:
        """Return the fields of bench.json, in milliseconds."""
        return {
            "cold_s": self.cold_s,
            "median_ms": 1e3 * self.median_s,
            "min_ms": 1e3 * self.min_s,
            "spread": self.spread,
            "runs": len(self.times_s),
            "slow": self.slow,
            "times_ms": [1e3 * seconds for seconds in self.times_s],
        }


def time_calls(
    calls: Mapping[str, Callable[[], Any]],
    rounds: Rounds,
    clock: Callable[[], float] = time.perf_counter,
    pause: Callable[[float], None] = time.sleep,
) -> dict[str, Timing]:
    """Time all calls in alternation: a cold start, warm-ups, then the timed runs.

    No cold start counts. If a call takes more than two seconds, its first warm-up counts, and it
    has at most three runs; above ten seconds, two. Tests replace `clock` and `pause`.
    """

    def time_once(name: str, lead_in: bool = False) -> float:
        pause(_SETTLE_S)
        lead_start = clock()
        while lead_in:
            calls[name]()
            lead_in = clock() - lead_start < _LEAD_IN_S
        start = clock()
        calls[name]()
        return clock() - start

    # A garbage collection would slow down an arbitrary call.
    with no_garbage_collection():
        cold = {name: time_once(name) for name in calls}
        warm = {name: time_once(name) for name in calls}
        slow = {name for name in calls if warm[name] > _SLOW_S}
        for _ in range(rounds.warmups - 1):
            for name in (name for name in calls if name not in slow):
                time_once(name)
        times = {name: [warm[name]] if name in slow else [] for name in calls}
        for _ in range(rounds.runs):
            for name in calls:
                if len(times[name]) < _max_runs(warm[name], rounds.runs):
                    times[name].append(time_once(name, lead_in=warm[name] < _LEAD_IN_BELOW_S))
    return {name: Timing(cold[name], tuple(times[name]), name in slow) for name in calls}


def _max_runs(seconds: float, runs: int) -> int:
    if seconds > _VERY_SLOW_S:
        return min(runs, _RUNS_WHEN_VERY_SLOW)
    return min(runs, _RUNS_WHEN_SLOW) if seconds > _SLOW_S else runs


def ratios(timing: Timing, unit: Timing) -> dict[str, float]:
    """Ratios of two timings, of their medians and of their minima."""
    return {"ratio": timing.median_s / unit.median_s, "ratio_min": timing.min_s / unit.min_s}


# Share of the lowest and of the highest values that a trimmed mean leaves out: one of nine runs.
_TRIMMED = 0.2


def mean_ratio(
    timing: Timing, unit: Timing | None = None, level: float = 0.05
) -> tuple[float, tuple[float, float]]:
    """Trimmed geometric mean of the ratios of two timings, round by round, and its interval.

    Rounds alternate, so a disturbance of the machine cancels in their ratio. Without a `unit`, the
    mean time in seconds. The interval has the confidence ``1 - level``; of a single run, its ends
    are 0 and infinity. Source: Yuen, Biometrika 61, 1974.
    """
    from scipy.special import stdtrit

    units = (1.0,) * len(timing.times_s) if unit is None else unit.times_s
    logs = np.sort([math.log(t / u) for t, u in zip(timing.times_s, units, strict=False)])
    cut = int(_TRIMMED * len(logs))
    central = logs[cut : len(logs) - cut]
    mean, half = float(central.mean()), math.inf
    if len(central) > 1:
        winsorised = np.clip(logs, central[0], central[-1])
        squares = np.square(winsorised - winsorised.mean()).sum()
        freedom = len(central) - 1
        half = float(stdtrit(freedom, 1 - level / 2) * np.sqrt(squares / freedom / len(central)))
    with np.errstate(over="ignore"):
        low, high = np.exp([mean - half, mean + half])
    return math.exp(mean), (float(low), float(high))


def thread_count(requested: int | None) -> int:
    """Number of threads: as requested, or all that this process may use.

    Raises `UsageError` for more.
    """
    from inim.system.backend.kernels import MOST_THREADS

    if requested is not None and not 1 <= requested <= MOST_THREADS:
        raise UsageError(f"--threads {requested}: this machine has 1 to {MOST_THREADS}")
    return requested or MOST_THREADS


@contextmanager
def threads(count: int | None) -> Iterator[int]:
    """Run generators and the reference kernel on a number of threads (`thread_count`)."""
    from inim.render.reference_kernel import drjit_threads
    from inim.system.backend.kernels import limited_threads

    count = thread_count(count)
    with limited_threads(count), drjit_threads(count):
        yield count
