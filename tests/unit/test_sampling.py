"""Number of samples that scores need, on scores whose noise is known."""

import math

import pytest

from inim.display.settings import Settings
from inim.pipeline.adaptive_sampling import largest_uncertainty, next_share, scale_samples
from inim.scores.regression.scores import ScoreEstimate


def estimate(plain: float, error: float, freedom: float, bias: float) -> ScoreEstimate:
    """Estimate with one error, with and without noise."""
    return ScoreEstimate(
        plain, error, freedom, bias, plain - bias, value_error=error, value_freedom=freedom
    )


def score(share: float, power: float = 1.0, size: float = 0.005, error: float = 1e-5):
    """Score of a noiseless 0.9 with a bias that is a power of the noise's variance, 1 / share."""
    bias = size * share**-power
    return {"a": estimate(0.9 - bias, error / math.sqrt(share), 1e6, -power * bias)}


@pytest.mark.parametrize("power", [0.4, 0.7, 1.0])
@pytest.mark.parametrize("before", [1 / 16, 1 / 4, 1 / 2])
def test_bias_of_any_power_is_estimated(power, before):
    uncertainty = largest_uncertainty(score(1.0, power), score(before, power))
    assert uncertainty == pytest.approx(0.005 + 1.96e-5, rel=1e-3)


def test_interval_counts_too():
    uncertainty = largest_uncertainty(score(1.0, error=0.01), score(0.5, error=0.01))
    assert uncertainty == pytest.approx(0.005 + 0.0196, rel=1e-2)


def test_scores_without_noise_are_known():
    sure = {"a": estimate(1.0, 0.0, 1.0, 0.0)}
    assert largest_uncertainty(sure, sure) == 0
    assert next_share(1 / 16, sure, 0.01) == 1 / 8


def test_undefined_estimates_are_not_known():
    estimates = {"a": estimate(math.nan, 0.1, 1.0, 0.0)}
    assert largest_uncertainty(score(1.0), {}) == math.inf
    assert largest_uncertainty({}, {}) == math.inf
    assert largest_uncertainty(estimates, estimates) == math.inf
    assert next_share(1 / 16, {"a": estimate(0.5, math.nan, 1.0, 0.0)}, 0.01) == 1


def test_the_least_known_score_counts_and_new_ones_bend_as_the_others():
    scores = score(1.0, 0.5) | {"b": estimate(0.5, 1e-6, 1e6, -0.02)}
    assert largest_uncertainty(scores, score(0.5, 0.5)) == pytest.approx(0.04, rel=1e-2)


@pytest.mark.parametrize(("error", "share"), [(0.2, 1 / 8), (0.1, 1 / 8), (0.03, 1 / 2), (1e-4, 1)])
def test_forecast_doubles_and_ends(error, share):
    assert next_share(1 / 16, score(1 / 16), error) == share


def test_shares_of_samples_are_even_numbers_and_no_more_than_asked_for():
    settings = Settings(capture_spp=1, eia_spp=7, view_spp=256, reconstruction_spp=64)
    spp = scale_samples(settings, 1 / 16)
    assert (spp.capture_spp, spp.eia_spp, spp.view_spp, spp.reconstruction_spp) == (1, 2, 16, 4)
    assert scale_samples(settings, 1) == settings
