"""Planted unfairness shows in a bench: fronts decided by noise, cold starts, other work."""

from types import SimpleNamespace

import numpy as np
import pytest

from inim.apps.bench.evaluate import warn_of_cold_start, warn_of_other_work
from inim.apps.bench.front import WRONG_SOURCE, Entry, fronts
from inim.pipeline.timing import Timing
from inim.scores.metrics import HEADLINE
from inim.scores.regression.scores import ScoreEstimate

PIXELS = 1000


def entry(ms, ssim, ssim_error=0.001, time_noise=0.01, wrong=None, is_sampled=True, seed=0, runs=9):
    """An entry; `wrong` is the number of the first pixels that are wrong."""
    noise = np.random.default_rng([seed, round(1e6 * ms)]).normal(0, time_noise, runs)
    timing = Timing(1.0, tuple(ms / 1e3 * np.exp(noise)))
    score = ScoreEstimate(ssim, 0, 1, 0, ssim, (0, 1), ssim_error, 30)
    mask = None if wrong is None else np.arange(PIXELS) < wrong
    return Entry(timing, mask, {"left": {HEADLINE: score}, "right": {HEADLINE: score}}, is_sampled)


def on_front(key=HEADLINE, **entries):
    return [name for name, keys in fronts(entries).items() if key in keys]


def test_an_entry_that_is_slower_and_worse_is_on_no_front():
    assert on_front(fast=entry(1, 0.9), slow=entry(2, 0.8)) == ["fast"]
    assert on_front(fast=entry(1, 0.8), slow=entry(2, 0.9)) == ["fast", "slow"]


def test_noise_decides_no_front():
    """Differences within the noise of times and scores distinguish no entries."""
    first, other = entry(1, 0.90, time_noise=0.2), entry(1.02, 0.89, 0.01, time_noise=0.2)
    assert on_front(first=first, other=other) == ["first", "other"]
    precise = entry(1.02, 0.89, time_noise=1e-4)
    assert on_front(first=entry(1, 0.90, time_noise=1e-4), other=precise) == ["first"]


def test_an_entry_that_only_noise_separates_in_one_value_is_beaten_by_the_other():
    assert on_front(fast=entry(1, 0.90, 0.01), slow=entry(2, 0.901, 0.01)) == ["fast"]
    assert on_front(good=entry(1, 0.90, time_noise=0.2), bad=entry(0.99, 0.8, time_noise=0.2)) == [
        "good"
    ]


def test_many_entries_raise_the_level():
    """About one of twenty equal ones would beat another at the level of a single test."""
    noisy = {f"e{n}": entry(1 + 1e-6 * n, 0.9, seed=n) for n in range(20)}
    assert len(on_front(**noisy)) == 20


def test_few_runs_exclude_no_fast_entry():
    """Three runs show a factor of 30 at the level of one test, not at that of all pairs."""
    noisy = {f"e{n}": entry(30 + n, 0.9, time_noise=0.2, runs=3, seed=n) for n in range(10)}
    assert "fast" in on_front(fast=entry(1, 0.7, time_noise=0.2, runs=3), **noisy)


def test_wrong_sources_are_compared_pixel_by_pixel():
    """Ten of the same thousand pixels distinguish, as no pixel speaks for the other entry."""
    fewer, more = entry(1, 0.9, wrong=100), entry(2, 0.9, wrong=112)
    assert on_front(WRONG_SOURCE, fewer=fewer, more=more) == ["fewer"]
    same_time = entry(1, 0.9, wrong=102)
    assert on_front(WRONG_SOURCE, fewer=fewer, more=same_time) == ["fewer", "more"]
    whole = [entry(1, 0.9, wrong=n, is_sampled=False) for n in (100, 102)]
    assert on_front(WRONG_SOURCE, fewer=whole[0], more=whole[1]) == ["fewer"]
    assert on_front(WRONG_SOURCE, fewer=fewer, unknown=entry(0.1, 0.9)) == ["fewer"]


def test_a_single_run_has_no_interval_and_beats_no_other():
    once = Entry(Timing(1.0, (0.001,)), None, entry(1, 0.9).scores)
    assert on_front(once=once, slow=entry(9, 0.9)) == ["once", "slow"]


@pytest.mark.parametrize(
    ("times", "warned"),
    [
        ((5.0, 1.0, 1.1, 0.9), True),
        ((1.2, 1.0, 1.1), False),
        ((1.0, 5.0, 1.0), False),
        ((1.0,), False),
    ],
)
def test_a_cold_start_that_counts_for_one_algorithm_is_a_warning(times, warned):
    warning = warn_of_cold_start("late", Timing(9.0, times))
    assert [w for w in warning if "late" in w and "cold start" in w] == warning
    assert bool(warning) == warned


@pytest.mark.parametrize(("levels", "share", "warned"), [(2, 1.0, 0), (40, 0.01, 1), (40, 5e-4, 0)])
def test_other_work_when_timed_is_a_warning(levels, share, warned):
    scored = np.full((100, 100, 3), 100, np.uint8)
    timed = np.dstack([scored, np.full((100, 100), 255, np.uint8)])
    timed.reshape(-1, 4)[: int(share * 1e4), :3] += levels
    warnings = warn_of_other_work(SimpleNamespace(name="half", out=timed), scored)
    assert len(warnings) == warned
    assert not warned or "other work" in warnings[0]
