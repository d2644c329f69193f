"""Computation by bands of rows has no seams: the same bits as in one piece."""

import math
from collections.abc import Iterable

import numpy as np
import pytest

from inim.image.color import srgb_from_linear
from inim.scores import metrics
from inim.scores.metrics.flip import FLIP_REACH
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
    light = [np.clip(p, 0, 1) for p in (first, second)]
    for metric in metrics.all_metrics():
        local = metrics.score_maps(first, second, [metric.key])[metric.key]
        whole = metric.function(*(light if metric.takes_linear else codes))
        assert np.array_equal(local, whole), metric.key
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
