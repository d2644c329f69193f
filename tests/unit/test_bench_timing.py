"""The bench's arithmetic: who runs when, and ratios of times with intervals."""

import math

import numpy as np
import pytest

from inim.pipeline.timing import Rounds, Timing, mean_ratio, time_calls
from inim.system.errors import UsageError


class Bench:
    """Calls that take as long as they are told, on a clock of their own."""

    def __init__(self, seconds):
        self.now, self.order, self.seconds = 0.0, [], seconds

    def calls(self):
        return {name: lambda name=name: self._work(name) for name in self.seconds}

    def _work(self, name):
        self.order.append(name)
        self.now += self.seconds[name]

    def run(self, rounds):
        return time_calls(self.calls(), rounds, clock=lambda: self.now, pause=lambda _: None)


def test_all_take_turns_in_every_round():
    bench = Bench({"yardstick": 0.1, "a": 0.2, "b": 0.3})
    times = bench.run(Rounds(runs=4, warmups=2))
    # A cold start, two warm-ups, four runs: always in the same order; before each timed run a quick
    # one, uncounted, that wakes its threads. Longer ones need none.
    timed = ["yardstick", "yardstick", "a", "b"]
    assert bench.order == ["yardstick", "a", "b"] * (1 + 2) + timed * 4
    assert [len(t.times_s) for t in times.values()] == [4, 4, 4]
    assert not any(t.slow for t in times.values())


def test_slow_ones_run_less_and_say_so():
    bench = Bench({"quick": 0.5, "slow": 3.0, "slower": 11.0})
    times = bench.run(Rounds(runs=9, warmups=2))
    assert {name: len(t.times_s) for name, t in times.items()} == {
        "quick": 9, "slow": 3, "slower": 2,
    }  # fmt: skip
    assert [name for name, t in times.items() if t.slow] == ["slow", "slower"]
    assert bench.order.count("slower") == 3  # cold, then the two that count


@pytest.mark.parametrize("wrong", [{"runs": 0}, {"warmups": 0}, {"runs": -1}])
def test_nothing_is_timed_without_a_warm_up_and_a_run(wrong):
    with pytest.raises(UsageError, match=f"--{next(iter(wrong))}"):
        Rounds(**wrong)


def timings(*times):
    return [Timing(0.0, tuple(row)) for row in times]


def test_drift_and_a_disturbed_round_cancel_in_a_ratio():
    """Rounds alternate: what slows down both cancels, and one outlier of nine is left out."""
    drift = np.linspace(1, 10, 9)
    ratio, (low, high) = mean_ratio(*timings(3 * drift, drift))
    assert ratio == pytest.approx(3) == low == high
    disturbed = drift.copy()
    disturbed[4] *= 5
    ratio, (low, high) = mean_ratio(*timings(3 * disturbed, drift))
    assert ratio == pytest.approx(3) and high / low < 1.001


@pytest.mark.parametrize("runs", [2, 3, 5, 9])
def test_the_interval_of_a_ratio_contains_the_truth_as_often_as_it_states(runs):
    random = np.random.default_rng(runs)
    draws = 3000
    hits = 0
    for noise in random.normal(0, 0.1, (draws, 2, runs)):
        _, (low, high) = mean_ratio(*timings(2 * np.exp(noise[0]), np.exp(noise[1])))
        hits += low <= 2 <= high
    assert abs(hits / draws - 0.95) < 0.015


def test_a_single_run_has_an_unknown_interval():
    assert mean_ratio(*timings([2.0], [1.0])) == (2.0, (0.0, math.inf))
    time, ends = mean_ratio(*timings([3.0, 3.0]))
    assert (time, *ends) == pytest.approx((3, 3, 3))
