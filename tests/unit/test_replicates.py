"""Scores of images with replicates, against simulated noise of known law."""

import numpy as np
import pytest

from inim.image.noisy_image import NoisyImage


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
