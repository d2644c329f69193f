"""Rounds of samples: how many, until which intervals, and what earlier rounds are worth."""

import math
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from inim.display.settings import Settings
from inim.image.noisy_image import REPLICATES, NoisyImage
from inim.pipeline.adaptive_sampling import MOST, Sampling, interval_excess
from inim.pipeline.stages.stage import Run
from tests.conftest import small_display

USUAL = {"capture_spp": 64, "eia_spp": 32, "view_spp": 64}


def plan(
    error: float = 0.01,
    by_need: tuple[str, ...] = (*USUAL,),
    baseline: object = None,
    **stated: int,
) -> object:
    return SimpleNamespace(
        samples=USUAL | stated,
        by_need=by_need,
        settings=SimpleNamespace(score_error=error),
        methods=[SimpleNamespace(decides_samples=True)],
        display=small_display(20, 16),
        baseline=baseline,
    )


def test_samples_are_those_stated_or_the_usual_ones_of_the_layout():
    settings = Settings(eia_spp=7).with_samples(small_display(20, 16))
    assert (settings.capture_spp, settings.eia_spp, settings.view_spp) == (64, 7, 64)


@pytest.mark.parametrize(
    "fixed",
    [
        plan(error=0.0),
        plan(by_need=()),
        plan(by_need=("view_spp",)),  # more of these would not make the scores more precise
    ],
)
def test_a_run_has_one_round_of_the_usual_samples_if_scores_decide_nothing(fixed):
    sampling = Sampling.of(fixed, is_adaptive=True)
    assert sampling.is_last
    assert sampling.share == 1
    assert sampling.rounds == {name: (count,) for name, count in USUAL.items()}


def test_unused_samples_are_explained_by_the_methods_that_decide():
    run = Run()
    Sampling.of(plan(), is_adaptive=True).record(plan(), run)
    (row,) = run.skipped.rows
    assert "+-0.01 for each of inim's own algorithms and finished EIAs" in row["why"]


@pytest.mark.parametrize("excess", [1.01, 1.9, 4.1, 70.0, math.inf])
def test_rounds_add_up_and_end_at_the_most_samples(excess):
    sampling, shares = Sampling.of(plan(), is_adaptive=True), []
    while True:
        shares.append(sampling.share)
        for name, rounds in sampling.rounds.items():
            assert sum(rounds) == sampling.totals[name] == sampling.share * USUAL[name]
            assert all(samples % REPLICATES == 0 for samples in rounds)
        if sampling.is_last:
            break
        sampling = sampling.next_round(excess)
    assert shares[0] == 1 and shares[-1] == MOST
    ratios = [b / a for a, b in pairwise(shares)]
    assert min(ratios) >= 2


def test_a_round_is_never_larger_than_intervals_may_need():
    first = Sampling.of(plan(), is_adaptive=True)
    assert [first.next_round(e).share for e in (1.5, 3.9, 4.0, 100)] == [2, 2, 4, 4]


def test_stated_samples_are_taken_once():
    sampling = Sampling.of(plan(by_need=("eia_spp",), view_spp=10), is_adaptive=True)
    further = sampling.next_round(2.0)
    assert further.rounds == {"capture_spp": (64,), "eia_spp": (32, 32), "view_spp": (10,)}


def test_samples_of_a_baseline_beyond_the_usual_ones_are_a_second_round():
    baselines = plan(baseline="any", eia_spp=128, view_spp=256, capture_spp=64)
    first = Sampling.of(baselines, is_adaptive=True)
    assert first.rounds == {"capture_spp": (64,), "eia_spp": (32,), "view_spp": (64,)}
    assert not first.is_last and first.share <= 1
    second = first.next_round(math.inf)
    assert second.rounds == {"capture_spp": (64,), "eia_spp": (32, 96), "view_spp": (64, 192)}
    assert second.is_last and second.share > 1  # only observed pixels
    assert second.totals == first.totals == baselines.samples


@pytest.mark.parametrize("counts", [{"eia_spp": 16}, {"eia_spp": 32}])
def test_no_more_than_the_usual_samples_of_a_baseline_are_one_round(counts):
    sampling = Sampling.of(plan(baseline="any", **counts), is_adaptive=True)
    assert sampling.is_last
    assert sampling.rounds["eia_spp"] == (counts["eia_spp"],)


def view(noise: float, seed: int) -> NoisyImage:
    random = np.random.default_rng(seed)
    picture = np.add.outer(np.linspace(0.1, 0.4, 48), np.linspace(0, 0.3, 48))
    texture = 0.1 * np.random.default_rng(0).random((48, 48))
    replicates = random.normal((picture + texture)[..., None], noise, (REPLICATES, 48, 48, 3))
    return NoisyImage.from_replicates(replicates.astype(np.float32))


def excess(noise: float, of_truth: float = 1e-3, error: float = 0.01) -> float:
    names = ("centre", "left")
    region = np.ones((48, 48), bool)
    truth = SimpleNamespace(
        eia=view(0, 0),
        views={name: view(of_truth, 5) for name in names},
        regions=dict.fromkeys(names, region),
        reference_views={name: view(noise, 1) for name in names},
    )
    views = {name: view(noise, 2) for name in names}
    return interval_excess(truth, [views], error, Run())


def test_intervals_decide_in_units_of_the_error():
    assert excess(0.01) == pytest.approx(2 * excess(0.01, error=0.02))
    assert excess(0.002) < excess(0.01) < excess(0.02)
    assert excess(0.0) == 0


def test_a_ground_truth_of_noise_is_never_precise_enough():
    assert excess(0.002, of_truth=0.5) == math.inf
