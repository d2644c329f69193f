"""Computation by bands of rows has no seams: the same bits as in one piece."""

import math
import tracemalloc
from collections.abc import Iterable

import numpy as np
import pytest

from inim.image.color import srgb_from_linear, to_srgb
from inim.image.noisy_image import NoisyImage
from inim.scores import metrics
from inim.scores.metrics.flip import FLIP_REACH
from inim.scores.regression.tiles import tile_statistics
from inim.system.row_bands import row_bands

# Pixels of a band: single rows, a few, one less than all, all.
BANDS = [1, 200, 700, 40 * 37 - 1, 2**20]


@pytest.fixture(params=BANDS)
def band(request, monkeypatch) -> int:
    monkeypatch.setattr("inim.system.row_bands._PIXELS", request.param)
    monkeypatch.setattr("inim.scores.regression.tiles._PIXELS_AT_ONCE", request.param)
    monkeypatch.setattr("inim.generators.base._PIXELS_AT_ONCE", request.param)
    return request.param


def pictures(rows: int = 40, columns: int = 37) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(rows)
    first = random.random((rows, columns, 3), np.float32)
    return first, np.clip(first + random.normal(0, 0.1, first.shape), -0.1, 1.2).astype(np.float32)


@pytest.mark.parametrize(("rows", "columns"), [(1, 5), (7, 3), (40, 37), (5, 4000)])
def test_bands_are_the_rows_once_each_in_order(rows, columns, band):
    bands = list(row_bands(rows, columns))
    assert [r for b in bands for r in range(rows)[b]] == list(range(rows))
    assert all((b.stop - b.start) * columns <= max(band, columns) for b in bands)


def whole_ssim_map(pair: Iterable[np.ndarray]) -> np.ndarray:
    """scikit-image's map of two linear pictures, in one piece and in double precision."""
    from skimage.metrics import structural_similarity

    return structural_similarity(
        *(srgb_from_linear(p).astype(np.float64) for p in pair), data_range=1.0, channel_axis=-1,
        gaussian_weights=True, sigma=1.5, use_sample_covariance=False, full=True,
    )[1].mean(axis=-1)  # fmt: skip


@pytest.mark.parametrize("rows", [11, 12, 15, 16, 17, 40])
def test_ssim_is_that_of_scikit_image_on_the_whole_picture(rows, band):
    pair = pictures(rows)
    assert metrics.ssim_map(*pair) == pytest.approx(whole_ssim_map(pair), abs=1e-5)


@pytest.mark.parametrize(
    "seed", [pytest.param(n, marks=pytest.mark.slow) if n >= 3 else n for n in range(40)]
)
def test_maps_near_a_difference_are_those_of_the_whole_picture(seed, band):
    """Equal ground round a difference is left out; corners, edges, single pixels, two far apart."""
    from flip_evaluator import evaluate

    random = np.random.default_rng(seed)
    first = random.random((70, 64, 3), np.float32) * random.choice([0, 1])
    second = first.copy()
    for _ in range(random.integers(0, 3)):
        rows, columns = (np.sort(random.choice([0, 1, 9, 33, 50, n - 1, n], 2, replace=False))
                         for n in first.shape[:2])  # fmt: skip
        second[slice(*rows), slice(*columns)] += random.normal(0, 0.1, 3)
    codes = [srgb_from_linear(p) for p in (first, second)]
    for metric in metrics.all_metrics():
        local = metrics.score_maps(first, second, [metric.key])[metric.key]
        assert np.array_equal(local, metric.function(*codes)), metric.key
    expected = whole_ssim_map((first, second))
    assert metrics.ssim_map(first, second) == pytest.approx(expected, abs=1e-4)
    error = evaluate(*codes, "LDR", True, False, False, {"ppd": 67.0})[0].reshape(70, 64)
    assert metrics.flip_map(first, second) == pytest.approx(error, abs=1e-4)  # roots of roundings
    # On even ground both round the strength of edges differently, and FLIP takes its root.
    assert metrics.flip(first, second) == pytest.approx(error.mean(dtype=np.float64), abs=1e-5)


def test_filters_reach_no_farther_than_their_declared_radius():
    """A single pixel at FLIP's greatest reach: one less would lose some of it."""
    first = np.full((80, 80, 3), 0.2, np.float32)
    second = first.copy()
    second[40, 40] = 1, 0, 0.2
    away = np.abs(np.argwhere(metrics.flip_map(first, second) > 0) - 40).max()
    assert away == FLIP_REACH
    away = np.abs(np.argwhere(metrics.ssim_map(first, second) < 1) - 40).max()
    assert away == metrics.SSIM_WINDOW // 2


def test_psnr_is_the_same_in_any_bands(band, monkeypatch):
    pair = pictures()
    difference = np.subtract(*(srgb_from_linear(p).astype(np.float64).ravel() for p in pair))
    error = math.fsum((difference**2).tolist()) / difference.size
    assert metrics.psnr_db(*pair) == pytest.approx(-10 * math.log10(error), rel=1e-14)
    psnr = metrics.psnr_db(*pair)
    monkeypatch.setattr("inim.system.row_bands._PIXELS", 2**30)
    assert metrics.psnr_db(*pair) == psnr


@pytest.mark.parametrize("generated", [False, True])
def test_statistics_of_tiles_are_those_of_each_tile_alone(generated, band):
    """Sums of a tile know nothing of the others; only what is moderated does, so not here."""
    palette = pictures(2, 40)
    source = np.random.default_rng(3).integers(0, 80, (40, 37))
    halves = [p.reshape(-1, 3)[source] for p in palette] if generated else pictures()
    statistics = tile_statistics(NoisyImage.from_halves(*halves), (9, 8), generated=generated)
    assert statistics.mean.shape == (5, 5, 3)
    for r in range(5):
        for c in range(5):
            at = slice(9 * r, 9 * r + 9), slice(8 * c, 8 * c + 8)
            a, b = (h[at].astype(np.float64) for h in halves)
            assert statistics.mean[r, c] == pytest.approx(((a + b) / 2).mean(axis=(0, 1)), rel=1e-6)
            assert statistics.power[r, c] == pytest.approx((a * b).mean(), rel=1e-6)


@pytest.mark.parametrize(
    ("score", "copies"),
    [
        (lambda a, b: metrics.ssim(a, b), 0.6),  # the map alone is a third
        (lambda a, b: metrics.psnr_db(a, b), 0.2),
        (lambda a, b: to_srgb(a), 0.4),  # the codes alone are a quarter
        (lambda a, b: tile_statistics(NoisyImage.from_halves(a, b), (40, 40)), 0.6),
        (lambda a, b: tile_statistics(NoisyImage.from_image(a, b), (40, 40), generated=True), 0.6),
    ],
    ids=["ssim", "psnr", "codes", "tiles", "generated tiles"],
)
def test_an_eia_is_scored_in_less_memory_than_its_own(score, copies, monkeypatch):
    """Bands of a hundredth of it; in one piece they took up to ten times the EIA."""
    pair = pictures(2000, 500)
    for module in ("inim.system.row_bands._PIXELS", "inim.scores.regression.tiles._PIXELS_AT_ONCE"):
        monkeypatch.setattr(module, 10_000)
    score(*(p[:40, :40] for p in pair))  # imports, compiled kernels
    tracemalloc.start()
    try:
        score(*pair)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < copies * pair[0].nbytes
