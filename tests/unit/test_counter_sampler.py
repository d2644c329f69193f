"""The sampler: numbers that follow from seed, pixel and sample, uniform and well spread."""

import numpy as np
import pytest
from scipy import stats

pytestmark = pytest.mark.usefixtures("renderer")


def pairs(seed, pixels, samples, count=1):
    """`count` pairs of every sample of every pixel, (pixels, samples, count, 2)."""
    import mitsuba as mi

    from inim.render.counter_sampler import PLUGIN

    sampler = mi.load_dict({"type": PLUGIN})
    pixel = np.repeat(np.asarray(pixels, np.uint32), len(samples))
    sample = np.tile(np.asarray(samples, np.uint32), len(pixels))
    sampler.start(seed, mi.UInt32(pixel), mi.UInt32(sample))
    points = [np.array(sampler.next_2d()).T for _ in range(count)]
    return np.stack(points, axis=1).reshape(len(pixels), len(samples), count, 2)


def test_numbers_follow_from_seed_pixel_and_sample():
    whole = pairs(3, range(50), range(16), 5)
    part = pairs(3, [41, 7], [9, 2], 5)
    assert np.array_equal(part, whole[[41, 7]][:, [9, 2]])
    assert not np.array_equal(pairs(4, range(50), range(16), 5), whole)


@pytest.mark.parametrize(("bits", "pixels"), [(4, 200), (17, 1)])
def test_samples_of_a_pixel_are_a_net(bits, pixels):
    """One sample in every box of equal area, whatever its shape: a (0, m, 2)-net, as Sobol's is."""
    count = 2**bits
    samples = pairs(11, range(pixels), range(count), 3).transpose(0, 2, 1, 3).reshape(-1, count, 2)
    for across in range(bits + 1):
        boxes = np.floor(samples * [2**across, 2 ** (bits - across)]).astype(int)
        numbers = boxes[..., 0] * 2 ** (bits - across) + boxes[..., 1]
        assert (np.sort(numbers) == np.arange(count)).all()


def test_every_sample_alone_is_uniform_and_shares_nothing_with_others():
    """Chi-squared of values, and of pairs across pixels, dimensions and seeds."""
    count, cells = 2**17, 16
    # The third sample of every pixel, by two seeds: what is not one pixel's is independent.
    own, other = (pairs(seed, range(count), [3], 3).reshape(count, 6) for seed in (20, 21))
    columns = [*own.T, *other.T]
    beside = [np.roll(column, 1) for column in own.T]
    tests = []
    for i, first in enumerate(columns):
        histogram = np.bincount((first * 256).astype(int), minlength=256)
        tests.append(stats.chisquare(histogram).pvalue)
        for second in [*columns[i + 1 :], *beside]:
            cell = (first * cells).astype(int) * cells + (second * cells).astype(int)
            tests.append(stats.chisquare(np.bincount(cell, minlength=cells**2)).pvalue)
    level = 1 - (1 - 0.01) ** (1 / len(tests))
    assert min(tests) > level
    assert own.min() >= 0
    assert own.max() < 1


def test_less_noise_than_independent_samples():
    """The mean of a smooth function over 32 samples: at least ten times less variance."""
    samples = pairs(5, range(4000), range(32))[:, :, 0]
    smooth = np.sin(3 * samples[..., 0]) * np.exp(samples[..., 1])
    assert smooth.mean(axis=1).var() < smooth.var() / 32 / 10
