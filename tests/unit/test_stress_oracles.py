"""Oracles of the stress run against the tests' own rational oracle, and generators against both."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from hypothesis.database import DirectoryBasedExampleDatabase

from inim.apps.stress.oracles.generators import answer, exact_first_hits, first_hits
from inim.apps.stress.oracles.rays import rays_over
from inim.apps.stress.pictures import noise
from inim.display import Display
from inim.generators import find_sources
from inim.generators.accuracy_limits import accuracy_warnings
from inim.generators.oracle import lensed_pixels
from inim.generators.template import ray_by_ray
from inim.image.rgbd import RGBD
from tests import oracle as rational
from tests.conftest import small_display

# Failures found once are tried first ever after, here and wherever the folder goes.
FAILURES = DirectoryBasedExampleDatabase(Path(__file__).parent / "stress_failures")
RANDOM = settings(
    max_examples=2,
    deadline=None,
    database=FAILURES,
    suppress_health_check=[HealthCheck.too_slow],
    derandomize=False,
)


def picture(display: Display, seed: int = 0, per_pitch: int = 2) -> RGBD:
    shape = display.capture_shape(per_pitch)
    return noise(display, shape, display.pitch_mm / per_pitch, seed)


def all_rays(display: Display, rgbd: RGBD):
    return rays_over(display, rgbd, lensed_pixels(display))


@pytest.mark.parametrize("shift", [0.0, 0.1])
@pytest.mark.parametrize("pixels", [4, 5])
def test_oracles_in_fractions_and_in_float64_agree_with_the_tests_rational_one(pixels, shift):
    display = small_display(3, 2, pixels=pixels)
    rgbd = picture(display)
    rays = all_rays(display, rgbd)
    hits = exact_first_hits(rays, rgbd, display, np.arange(len(rays.pixels)))
    expected = rational.exact_sources(rgbd, display)[rays.pixels[:, 0], rays.pixels[:, 1]]
    assert np.array_equal(hits, expected)
    # The float one agrees wherever it does not say that rounding decides.
    float64 = answer("template", rays, rgbd, display, np.float64)
    assert not ((float64.sources != hits) & ~float64.uncertain).any()
    if shift:
        moved = display.replace(shift_x_mm=shift)
        assert not np.array_equal(first_hits(all_rays(moved, rgbd), rgbd, moved), hits)


lengths = st.sampled_from([1.0, 0.5, 0.93, 1 / 3, 1.17, 2.0])


@st.composite
def displays(draw):
    """Random displays, real and virtual, of whole and broken numbers of pixels."""
    pitch = draw(lengths)
    focal = pitch * draw(st.sampled_from([2.0, 3.0, 3.7]))
    gap = focal * draw(st.sampled_from([0.8, 0.9, 1.1, 1.25]))
    ratio = draw(st.sampled_from([2, 3, 4.5, 5, 5.3]))
    columns, rows = draw(st.integers(1, 4)), draw(st.integers(1, 3))
    ends = draw(st.sampled_from([None, (-6.0, 5.0), (3.0, 9.0), (-9.0, -2.5)]))
    stated = {}
    if ends is not None:
        stated = {"depth_min_mm": ends[0] * pitch, "depth_max_mm": ends[1] * pitch}
    return Display(pitch, focal, gap, pitch / ratio, columns, rows, **stated)


#: Each of wang2024's entries is on a border of picture pixels.
ON_BORDERS = Display(1 / 3, 2 / 3, 1.6 / 3, 1 / 15, 1, 2)
#: The end of its depth range, nine pitches, is not the nearest float to its value.
END_BELOW = Display(
    0.93, 1.86, 1.674, 0.62 / 3, 1, 2, depth_min_mm=-9 * 0.93, depth_max_mm=-2.5 * 0.93
)


def random_displays(limits):
    """A test of random displays and pictures, the known hard ones first."""

    def decorated(test):
        arguments = given(displays(), st.integers(0, 2**31), st.sampled_from([1, 2, 3, 1.7]))
        hard = example(ON_BORDERS, 113, 3)(example(END_BELOW, 2, 1)(test))
        return limits(arguments(hard))

    return decorated


@random_displays(RANDOM)
def test_random_displays_are_exact_and_uncertain_where_they_differ(display, seed, per_pitch):
    exact_or_uncertain(display, seed, per_pitch)


@pytest.mark.slow
@random_displays(settings(RANDOM, max_examples=40))
def test_many_random_displays_are_too(display, seed, per_pitch):
    exact_or_uncertain(display, seed, per_pitch)


def exact_or_uncertain(display, seed, per_pitch):
    """`template` in all forms against fractions; the others within rounding of their definition."""
    rgbd = noise(display, (14, 16), display.pitch_mm / per_pitch, seed)
    rays = all_rays(display, rgbd)
    if not len(rays.pixels):
        return
    at = rays.pixels[:, 0], rays.pixels[:, 1]
    exact = exact_first_hits(rays, rgbd, display, np.arange(len(rays.pixels)))
    alone = ray_by_ray(display, rgbd.shape, rgbd.pixel_mm).sources(rgbd)
    # Lengths of too many digits (3 x 0.8 is not 2.4) are warned of, and then ties may be lost.
    warned = bool(accuracy_warnings(display, pixel_mm=rgbd.pixel_mm))
    uncertain = answer("template", rays, rgbd, display, np.float64).uncertain
    for sources in (find_sources(rgbd, display), alone):
        wrong = sources[at] != exact
        assert not (wrong & ~uncertain if warned else wrong).any()
    for algorithm in ("gu2020", "wang2024:matching=ray", "li2012"):
        expected = answer(algorithm, rays, rgbd, display, np.float64)
        sources = find_sources(rgbd, display, algorithm)[at]
        assert not ((sources != expected.sources) & ~expected.uncertain).any(), algorithm
