"""Other programs that disturb times are recorded."""

import os

import pytest

from inim.apps.bench import evaluate
from inim.apps.bench.evaluate import warn_of_others
from inim.pipeline import timing
from inim.system.process.observer import Observer


@pytest.mark.parametrize(
    ("busy_s", "own_s", "share"),
    [(8.0, 8.0, 0.0), (9.0, 5.0, 0.2), (1.0, 2.0, 0.0), (None, 5, None)],
)
def test_other_programs_have_the_processor_time_that_is_not_our_own(
    monkeypatch, busy_s, own_s, share
):
    clocks = {"perf_counter": [100.0, 110.0], "process_time": [1.0, 1.0 + own_s]}
    for name, values in clocks.items():
        monkeypatch.setattr(timing.time, name, iter(values).__next__)
    busy = iter([50.0, None if busy_s is None else 50.0 + busy_s])
    monkeypatch.setattr(timing, "busy_seconds", busy.__next__)
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    with timing.OtherPrograms() as others:
        pass
    assert others.share == (None if share is None else pytest.approx(share))


@pytest.mark.parametrize(
    ("shares", "attempts", "best"),
    [([0.05], 1, 0.05), ([0.5, 0.08], 2, 0.08), ([0.9, 0.4, 0.6], 3, 0.4), ([None], 1, None)],
)
def test_disturbed_times_are_taken_again(monkeypatch, shares, attempts, best):
    class Others(timing.OtherPrograms):
        remaining = iter(shares)

        def __exit__(self, *_):
            self.share = next(self.remaining)

    runs = []
    monkeypatch.setattr(evaluate, "OtherPrograms", Others)
    monkeypatch.setattr(evaluate, "time_methods", lambda *_: runs.append(1) or len(runs))
    times, share = evaluate._time_undisturbed([], None, None, timing.Rounds(), Observer())
    assert (len(runs), share) == (attempts, best)
    assert times == shares.index(best) + 1
    assert bool(warn_of_others(best)) == (best in (0.4, None))
