"""Doubts about a run: a verdict that concerns quality does not pass on unusable images."""

import numpy as np
import pytest

from inim.image.noisy_image import NoisyImage
from inim.pipeline.stages.doubts import firefly_share
from inim.scores.document_parts import Checks, check


def halves(samples: int, share: float, light: float) -> NoisyImage:
    """Halves of pixels whose samples are 0.3, or rarely `light`."""
    random = np.random.default_rng(3)
    rare = random.binomial(samples // 2, share, (2, 200, 200, 1)) / (samples // 2)
    first, second = (0.3 * (1 - rare) + light * rare).astype(np.float32).repeat(3, axis=-1)
    return NoisyImage.from_halves(first, second)


def test_light_of_rare_samples_is_the_share_of_fireflies():
    # One sample in 4,096 has 2,000 times white: 62 % of the light, nearly all of it above white.
    share, light = 1 / 4096, 2000.0
    expected = share * light / (0.3 + share * light)
    assert firefly_share(halves(64, share, light)) == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize(("share", "light"), [(0.0, 0.0), (0.5, 0.8), (1.0, 1.3), (0.3, 1.5)])
def test_ordinary_noise_and_light_above_white_are_no_fireflies(share, light):
    assert firefly_share(halves(64, share, light)) < 0.001
    assert firefly_share(NoisyImage.from_image(np.full((8, 8, 3), 4, np.float32))) == 0


@pytest.mark.parametrize(
    ("criterion", "value", "passed", "word"),
    [
        (False, 0.9, True, "not conclusive"),
        (True, 0.9, False, "not conclusive"),
        (True, 0.1, False, "failed"),
    ],
)
def test_a_criterion_does_not_pass_on_doubtful_images(criterion, value, passed, word):
    verdict = Checks.of([check("SSIM", value, ">=", 0.5, criterion=criterion)], ["noise"])
    assert (verdict.passed, verdict.word) == (passed, word)
