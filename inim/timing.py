"""Times that can be compared: methods in turn, warm, in multiples of a reference kernel.

What else a machine does (other programs, clock rates, heat) changes from second to second. Run in
turn, round after round, all methods and the reference kernel suffer it alike, and their ratios
stay. A ratio's unit is the yardstick: one run of `inim.render.reference_kernel`.

Generators are timed on the display-ready picture, 8-bit sRGB with alpha as a player has it, and
write their EIA into place. A method of another package is timed like any other.
"""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from inim.display import Display
from inim.errors import UsageError
from inim.generators import (
    Generator,
    foreign_errors,
    is_own,
    parse_algorithm,
    prepare,
)
from inim.generators.base import check_array
from inim.image.color import linear_from_srgb, srgb_from_linear, srgb_to_uint8
from inim.image.rgbd import RGBD, LayeredRGBD

#: The reference kernel's name among the timings.
YARDSTICK = "yardstick"


@dataclass(frozen=True)
class TimedMethod:
    """A prepared algorithm with the picture it reads and the place it writes to.

    Attributes
    ----------
    name : str
        With its options, as on the command line.
    generator : Generator
    rgbd : RGBD
        Display-ready.
    out : (rows, columns, 4) uint8
        The EIA, after a run.
    prepare_s : float
        Seconds that preparing took, once per display and picture size.
    is_own : bool
        Whether the generator is the project's, not another package's.
    """

    name: str
    generator: Generator
    rgbd: RGBD
    out: np.ndarray
    prepare_s: float
    is_own: bool = True

    def run(self) -> None:
        """Generate once: what is timed.

        Raises
        ------
        UsageError
            In place of anything that another package's generator raises.
        """
        if self.is_own:
            self.generator.generate(self.rgbd, self.out)
            return
        with foreign_errors(self.name):
            eia = self.generator.generate(self.rgbd, self.out)
            if eia is not self.out:  # it wrote elsewhere: the EIA still has to get to its place
                check_array(eia, self.out.shape, str(self.out.dtype))
                self.out[...] = eia


def prepare_method(
    name: str, rgbd: RGBD, display: Display, mask: np.ndarray | None = None
) -> TimedMethod:
    """Prepare one algorithm for a display-ready picture.

    Parameters
    ----------
    name : str
        With its options.
    rgbd : RGBD
    display : Display
    mask : (rows, columns) bool, optional
        Panel pixels to make; all if None.

    Raises
    ------
    UsageError
        Unknown algorithm or option.
    """
    start = time.perf_counter()
    with foreign_errors(name):
        made = prepare(display, name, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm, mask=mask)
    taken = time.perf_counter() - start
    out = np.zeros((*display.eia_shape, 4), np.uint8)  # written once: its pages are there
    return TimedMethod(name, made, rgbd, out, taken, is_own(parse_algorithm(name)[0]))


def time_methods(
    methods: Sequence[TimedMethod], rgbd: RGBD, display: Display, rounds: Rounds
) -> dict[str, Timing]:
    """Times of all methods and of the reference kernel (`YARDSTICK`), by name, taken in turn.

    Parameters
    ----------
    methods : sequence of TimedMethod
    rgbd : RGBD
        Display-ready: what the reference kernel gathers from.
    display : Display
    rounds : Rounds
    """
    from inim.render.reference_kernel import ReferenceKernel

    calls = {YARDSTICK: ReferenceKernel(rgbd.color, display, rgbd.pixel_mm).run}
    calls |= {method.name: method.run for method in methods}
    with threads(rounds.threads):
        return in_turn(calls, rounds)


def display_ready(rgbd: RGBD) -> RGBD:
    """A linear picture as a player has it: 8-bit sRGB with alpha, clear where nothing is."""
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
    """A display-ready EIA as a dark panel shows it: linear RGB, float32."""
    linear = linear_from_srgb(rgba[..., :3].astype(np.float32) / 255)
    return np.where(rgba[..., 3:] > 0, linear, np.float32(0))


# A run above this many seconds is slow: nine of them would cost more than they tell.
_SLOW_S = 2.0
_RUNS_WHEN_SLOW = 3
# Above this, one more run would only try the reader's patience.
_VERY_SLOW_S = 10.0
# The thread pools of Dr.Jit and numba wait busily after their work, and the next in turn has fewer
# cores: 14 ms became 22 ms with pauses of 3 ms, still 18 ms with 10 ms. So let them fall asleep.
_SETTLE_S = 0.03
# Just woken, a pool's threads often share a core until the system balances its load, some
# milliseconds later: 1 ms became 5 ms. So each gets uncounted runs first, the same time for all.
_LEAD_IN_S = 0.02
# A longer run is past that by itself.
_LEAD_IN_BELOW_S = 0.2


@dataclass(frozen=True)
class Rounds:
    """How often to run, and on how many threads.

    Attributes
    ----------
    runs, warmups : int
        Timed rounds, and untimed ones before them; at least one of each.
    threads : int, optional
        All there are if None.

    Raises
    ------
    UsageError
        Fewer than one run or warm-up.
    """

    runs: int = 9
    warmups: int = 2
    threads: int | None = None

    def __post_init__(self) -> None:
        for name in ("runs", "warmups"):
            if getattr(self, name) < 1:
                raise UsageError(f"--{name} {getattr(self, name)}: at least 1")


@dataclass(frozen=True)
class Timing:
    """The runs of one call, seconds.

    Attributes
    ----------
    cold_s : float
        The first call, with all compiling and loading.
    times_s : tuple of float
        The warm runs, in order.
    slow : bool
        Whether it had fewer runs than the others because it is slow.
    """

    cold_s: float
    times_s: tuple[float, ...]
    slow: bool = False

    @property
    def median_s(self) -> float:
        """Middle of the warm runs."""
        return statistics.median(self.times_s)

    @property
    def min_s(self) -> float:
        """Fastest warm run."""
        return min(self.times_s)

    @property
    def spread(self) -> float:
        """Half of the distance between the quartiles, as a share of the median."""
        if len(self.times_s) < 2:
            return 0.0
        low, _, high = statistics.quantiles(self.times_s, n=4, method="inclusive")
        return (high - low) / 2 / self.median_s

    def as_data(self) -> dict[str, Any]:
        """Under the names of bench.json, milliseconds."""
        return {
            "cold_s": self.cold_s,
            "median_ms": 1e3 * self.median_s,
            "min_ms": 1e3 * self.min_s,
            "spread": self.spread,
            "runs": len(self.times_s),
            "slow": self.slow,
        }


def in_turn(
    calls: Mapping[str, Callable[[], Any]],
    rounds: Rounds,
    clock: Callable[[], float] = time.perf_counter,
    pause: Callable[[float], None] = time.sleep,
) -> dict[str, Timing]:
    """Time each call, all in turn in every round: a cold start, warm-ups, then the timed runs.

    Parameters
    ----------
    calls : mapping of str to callable
        In the order in which they take turns.
    rounds : Rounds
        A call that takes more than two seconds has its first warm-up counted and at most three
        runs; one of more than ten seconds, one.
    clock, pause : callable
        Stand-ins for tests.
    """

    def timed(name: str, lead_in: bool = False) -> float:
        pause(_SETTLE_S)
        woken = clock()
        while lead_in:
            calls[name]()
            lead_in = clock() - woken < _LEAD_IN_S
        start = clock()
        calls[name]()
        return clock() - start

    collecting = gc.isenabled()
    gc.disable()  # a collection would land on whoever happens to be at work
    try:
        cold = {name: timed(name) for name in calls}
        warm = {name: timed(name) for name in calls}
        slow = {name for name in calls if warm[name] > _SLOW_S}
        for _ in range(rounds.warmups - 1):
            for name in (name for name in calls if name not in slow):
                timed(name)
        times = {name: [warm[name]] if name in slow else [] for name in calls}
        for _ in range(rounds.runs):
            for name in calls:
                if len(times[name]) < _most_runs(warm[name], rounds.runs):
                    times[name].append(timed(name, lead_in=warm[name] < _LEAD_IN_BELOW_S))
    finally:
        if collecting:
            gc.enable()
    return {name: Timing(cold[name], tuple(times[name]), name in slow) for name in calls}


def _most_runs(seconds: float, runs: int) -> int:
    if seconds > _VERY_SLOW_S:
        return 1
    return min(runs, _RUNS_WHEN_SLOW) if seconds > _SLOW_S else runs


def ratios(timing: Timing, unit: Timing) -> dict[str, float]:
    """A time in multiples of another: median over median, minimum over minimum."""
    return {
        "ratio": timing.median_s / unit.median_s,
        "ratio_min": timing.min_s / unit.min_s,
    }


def most_threads() -> int:
    """Threads this process may use at once."""
    import numba

    return int(numba.config.NUMBA_NUM_THREADS)


@contextmanager
def threads(count: int | None) -> Iterator[int]:
    """Generators and the reference kernel on the same number of threads; all there are if None.

    Raises
    ------
    UsageError
        More than there are.
    """
    import numba

    from inim.render.reference_kernel import drjit_threads

    most = most_threads()
    wanted = most if count is None else count
    if not 1 <= wanted <= most:
        raise UsageError(f"--threads {wanted}: this machine has 1 to {most}")
    before = numba.get_num_threads()
    numba.set_num_threads(wanted)
    try:
        with drjit_threads(wanted):
            yield wanted
    finally:
        numba.set_num_threads(before)
