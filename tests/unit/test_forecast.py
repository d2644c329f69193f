"""A progress bar's numbers: forwards only, to the end, and a remaining time by the pace so far."""

from __future__ import annotations

import random

import pytest

from inim.process.forecast import Forecast, Step

STEPS = [Step("load", 2), Step("trace", 10, rays=1000), Step("view", 1), Step("view", 1)]


class Clock:
    """Time that passes when it is told to."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_rays_move_the_share_within_their_step(clock: Clock) -> None:
    forecast = Forecast(STEPS, clock=clock)
    forecast.stage("trace")
    assert forecast.share == pytest.approx(2 / 14)
    forecast.rays(500)
    assert forecast.share == pytest.approx(7 / 14)


def test_time_moves_it_where_there_are_no_rays_but_not_to_the_step_s_end(clock: Clock) -> None:
    forecast = Forecast(STEPS, clock=clock)
    forecast.stage("load")
    clock.now = 1
    assert forecast.share == pytest.approx(1 / 14)
    clock.now = 100
    assert 1 / 14 < forecast.share < 2 / 14


def test_each_of_equal_names_is_a_step_of_its_own(clock: Clock) -> None:
    forecast = Forecast(STEPS, clock=clock)
    for expected in (12 / 14, 13 / 14, 13 / 14):  # the third is none of those planned
        forecast.stage("view")
        assert forecast.share == pytest.approx(expected)


def test_a_stage_that_is_not_planned_belongs_to_the_one_before(clock: Clock) -> None:
    forecast = Forecast(STEPS, clock=clock)
    forecast.stage("trace")
    forecast.rays(100)
    forecast.stage("write pictures")
    forecast.rays(100)
    assert forecast.share == pytest.approx(4 / 14)


def test_a_machine_half_as_fast_has_twice_as_long_to_go(clock: Clock) -> None:
    forecast = Forecast([Step("one", 20)] * 10, clock=clock)
    for done in range(8):
        clock.now = 40 * done
        forecast.stage("one")
    assert forecast.left_s == pytest.approx(120, rel=0.1)
    clock.now += 20
    assert forecast.left_s == pytest.approx(100, rel=0.1)


def test_what_a_cache_had_says_nothing_of_the_pace(clock: Clock) -> None:
    forecast = Forecast([Step("found", 100), Step("made", 100)], clock=clock)
    forecast.stage("found")
    clock.now = 0.1
    forecast.stage("made")
    assert forecast.left_s == pytest.approx(100)


def test_a_step_that_is_late_makes_the_rest_longer(clock: Clock) -> None:
    forecast = Forecast([Step("one", 10), Step("two", 90)], clock=clock)
    forecast.stage("one")
    before = forecast.left_s
    clock.now = 60
    assert forecast.left_s > before
    late = forecast.left_s
    forecast.stage("two")
    assert forecast.left_s > late, "by its whole lateness"


def test_another_round_goes_on_where_the_last_one_ended(clock: Clock) -> None:
    first = Forecast(STEPS, clock=clock)
    first.stage("view")
    again = Forecast(STEPS, first.share, clock)
    assert again.share == first.share
    again.stage("view")
    assert first.share < again.share < 1


@pytest.mark.parametrize("seed", range(20))
def test_whatever_comes_it_never_falls_nor_passes_the_end(seed: int, clock: Clock) -> None:
    chance, shares = random.Random(seed), [0.0]
    forecast = Forecast(STEPS, clock=clock)
    for _ in range(200):
        clock.now += chance.expovariate(1)
        if chance.random() < 0.1:
            forecast.stage(chance.choice(["load", "trace", "view", "other"]))
        forecast.rays(chance.randrange(40))
        shares.append(forecast.share)
        assert forecast.left_s >= 0
    assert shares == sorted(shares)
    assert shares[-1] <= 1
