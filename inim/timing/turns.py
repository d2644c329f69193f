"""Calls timed in turn, on a fixed number of threads."""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from inim.errors import UsageError

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
