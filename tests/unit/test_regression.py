"""Statistics of regression checks, against other methods and simulated noise of known law."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from inim.image.noisy_image import NoisyImage
from inim.scores.metrics import find
from inim.scores.metrics.psnr import psnr_db
from inim.scores.regression.comparison import (
    compare_noise,
    compare_pictures,
)
from inim.scores.regression.fingerprints import (
    compare_fingerprints,
    fingerprint,
    picture_sha256,
    reference_input,
    sampled_pixels,
)
from inim.scores.regression.scores import (
    ScoreEstimate,
    compare_scores,
    is_above,
    view_scores,
)
from inim.scores.regression.tiles import eia_tile, tile_statistics, view_tile
from inim.scores.regression.verdict import (
    binomial_interval,
    freedom_of_sum,
    judge,
    sidak,
    welch_half_width,
    welch_p_value,
)
from tests.conftest import small_display

# Of the reference input on a display of 12 x 10 lenses: whole numbers and single divisions only.
SHA256 = "f2f0938f306bcae96356de2e46dec045be511a7a0ff289a43ca3e930eac147d5"

# --- Inference, against SciPy -------------------------------------------------------------------


def test_sidak_s_level_makes_the_family_s_whole():
    assert 1 - (1 - sidak(0.05, 1000)) ** 1000 == pytest.approx(0.05)
    assert sidak(0.05, 1) == pytest.approx(0.05)


def test_welch_s_test_agrees_with_scipy_s():
    rng = np.random.default_rng(1)
    a, b = rng.normal(0, 1, 9), rng.normal(0.8, 3, 14)
    sides = [np.asarray(x) for x in (stats.sem(a), len(a) - 1, stats.sem(b), len(b) - 1)]
    expected = stats.ttest_ind(b, a, equal_var=False)
    difference = np.asarray(b.mean() - a.mean())
    assert welch_p_value(difference, *sides) == pytest.approx(expected.pvalue)
    low, high = expected.confidence_interval(0.99)
    assert 2 * welch_half_width(*sides, 0.01) == pytest.approx(high - low)


def test_noiseless_means_differ_surely_or_not_at_all():
    zeros, ones = np.zeros(2), np.ones(2)
    p = welch_p_value(np.array([0.0, 1e-9]), zeros, ones, zeros, ones)
    assert p.tolist() == [1.0, 0.0]


def test_binomial_interval_agrees_with_scipy_s():
    for count in (0, 3, 40):
        expected = stats.binomtest(count, 40).proportion_ci(0.99, method="exact")
        assert binomial_interval(count, 40, 0.01) == pytest.approx((expected.low, expected.high))


def test_freedom_of_a_sum_is_the_number_of_its_terms_when_they_are_alike():
    rng = np.random.default_rng(2)
    terms = np.square(rng.normal(size=(4000, 50)))
    freedom = freedom_of_sum(terms.sum(axis=1), np.square(terms).sum(axis=1))
    assert np.median(freedom) == pytest.approx(50, rel=0.1)
    alone = np.zeros(50)
    alone[7] = 3.0
    assert freedom_of_sum(alone.sum(), np.square(alone).sum()) == 1.0


# --- Tiles --------------------------------------------------------------------------------------


def rendered(rng, scene, noise):
    """Two halves of a picture: the scene with independent noise."""
    return [(scene + noise * rng.normal(size=scene.shape)).astype(np.float32) for _ in "ab"]


@pytest.fixture(scope="module")
def scene():
    """A smooth picture with an edge, 64 x 80."""
    y, x = np.mgrid[0:64, 0:80]
    grey = 0.3 + 0.2 * np.sin(x / 9) * np.cos(y / 7) + 0.2 * (x > 41)
    return np.stack([grey, 0.8 * grey, 0.5 * grey], axis=-1)


def noisy(rng, scene, noise):
    return NoisyImage.from_halves(*rendered(rng, scene, noise))


def statistics(rng, scene, noise=0.05):
    return {"truth/a": tile_statistics(noisy(rng, scene, noise), view_tile(scene.shape[:2]))}


@pytest.mark.parametrize("repeat", [1, 4])
def test_errors_are_as_large_as_the_means_really_vary(scene, repeat):
    """Also where neighbours show the same pixel, as in the EIA of a generator."""
    rng = np.random.default_rng(5)
    exact = scene.reshape(4, 16, 5, 16, 3).mean(axis=(1, 3))
    p = []
    for _ in range(100):
        noise = 0.1 * rng.normal(size=(2, 64 // repeat, 80 // repeat, 3))
        halves = scene + noise.repeat(repeat, axis=1).repeat(repeat, axis=2)
        tiles = tile_statistics(NoisyImage.from_halves(*halves), (16, 16), generated=repeat > 1)
        p.append(2 * stats.t.sf(np.abs(tiles.mean - exact) / tiles.mean_error, tiles.freedom))
    for level in (0.3, 0.1, 0.02):
        assert 0.4 * level < np.mean(np.array(p) < level) < 1.15 * level


def test_tile_of_an_eia_is_one_elemental_image_or_a_block_of_them():
    assert eia_tile((408, 408), (24, 24)) == (17, 17)
    assert eia_tile((1088, 1088), (64, 64)) == (34, 34)
    assert eia_tile((1080, 2400), (68, 152)) == (48, 79)  # 15.9 and 15.8 pixels per lens


# --- Verdicts on pictures -----------------------------------------------------------------------


def test_fresh_noise_is_no_change(scene):
    """Also where one side has far fewer samples. 0.3 alarms are expected, 2 are allowed."""
    rng = np.random.default_rng(7)
    old = statistics(rng, scene)
    noises = [0.05] * 200 + [0.3] * 100
    verdicts = [compare_pictures(old, statistics(rng, scene, noise))[0] for noise in noises]
    assert sum(not verdict.passed for verdict in verdicts) <= 2


def test_firefly_is_no_change(scene):
    rng = np.random.default_rng(9)
    first, second = rendered(rng, scene, 0.02)
    first[20, 30] += 500
    by_picture = {"truth/a": tile_statistics(NoisyImage.from_halves(first, second), (8, 8))}
    assert compare_pictures(statistics(rng, scene, 0.02), by_picture)[0].passed


@pytest.mark.parametrize(
    "plant",
    [
        lambda s: (s + np.roll(s, 1, axis=1)) / 2,
        lambda s: s[:, ::-1],
        lambda s: np.power(s, 2.2),
        lambda s: s * np.array([1, 1.05, 1]),
        lambda s: s + 0.15 * (np.indices(s.shape).sum(axis=0) % 2 * 2 - 1) * _spot(s),
    ],
    ids=["half a pixel", "mirrored", "gamma twice", "green by 5 %", "pattern of mean 0 in a tile"],
)
def test_planted_change_of_a_picture_is_found(scene, plant):
    rng = np.random.default_rng(10)
    changed = statistics(rng, plant(scene), 0.02)
    verdict = compare_pictures(statistics(rng, scene, 0.02), changed)[0]
    assert not verdict.passed
    assert abs(verdict.value) > verdict.limit
    assert verdict.p_value < 1e-6


def _spot(scene):
    spot = np.zeros(scene.shape)
    spot[16:24, 16:24] = 1
    return spot


def test_change_below_one_code_is_none_however_sure(scene):
    old, new = (
        {"truth/a": tile_statistics(NoisyImage.from_image(s), (8, 8))}
        for s in (scene, scene * 1.008)
    )
    verdict = compare_pictures(old, new)[0]
    assert verdict.passed
    assert 0.5 < verdict.value < 1
    assert verdict.p_value == 0


@pytest.mark.parametrize("flaw", ["missing", "nan", "smaller"])
def test_picture_that_is_not_there_fails(scene, flaw):
    rng = np.random.default_rng(11)
    old, bad = statistics(rng, scene), scene.copy()
    if flaw == "nan":
        bad[30, 30, 1] = np.nan
    new = {} if flaw == "missing" else statistics(rng, bad[:-8] if flaw == "smaller" else bad)
    verdict = compare_pictures(old, new)[0]
    assert not verdict.passed
    assert verdict.detail


def test_noise_of_half_the_samples_fails_and_of_a_twentieth_fewer_does_not(scene):
    rng = np.random.default_rng(12)
    old = statistics(rng, scene, 0.05)
    for share, passed in ((0.95, True), (0.5, False), (2.0, True)):
        check = compare_noise(old, statistics(rng, scene, 0.05 / math.sqrt(share)))
        assert check.passed is passed
        assert check.value == pytest.approx(1 / math.sqrt(share), rel=0.05)
        assert check.interval[0] <= check.value <= check.interval[1]


# --- Scores -------------------------------------------------------------------------------------


SCORES = pytest.mark.parametrize(
    "names", [("ssim", "psnr_db"), pytest.param(("flip",), marks=pytest.mark.slow)]
)


@SCORES
@pytest.mark.parametrize("noise", [0.005, 0.03])
def test_score_s_errors_are_as_large_as_the_score_really_varies(scene, names, noise):
    """Rather too large than too small: these pixels are not coupled by lenses.

    Of both errors, of the whole and on the relic.
    """
    rng = np.random.default_rng(13)
    big = np.tile(scene, (2, 2, 1))
    generated = np.roll(big, 1, axis=0)
    region = np.zeros(big.shape[:2], bool)
    region[20:100, 30:130] = True
    scores = [
        view_scores(noisy(rng, big, noise), noisy(rng, generated, noise), region, names)
        for _ in range(40)
    ]
    ratios = {
        f"{key} {kind}": np.sqrt(np.mean(np.square([getattr(s[key], error) for s in scores])))
        / np.std([getattr(score[key], kind) for score in scores])
        for key in scores[0]
        for kind, error in (("plain", "error"), ("value", "value_error"))
    }
    print(noise, ratios)
    assert all(0.85 < ratio < 1.6 for ratio in ratios.values()), ratios


@SCORES
@pytest.mark.parametrize("on_relic", [False, True])
def test_score_free_of_noise_is_that_of_pictures_without(scene, names, on_relic):
    """Less than a tenth of the noise's effect is left in SSIM, less than half in FLIP.

    PSNR's logarithm is straightened; FLIP takes a root of small errors.
    """
    rng = np.random.default_rng(16)
    generated = np.roll(scene, 1, axis=0)
    region = np.zeros(scene.shape[:2], bool)
    region[20:50, 10:40] = True
    clean = view_scores(
        NoisyImage.from_image(scene), NoisyImage.from_image(generated), region, names
    )
    scores = [
        view_scores(noisy(rng, scene, 0.005), noisy(rng, generated, 0.005), region, names)
        for _ in range(30)
    ]
    for metric in map(find, names):
        key = metric.on_relic_key if on_relic else metric.key
        lost, left = (
            np.mean([getattr(score[key], kind) for score in scores]) - clean[key].plain
            for kind in ("plain", "value")
        )
        share = {"ssim": 0.1, "psnr": 0.2, "flip": 0.5}[metric.name]
        assert abs(left) < share * abs(lost), key


@pytest.mark.parametrize("bright", [False, True], ids=["gaussian", "rare bright samples"])
def test_interval_contains_the_score_without_noise(scene, bright):
    """Noise that biases SSIM by some hundredths; 24 draws, of which at most two may miss."""
    rng = np.random.default_rng(21)
    generated = np.roll(scene, 1, axis=0)
    clean = view_scores(
        NoisyImage.from_image(scene), NoisyImage.from_image(generated), None, ("ssim", "psnr_db")
    )

    def half(image):
        draws = rng.normal(size=(*image.shape[:2], 1))
        if bright:  # variance 1, and rarely far above
            draws = (rng.exponential(size=draws.shape) ** 2 / 2 - 1) / math.sqrt(5)
        return (image + 0.008 * draws).astype(np.float32)

    def with_noise(image):
        return NoisyImage.from_halves(half(image), half(image))

    misses = dict.fromkeys(clean, 0)
    for _ in range(24):
        scores = view_scores(with_noise(scene), with_noise(generated), None, [*clean])
        for key, score in scores.items():
            low, high = score.interval
            misses[key] += not low <= clean[key].plain <= high
    assert max(misses.values()) <= 2, misses


def test_score_is_above_another_by_more_than_the_noise_of_both():
    low, high = (
        ScoreEstimate(value, 9.0, 1, 0.0, value, value_error=0.001, value_freedom=30)
        for value in (0.900, 0.904)
    )
    assert is_above(high, low)
    assert not is_above(low, high)
    assert not is_above(high, low, tests=100)
    assert not is_above(replace(high, extension=(0.002, 0)), low), "it may keep a bias"
    assert is_above(replace(high, extension=(0, 0.002)), low)


@pytest.mark.parametrize(
    ("noise", "repeats"),
    [
        (0.05, 10),
        pytest.param(0.01, 30, marks=pytest.mark.slow),
        pytest.param(0.05, 30, marks=pytest.mark.slow),
    ],
)
def test_bias_predicts_the_effect_of_fewer_samples_on_flip(scene, noise, repeats):
    """A fifth fewer samples: a root of small errors makes FLIP answer to noise most unevenly."""
    generated = np.roll(scene, 1, axis=0)

    def scores(noise):
        rng = np.random.default_rng(15)  # of either noise the same draws: their difference is sure
        draws = ((noisy(rng, scene, noise), noisy(rng, generated, noise)) for _ in range(repeats))
        flips = [view_scores(*pair, keys=["flip"])["flip"] for pair in draws]
        return (np.mean([getattr(flip, key) for flip in flips]) for key in ("plain", "bias"))

    (old, old_bias), (new, new_bias) = scores(noise), scores(noise * math.sqrt(1.25))
    expected = (old_bias + new_bias / 1.25) / 2 * 0.25
    assert new - old > 5e-4
    assert expected == pytest.approx(new - old, rel=0.3)


def compared(old, new, **more):
    return compare_scores({"a/left": {"ssim": old}}, {"a/left": {"ssim": new}}, **more)[0]


def test_score_beyond_noise_and_size_fails_in_both_directions():
    sure = ScoreEstimate(0.90, 0.0005, 30, 0.0)
    for value, passed in ((0.90, True), (0.904, True), (0.88, False), (0.92, False)):
        assert compared(sure, ScoreEstimate(value, 0.0005, 30, 0.0)).passed is passed
    unsure = ScoreEstimate(0.88, 0.02, 30, 0.0)
    assert compared(sure, unsure).passed


def test_score_moved_by_fewer_samples_alone_passes():
    old, new = ScoreEstimate(0.9, 1e-4, 50, -0.1), ScoreEstimate(0.89, 1e-4, 50, -0.11)
    assert not compared(old, new).passed
    assert compared(old, new, noise_ratio=math.sqrt(1.1)).passed


def test_score_that_is_no_number_or_missing_fails():
    sure = ScoreEstimate(0.90, 0.0005, 30, 0.0)
    assert not compared(sure, ScoreEstimate(math.nan, 0.0005, 30, 0.0)).passed
    assert not compared(sure, ScoreEstimate(0.9, math.nan, 30, 0.0)).passed
    assert not compare_scores({"a/left": {"ssim": sure}}, {"a/right": {"ssim": sure}})[0].passed


def test_identical_pictures_stay_identical_and_nothing_else():
    same = ScoreEstimate(math.inf, 0.0, 1.0, 0.0)
    assert compared(same, same).passed
    assert not compared(same, ScoreEstimate(40.0, 0.1, 9, 0.0)).passed


def test_interval_is_student_s_and_extends_towards_the_correction_of_the_bias(scene):
    """SSIM without replicates: noise lowers it, and up to 0.6 of the correction may be missing."""
    rng = np.random.default_rng(22)
    pair = noisy(rng, scene, 0.03), noisy(rng, np.roll(scene, 1, axis=0), 0.03)
    score = view_scores(*pair, None, ["ssim"])["ssim"]
    low, high = stats.t.interval(0.95, score.value_freedom, score.value, score.value_error)
    assert score.bias < -0.01
    assert score.interval == pytest.approx((low, min(high - 0.6 * score.bias, 1)))


def test_corrected_psnr_is_that_of_the_corrected_squared_error():
    """Noise is a third of the squared error: 0.003 instead of 0.002."""
    shape, rng = (96, 96, 3), np.random.default_rng(3)
    grey = np.full(shape, 0.5, np.float32)
    other = grey + np.float32(0.03)
    noise = [(0.02 * rng.normal(size=shape)).astype(np.float32) for _ in range(2)]
    test = NoisyImage.from_halves(*(other + half for half in noise))
    score = view_scores(NoisyImage.from_image(grey), test, None, ["psnr_db"])["psnr_db"]
    assert score.plain < score.value - 0.3
    assert score.value == pytest.approx(psnr_db(grey, other), abs=0.1)


# --- The reference input ------------------------------------------------------------------------


def test_sampled_pixels_are_in_every_lens_and_unique():
    for display in (small_display(24, 24, 17), small_display(16, 12, 17), small_display(9, 7, 20)):
        at = sampled_pixels(display)
        assert len(set(at.tolist())) == len(at) == min(8192, display.lensed.sum())
        row, column = np.divmod(at, display.eia_shape[1])
        lens_pixels = display.eia_shape[0] // display.lens_rows
        counts = np.bincount((row // lens_pixels) * display.lens_columns + column // lens_pixels)
        assert counts.min() > 0.4 * counts.mean()


def test_reference_input_is_the_same_everywhere_and_covers_the_depth_range():
    display = small_display(12, 10, 17)
    rgbd = reference_input(display, (80, 96), 0.2)
    assert picture_sha256(rgbd) == SHA256
    low, high = display.depth_range_mm
    depth = (rgbd.depth_mm[rgbd.covered] - low) / (high - low)
    assert 0 < depth.min() < 0.1
    assert 0.9 < depth.max() < 1
    assert 0.6 < rgbd.covered.mean() < 0.95
    same = (rgbd.color[:, 1:] == rgbd.color[:, :-1]).all(axis=-1) & rgbd.covered[:, 1:]
    assert not (same & rgbd.covered[:, :-1]).any()


def printed(eia, *, exact):
    display = small_display(12, 10, 17)
    return fingerprint(reference_input(display, (80, 96), 0.2), eia, display, exact=exact)


@pytest.mark.parametrize("exact", [True, False])
def test_changed_pixels_are_counted_and_an_exact_path_may_have_none(exact):
    display, rng = small_display(12, 10, 17), np.random.default_rng(17)
    eia = rng.random((*display.eia_shape, 3), np.float32)
    old = {"a": printed(eia, exact=exact)}
    assert compare_fingerprints(old, {"a": printed(eia.copy(), exact=exact)})[0].passed
    rounded = compare_fingerprints(old, {"a": printed(eia + np.float32(1e-6), exact=exact)})[0]
    assert rounded.passed is not exact
    changed = np.where(rng.random(eia.shape[:2])[..., None] < 0.01, 1 - eia, eia)
    verdict = compare_fingerprints(old, {"a": printed(changed, exact=exact)})[0]
    assert not verdict.passed
    assert verdict.interval[0] <= 1 <= verdict.interval[1]
    assert (verdict.unit, verdict.limit) == ("%", 0 if exact else pytest.approx(0.1))
    assert not compare_fingerprints(old, {})[0].passed


# --- Verdicts -----------------------------------------------------------------------------------


def test_no_score_to_compare_is_not_comparable():
    verdict, checks = judge([], inputs_changed=False, allow_changed_inputs=True)
    assert verdict == "not comparable"
    assert [check.fails_run for check in checks] == [True]
