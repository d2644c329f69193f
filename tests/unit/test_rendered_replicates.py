"""Replicates of rendered and generated images.

Expected: the noise of different replicates is uncorrelated, so that of their mean has a K-th of
the variance; their mean is the image; replicates of an EIA are those of the observed pixels, and do
not depend on the pixels around; a generator's are its EIAs of the capture's parts, without the
bias of interpolation in square roots of light. Another package's generator has them as well if its
sources do not depend on the noise.
"""

import numpy as np
import pytest

from inim.display import Viewpoint
from inim.generators import Algorithm, SourceGenerator, find_sources
from inim.generators import generate as generate_once
from inim.image.noisy_image import REPLICATES, NoisyEIA, split_samples
from inim.image.rgbd import RGBD
from inim.pipeline.stages.capture import Capture, CapturedInput
from inim.pipeline.stages.generation import GeneratorHandle, generate
from tests.conftest import scene_text, small_display, sphere

# Two diffuse balls in the light of a near lamp: soft shadows are noisy.
LAMP = """<shape type="rectangle"><transform name="to_world"><scale value="2"/>
    <rotate y="1" angle="180"/><translate z="9"/></transform>
    <emitter type="area"><rgb name="radiance" value="5"/></emitter></shape>"""
BALLS = (sphere((-2, 0, 0), 1.8), sphere((2, 1, -2), 1.5))
DISPLAY = small_display(20, 16)
SPP = 32


@pytest.mark.parametrize(
    ("spp", "parts"), [(1, (2, 1)), (7, (2, 3)), (8, (8, 1)), (12, (8, 2)), (64, (8, 8))]
)
def test_samples_are_split_into_eight_equal_parts_or_two_halves(spp, parts):
    assert split_samples(spp) == parts


def observed_pixels(seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).random(DISPLAY.eia_shape) < 0.3


@pytest.fixture
def fitted(open_fitted):
    return open_fitted(scene_text(*BALLS, LAMP), DISPLAY)


def replicates_and_exact(image: str, fitted: object) -> tuple[np.ndarray, np.ndarray]:
    """Replicates, (K, values), and the mean of very many samples of their pixels."""
    from inim.render.ground_truth import capture, capture_parts, pickup, true_view

    if image == "EIA":
        mask, samples = observed_pixels(), {"spp": 40 * SPP, "seed": 9}
        replicates = pickup(fitted, DISPLAY, spp=SPP, seed=1, observed=mask).observed
        exact = pickup(fitted, DISPLAY, mask=mask, **samples).image[mask]
    elif image == "view":
        eye, size = Viewpoint("eye", 5, -4, 200), {"pixels_per_lens": 5}
        replicates = true_view(fitted, DISPLAY, eye, spp=SPP, seed=1, **size)[0].replicates
        exact = true_view(fitted, DISPLAY, eye, spp=40 * SPP, seed=9, **size)[0].image
    else:
        size = {"pixels_per_pitch": 3}
        parts = capture_parts(fitted, DISPLAY, spp=SPP, seed=1, **size)
        replicates = np.stack([part.color for part in parts])
        exact = capture(fitted, DISPLAY, spp=40 * SPP, seed=9, **size).color
    return replicates.reshape(REPLICATES, -1), exact.reshape(-1)


@pytest.mark.parametrize("image", ["EIA", "view", "capture"])
def test_replicates_are_independent(image, fitted):
    replicates, exact = replicates_and_exact(image, fitted)
    noise = (replicates - exact).astype(np.float64).reshape(REPLICATES, -1, 3)
    squares = np.square(noise).sum(axis=(0, 2))
    # Products of different replicates, by pixel: colours share their paths.
    products = np.square(noise.sum(axis=0)).sum(axis=-1) - squares
    pairs = REPLICATES - 1
    correlation = products.sum() / (pairs * squares.sum())
    error = np.sqrt(np.square(products).sum()) / (pairs * squares.sum())
    assert abs(correlation) < 3 * error < 0.07
    variance, of_mean = np.square(noise).mean(), np.square(noise.mean(axis=0)).mean()
    assert of_mean == pytest.approx(variance / REPLICATES, rel=0.4)


def test_halves_of_the_eia_are_means_of_its_replicates_wherever_it_is_observed(fitted):
    from inim.render.ground_truth import pickup

    mask = observed_pixels()
    eia = pickup(fitted, DISPLAY, spp=SPP, seed=1, observed=mask)
    halves = eia.observed.reshape(2, REPLICATES // 2, -1, 3).mean(axis=1)
    for half, whole in zip(halves, (eia.first, eia.second), strict=True):
        np.testing.assert_allclose(half, whole[mask], atol=2e-6)
    alone = pickup(fitted, DISPLAY, spp=SPP, seed=1, mask=mask, observed=mask)
    assert np.array_equal(alone.observed, eia.observed)
    assert np.array_equal(alone.image, np.where(mask[..., None], eia.image, np.float32(0)))
    unobserved = pickup(fitted, DISPLAY, spp=SPP, seed=1)
    assert unobserved.observed is None
    np.testing.assert_allclose(eia.image.mean(), unobserved.image.mean(), rtol=0.02)


def test_rounds_of_samples_are_the_samples_of_one_rendering(fitted):
    from inim.render.ground_truth import capture_parts, pickup, true_view

    mask, eye = observed_pixels(), Viewpoint("eye", 5, -4, 200)
    size, share = {"pixels_per_lens": 5}, 3 / 4
    once, first, rest = {"spp": 32}, {"spp": 8}, {"spp": 24, "first": 8}
    whole, before, last = (
        pickup(fitted, DISPLAY, seed=1, observed=mask, **s) for s in (once, first, rest)
    )
    merged = before.merged(last, share)
    np.testing.assert_allclose(merged.image, whole.image, atol=2e-6)
    np.testing.assert_allclose(merged.noise, whole.noise, atol=2e-6)
    np.testing.assert_allclose(merged.observed, whole.observed, atol=2e-6)
    last = pickup(fitted, DISPLAY, seed=1, observed=mask, mask=mask, **rest)
    merged = before.merged(last, share * mask[..., None])
    np.testing.assert_allclose(merged.image[mask], whole.image[mask], atol=2e-6)
    assert np.array_equal(merged.image[~mask], before.image[~mask])
    views = [true_view(fitted, DISPLAY, eye, seed=1, **size, **s)[0] for s in (once, first, rest)]
    merged = views[1].merged(views[2], share)
    np.testing.assert_allclose(merged.replicates, views[0].replicates, atol=2e-6)
    np.testing.assert_allclose(merged.image, views[0].image, atol=2e-6)
    captures = [
        Capture(None, {RGBD: CapturedInput.of(parts)})
        for parts in (
            capture_parts(fitted, DISPLAY, seed=1, pixels_per_pitch=3, **s)
            for s in (once, first, rest)
        )
    ]
    merged = captures[1].merged(captures[2], share)
    np.testing.assert_allclose(merged.rgbd.color, captures[0].rgbd.color, atol=2e-6)
    for part, expected in zip(
        merged.inputs[RGBD].parts, captures[0].inputs[RGBD].parts, strict=True
    ):
        np.testing.assert_allclose(part.color, expected.color, atol=2e-6)


def test_few_samples_give_halves_alone(fitted):
    from inim.render.ground_truth import pickup, true_view

    mask, samples = observed_pixels(), {"spp": REPLICATES - 1, "seed": 1}
    assert pickup(fitted, DISPLAY, observed=mask, **samples).observed is None
    eye = Viewpoint("eye", 5, -4, 200)
    assert true_view(fitted, DISPLAY, eye, pixels_per_lens=5, **samples)[0].replicates is None


def noisy_capture() -> CapturedInput:
    """A step in depth with noise of 0.05 in the colours of each part."""
    random, shape, pixel_mm = np.random.default_rng(1), DISPLAY.capture_shape(4), 0.25
    depth = np.full(shape, 20, np.float32)
    depth[:, : shape[1] // 2] = 8
    colours = np.float32(0.5) + np.float32(0.05) * random.normal(0, 1, (REPLICATES, *shape, 3))
    covered = np.ones(shape, bool)
    return CapturedInput.of([RGBD(c.astype(np.float32), depth, covered, pixel_mm) for c in colours])


def generated(algorithm: str | Algorithm, captured: CapturedInput) -> NoisyEIA:
    rgbd = captured.rgbd
    handle = GeneratorHandle(algorithm, DISPLAY, rgbd.shape, rgbd.pixel_mm)
    return generate.function(handle, Capture(None, {RGBD: captured}), observed_pixels()).eia


@pytest.mark.parametrize("algorithm", ["template", "template:samples=1:colour=nearest", "gu2020"])
def test_a_generator_s_replicates_are_its_eias_of_the_capture_s_parts(algorithm):
    captured, mask = noisy_capture(), observed_pixels()
    eia = generated(algorithm, captured)
    assert isinstance(eia, NoisyEIA)
    of_parts = np.stack([generate_once(p, DISPLAY, algorithm)[mask] for p in captured.parts])
    if "nearest" in algorithm:
        assert np.array_equal(eia.observed, of_parts)
    # The variance of a root is 0.05^2 / (4 * 0.5); the EIA's part of it is at most that.
    np.testing.assert_allclose(eia.observed, of_parts, atol=0.02)
    assert eia.observed.mean() == pytest.approx(0.5, abs=3e-4)
    assert np.abs(eia.observed.mean(axis=0) - eia.image[mask]).mean() < 0.05**2 / 2 / REPLICATES


@pytest.mark.parametrize("follows", ["depth", "colour", "chance"])
def test_another_package_s_eia_has_replicates_if_its_sources_ignore_the_noise(follows):
    random, captured = np.random.default_rng(2), noisy_capture()

    class Theirs(SourceGenerator):
        def find(self, rgbd):
            sources = find_sources(rgbd, self.display, "gu2020")
            moved = {"depth": 0, "colour": rgbd.color[0, 0, 0] * 1e6, "chance": random.integers(99)}
            return np.where(sources >= 0, (sources + int(moved[follows])) % rgbd.depth_mm.size, -1)

    eia = generated(Algorithm("theirs", Theirs, options={}), captured)
    if follows == "depth":
        expected = generated("gu2020:colour=nearest", captured)
        assert np.array_equal(eia.observed, expected.observed)
        assert np.array_equal(eia.noise, expected.noise)
    else:
        assert eia.observed is None and eia.noise.any()
