"""Timing that can be compared: everyone in turn, warm, medians and minima of the same rounds.

What a machine does besides (other programs, clock rates, heat) changes from second to second. Run
in turn, round after round, all contenders and the yardstick suffer it alike, and their ratios stay.
"""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from inim.errors import UsageError

__all__ = ["Rounds", "Timing", "in_turn", "ratios"]

# A run above this many seconds is slow: nine of them would cost more than they tell.
_SLOW_S = 2.0
_RUNS_WHEN_SLOW = 3
# Above this, one more run would only try the reader's patience.
_VERY_SLOW_S = 10.0
# The thread pools of Dr.Jit and numba wait busily after their work, and the next in turn has fewer
# cores: 14 ms became 22 ms with pauses of 3 ms, still 18 ms with 10 ms. So let them fall asleep.
_SETTLE_S = 0.03
# Just woken, a pool's threads often share a core until the system's next look at the load, some
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
        Timed rounds, and untimed ones before them; one of each at least.
    threads : int, optional
        All there are if None.
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
    """The runs of one contender, seconds.

    Attributes
    ----------
    cold_s : float
        The first call, with all compiling and loading.
    times_s : tuple of float
        The warm runs, in order.
    slow : bool
        Whether it was run fewer times than asked for because it is slow.
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
    interpreted: Collection[str] = (),
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
    interpreted : collection of str
        Those that compile nothing: their cold start serves as the first warm-up too.
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
        warm = {name: cold[name] if name in interpreted else timed(name) for name in calls}
        slow = {name for name in calls if warm[name] > _SLOW_S}
        for _ in range(rounds.warmups - 1):
            for name in (name for name in calls if name not in slow):
                timed(name)
        times = {name: [warm[name]] if name in slow else [] for name in calls}
        for _ in range(rounds.runs):
            for name in calls:
                if len(times[name]) < _wanted(warm[name], rounds.runs):
                    times[name].append(timed(name, lead_in=warm[name] < _LEAD_IN_BELOW_S))
    finally:
        if collecting:
            gc.enable()
    return {name: Timing(cold[name], tuple(times[name]), name in slow) for name in calls}


def _wanted(seconds: float, runs: int) -> int:
    if seconds > _VERY_SLOW_S:
        return 1
    return min(runs, _RUNS_WHEN_SLOW) if seconds > _SLOW_S else runs


def ratios(timing: Timing, yardstick: Timing) -> dict[str, float]:
    """A contender's time in yardsticks: median over median, minimum over minimum."""
    return {
        "ratio": timing.median_s / yardstick.median_s,
        "ratio_min": timing.min_s / yardstick.min_s,
    }


def pareto(points: Sequence[tuple[float, float | None]]) -> list[bool]:
    """Which points (time, error) no other beats: none is as good in both and better in one.

    A point without an error (None) is never on the front.
    """

    def beaten(mine: tuple[float, float]) -> bool:
        return any(
            other[1] is not None and other[0] <= mine[0] and other[1] <= mine[1] and other != mine
            for other in points
        )

    return [error is not None and not beaten((t, error)) for t, error in points]
