"""Light scores: errors of brightness and colour on the relic, with simulated noise of known law."""

import numpy as np
import pytest
from scipy import stats

from inim.image.noisy_image import NoisyImage
from inim.scores.regression.light import light_scores
from inim.scores.regression.scores import compare_scores

SHAPE = (64, 80)
RELIC = np.zeros(SHAPE, bool)
RELIC[8:56, 12:70] = True
GREY = np.where(RELIC[..., None], 0.4, 0.0) * np.ones(3)


def noisy(rng, image, noise=0.01, parts=8):
    """An image with independent noise on the relic."""
    draws = noise * rng.normal(size=(parts, *image.shape)) * RELIC[..., None]
    return NoisyImage.from_parts((image + draws).astype(np.float32))


def alarms(seed, factor=1.0, **options):
    """Names of the light scores that changed between two runs, of which the second is wrong."""
    rng = np.random.default_rng(seed)
    old = light_scores(noisy(rng, GREY, **options), noisy(rng, GREY, **options), RELIC)
    new = light_scores(noisy(rng, GREY, **options), noisy(rng, GREY * factor, **options), RELIC)
    checks = compare_scores({"a/left": old}, {"a/left": new})
    assert len(checks) == 18
    assert sum(check.kind == "score" for check in checks) == 3
    return {c.name.partition(": ")[2].partition(" against ")[0] for c in checks if not c.passed}


@pytest.mark.parametrize("parts", [2, 8])
def test_a_brightness_error_of_one_per_cent_is_found(parts):
    for seed in range(5):
        assert alarms(seed, 0.99, parts=parts) >= {
            f"light on relic {colour}{to}"
            for colour in ("red", "blue")
            for to in ("", " to reference")
        }


def test_a_colour_error_of_one_per_cent_is_found_in_its_colour():
    assert alarms(1, np.array([1, 1.01, 1])) >= {"light on relic green"}
    assert not any("red" in name for name in alarms(1, np.array([1, 1.01, 1])))


def test_light_on_one_side_is_found_on_that_side():
    error = np.ones((*SHAPE, 1))
    error[:, :41] = 0.98
    error[:, 41:] = 1.02
    names = alarms(2, error)
    assert {"light on left half red", "light on right half red"} <= names
    assert "light on relic red" not in names


def test_fresh_noise_is_no_change():
    assert not any(alarms(seed) for seed in range(40))


@pytest.mark.parametrize("parts", [2, 8])
def test_light_has_the_error_with_which_it_varies_and_no_bias(parts):
    rng = np.random.default_rng(3)
    name, p = "light_on_relic_red_to_reference", []
    for _ in range(100):
        score = light_scores(
            noisy(rng, GREY, 0.2, parts), noisy(rng, 1.1 * GREY, 0.2, parts), RELIC
        )[name]
        p.append(2 * stats.t.sf(abs(score.plain - 10) / score.error, score.freedom))
    # The error includes a reserve for coupled pixels, sqrt(1.34) or more, which these are not.
    assert 0.005 < np.mean(np.array(p) < 0.1) < 0.1


@pytest.mark.parametrize("parts", [2, 8])
@pytest.mark.parametrize("column", [16, 28, 32, 37])
def test_noise_of_whole_lenses_has_its_error_wherever_it_is(parts, column):
    """Noise that is equal within patches of 5 x 5 pixels, in a stripe; the truth by many draws."""
    rng = np.random.default_rng(4)
    relic, name = np.ones((64, 64), bool), "light_on_relic_red"
    stripe = np.zeros((1, 64, 64, 1))
    stripe[:, :, column - 5 : column + 5] = 0.1
    values, errors = [], []
    for _ in range(250):
        patches = rng.normal(size=(parts, 14, 14, 3)).repeat(5, axis=1).repeat(5, axis=2)
        top, left = rng.integers(0, 5, 2)
        noise = stripe * patches[:, top : top + 64, left : left + 64]
        image = NoisyImage.from_parts((0.4 + noise).astype(np.float32))
        score = light_scores(image, image, relic)[name]
        values.append(score.plain)
        errors.append(score.error)
    ratio = np.std(values) / np.sqrt(np.mean(np.square(errors)))
    # The reserve is for noise of lenses of 4 pixels and for halves at most sqrt(1.9).
    assert 1 / np.sqrt(1.9) - 0.05 < ratio < 1.1


def test_a_relic_without_light_has_no_light_scores():
    black = NoisyImage.from_image(np.zeros((*SHAPE, 3), np.float32))
    assert light_scores(black, black, RELIC) == {}
    grey = NoisyImage.from_image(GREY.astype(np.float32))
    assert light_scores(grey, grey, np.zeros(SHAPE, bool)) == {}
    exact = light_scores(grey, grey, RELIC)
    assert {s.error for s in exact.values()} == {0.0}
    assert exact["light_on_relic_red"].plain == pytest.approx(40)
    assert exact["light_on_relic_red_to_reference"].plain == 0
