"""Scores of images with replicates, against simulated noise of known law."""

from dataclasses import replace

import numpy as np
import pytest

from inim.image.noisy_image import NoisyImage
from inim.scores.metrics import HEADLINE_TO_SCENE
from inim.scores.regression.scores import (
    difference,
    half_width,
    headline_half_width,
    is_above,
    view_scores,
)


def test_halves_of_replicates_are_the_means_of_their_halves():
    replicates = np.random.default_rng(1).random((6, 5, 4, 3), np.float32)
    image = NoisyImage.from_replicates(replicates)
    np.testing.assert_allclose(image.first, replicates[:3].mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(image.second, replicates[3:].mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(image.image, replicates.mean(axis=0), atol=1e-6)


@pytest.mark.parametrize("count", [0, 2, 5])
def test_replicates_are_four_or_more_in_pairs(count):
    with pytest.raises(ValueError, match=f"{count} replicates"):
        NoisyImage.from_replicates(np.zeros((count, 2, 2, 3), np.float32))


def test_nonfinite_pixel_is_black_in_its_replicate_and_lowers_half_and_image():
    replicates = np.ones((4, 3, 3, 3), np.float32)
    replicates[1, 2, 0, 1] = np.nan
    image = NoisyImage.from_replicates(replicates).replace_nonfinite()
    assert image.nonfinite == 1
    assert (image.replicates[1, 2, 0] == 0).all()
    assert image.first[2, 0, 0] == 0.5
    assert image.image[2, 0, 2] == 0.75
    assert image.image.sum() == 27 - 3 / 4


# --- Scores without noise ------------------------------------------------------------------------

KEYS = ("ssim", "psnr_db")
_Y, _X = np.mgrid[0:32, 0:32]
#: Pictures side by side: edges, texture, a plain, a dark pattern, and stripes of which the bright
#: ones are clipped.
GREYS = [
    0.1 + 0.4 * ((_X // 11 + _Y // 9) % 2),
    0.3 + 0.15 * np.sin(_X / 1.3) * np.cos(_Y / 1.7),
    np.full(_X.shape, 0.3),
    0.02 + 0.01 * np.sin(_X / 3),
    0.5 + 1.2 * (_X // 13 % 2),
]
SCENE = np.stack([np.hstack(GREYS) * share for share in (1.0, 0.8, 0.5)], axis=-1)
OTHER = 0.9 * np.roll(SCENE, 1, axis=0) + 0.002


def draw(rng, count, law):
    """Noise of variance 1 for `count` replicates."""
    if law == "rare bright samples":
        rare = rng.random((count, *SCENE.shape[:2], 1)) < 0.05
        return (rare - 0.05) / np.sqrt(0.05 * 0.95) * np.ones(3)
    noise = rng.normal(size=(count, *SCENE.shape))
    if law == "neighbours alike":
        noise = sum(np.roll(noise, shift, (1, 2)) for shift in np.ndindex(2, 2)) / 2
    return noise


def noisy(image, noise, size=0.1):
    """Replicates whose mean has the noise of 8 with a relative standard deviation of `size`."""
    strength = size * np.sqrt(len(noise) / 8)
    return NoisyImage.from_replicates((image * (1 + strength * noise)).astype(np.float32))


def pair(rng, count, law):
    noise = draw(rng, count, law)
    other = noise if law == "shared" else draw(rng, count, law)
    return noisy(SCENE, noise), noisy(OTHER, other)


def without_noise(image):
    return NoisyImage.from_image(image.astype(np.float32))


@pytest.mark.parametrize("count", [4, 8])
@pytest.mark.parametrize("law", ["normal", "neighbours alike", "shared", "rare bright samples"])
def test_score_without_noise_is_found_and_its_interval_contains_it(count, law):
    """The whole and each picture are tested; the noise moves SSIM by up to 0.06, PSNR by 0.2 dB."""
    rng, draws = np.random.default_rng(1), 10
    regions = np.zeros((len(GREYS), *SCENE.shape[:2]), bool)
    for index, region in enumerate(regions):
        region[:, 32 * index + 6 : 32 * index + 26] = True
    clean = [
        view_scores(without_noise(SCENE), without_noise(OTHER), region, KEYS) for region in regions
    ]
    covered, values, widths = [], {key: [] for key in KEYS}, {key: [] for key in KEYS}
    for index in range(draws):
        at = index % len(GREYS)
        scores = view_scores(*pair(rng, count, law), regions[at], KEYS)
        for key, score in scores.items():
            low, high = score.interval
            covered.append(low - 1e-5 <= clean[at][key].plain <= high + 1e-5)
            if key in KEYS:
                values[key].append(score.value - clean[0][key].plain)
                widths[key].append(high - low)
    assert np.mean(covered) >= 0.9
    for key, errors in values.items():
        deviation = np.std(errors, ddof=1)
        # The sRGB curve keeps some of the skewness of rare samples.
        allowed = {"ssim": 0.003, "psnr_db": 0.02}[key] * (2 if law.startswith("rare") else 1)
        assert abs(np.mean(errors)) < 3 * deviation / np.sqrt(draws) + allowed / 2, key
    # An interval of a normal value is 3.9 deviations wide; ten draws tell these to a factor of 1.6.
    ratios = [np.mean(widths[key]) / np.std(values[key]) for key in KEYS]
    assert np.prod(ratios) ** 0.5 < 3 * 3.9, ratios


def test_identical_images_score_exactly_the_best():
    image, _ = pair(np.random.default_rng(2), 8, "normal")
    for key, score in view_scores(image, image, None, (*KEYS, "flip")).items():
        best = {"ssim": 1.0, "psnr_db": np.inf, "flip": 0.0}[key]
        assert score.value == best
        assert score.interval == (best, best)


@pytest.mark.parametrize("size", [0.1, 0.3, 1.0, 30.0])
def test_scores_and_intervals_stay_within_the_metric_s_range(size):
    rng = np.random.default_rng(3)
    images = [noisy(SCENE, draw(rng, 4, "normal"), size) for _ in range(2)]
    scores = view_scores(*images, None, (*KEYS, "flip"))
    for key, (low, high) in {"ssim": (-1, 1), "psnr_db": (0, np.inf), "flip": (0, 1)}.items():
        score = scores[key]
        first, last = score.interval
        assert low <= score.value <= high
        if np.isfinite(score.value_error):
            assert low <= first <= score.value <= last <= high


def test_more_noise_than_an_estimate_can_remove_leaves_the_interval_unknown():
    """SSIM falls from 0.90 to 0.58, then to 0.33."""
    rng = np.random.default_rng(3)
    for size, is_known in ((0.2, True), (0.6, False), (1.0, False)):
        images = [noisy(SCENE, draw(rng, 8, "normal"), size) for _ in range(2)]
        score = view_scores(*images, None, ["ssim"])["ssim"]
        assert bool(np.isfinite(score.interval).all()) is is_known
        assert not is_above(score, replace(score, value=-1.0)) or is_known


def test_order_of_replicates_and_mirrors_change_nothing():
    first, second = pair(np.random.default_rng(4), 8, "normal")
    order = np.random.default_rng(5).permutation(8)
    changes = [lambda stack: stack[order], lambda stack: stack[:, :, ::-1]]
    expected = view_scores(first, second, None, KEYS)
    for change in changes:
        images = (NoisyImage.from_replicates(change(i.replicates)) for i in (first, second))
        for key, score in view_scores(*images, None, KEYS).items():
            assert score.value == pytest.approx(expected[key].value, abs=2e-5)
            # Blocks begin at the left.
            assert score.value_error == pytest.approx(expected[key].value_error, rel=0.1)


@pytest.mark.parametrize("has_replicates", [True, False])
def test_uncertainty_of_the_headline_is_that_of_its_interval(has_replicates):
    first, second = pair(np.random.default_rng(4), 8, "normal")
    if not has_replicates:
        first, second = (NoisyImage.from_halves(*image.halves()) for image in (first, second))
    region = np.zeros(first.shape, bool)
    region[8:40, 8:30] = True
    scores = view_scores(first, second, region)
    assert headline_half_width(first, second, region) == half_width(scores[HEADLINE_TO_SCENE])
    assert headline_half_width(first, second, np.zeros_like(region)) == 0


def test_difference_of_scores_omits_the_noise_that_they_share():
    """Two nearly equal algorithms: the reference's noise cancels, and so does the capture's."""
    rng = np.random.default_rng(6)
    similar = OTHER + 0.02 * np.sin(np.arange(160) / 4)[:, None]
    clean, sharp = (
        view_scores(without_noise(SCENE), without_noise(test), None, KEYS)
        for test in (OTHER, similar)
    )
    covered = []
    for _ in range(8):
        reference, capture = noisy(SCENE, draw(rng, 8, "normal")), draw(rng, 8, "normal")
        scores = [
            view_scores(reference, noisy(test, capture), None, KEYS) for test in (OTHER, similar)
        ]
        for key in KEYS:
            first, second = (score[key] for score in scores)
            change, (low, high) = difference(first, second)
            assert change == first.value - second.value
            assert high - low < 0.5 * np.hypot(*(np.diff(s.interval)[0] for s in (first, second)))
            covered.append(low <= clean[key].plain - sharp[key].plain <= high)
    assert np.mean(covered) >= 0.85
    assert difference(first, first) == (0.0, (0.0, 0.0))
