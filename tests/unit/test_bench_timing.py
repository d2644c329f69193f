"""The bench's arithmetic: who runs when, medians, ratios, the front."""

import pytest

from inim.apps.bench.evaluate import mark_fronts
from inim.pipeline.timing import Rounds, time_calls
from inim.system.errors import UsageError
from tests.unit.test_bench_report import algorithm


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
        "quick": 9, "slow": 3, "slower": 1,
    }  # fmt: skip
    assert [name for name, t in times.items() if t.slow] == ["slow", "slower"]
    assert bench.order.count("slower") == 2  # cold, then the one that counts


@pytest.mark.parametrize("wrong", [{"runs": 0}, {"warmups": 0}, {"runs": -1}])
def test_nothing_is_timed_without_a_warm_up_and_a_run(wrong):
    with pytest.raises(UsageError, match=f"--{next(iter(wrong))}"):
        Rounds(**wrong)


def test_a_method_without_sources_can_still_be_on_another_front():
    def timed(name, ms, wrong, psnr):
        scores = {"eia_psnr_db": psnr, "eia_ssim": 0.5, "view_ssim_to_reference": 0.5}
        return algorithm(name, ms, wrong, scores)

    methods = [timed("a", 1.0, 0.1, 20), timed("b", 2.0, None, 30), timed("c", 3.0, 0.1, 20)]
    marked = {m.name: m for m in mark_fronts(methods)}
    assert marked["a"].fronts[0] == "wrong_source"
    assert marked["b"].fronts == ["eia_psnr_db"]
    assert (marked["b"].pareto, marked["c"].pareto, marked["c"].fronts) == (True, False, [])
