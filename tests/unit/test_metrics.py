"""Metrics of other packages: announced like generators, scored like the project's own."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from inim.image.color import srgb_from_linear
from inim.image.noisy_image import NoisyImage
from inim.scores import metrics
from inim.scores.metrics import Metric
from inim.scores.regression.scores import ScoreEstimate, compare_scores, view_scores
from inim.system.errors import UsageError


def absolute(reference: np.ndarray, test: np.ndarray) -> float:
    return float(np.abs(reference - test).mean())


def absolute_map(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    return np.abs(reference - test).mean(axis=-1)


def lower(name: str, function: Callable, **more: object) -> Metric:
    return Metric(name, function, better="lower", tolerance=0.01, **more)


def two(rng: np.random.Generator, rows: int = 60, columns: int = 48) -> tuple[np.ndarray, ...]:
    return tuple(rng.random((rows, columns, 3)).astype(np.float32) for _ in range(2))


def test_score_of_another_package_is_listed_with_the_own_ones(announce):
    a, b = two(np.random.default_rng(1))
    before = metrics.score(a, b)
    announce(mae=lower("mae", absolute), maemap=lower("maemap", absolute_map, has_relic_score=True))
    scores = metrics.score(a, b)
    assert [*scores] == ["ssim", "psnr_db", "flip", "mae", "maemap"]
    assert {key: scores[key] for key in before} == before
    expected = absolute(srgb_from_linear(a), srgb_from_linear(b))
    assert scores["mae"] == expected
    assert scores["maemap"] == pytest.approx(expected, rel=1e-6)
    mask = np.zeros(a.shape[:2], bool)
    mask[:9] = True
    on_relic = absolute(srgb_from_linear(a[:9]), srgb_from_linear(b[:9]))
    assert metrics.score(a, b, mask)["maemap_on_relic"] == pytest.approx(on_relic, rel=1e-6)
    assert "mae_on_relic" not in metrics.score(a, b, mask)


def test_map_in_parts_is_the_map_of_the_whole(announce):
    a, b = two(np.random.default_rng(2))
    b[:30] = a[:30]
    shapes = []

    def local(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
        shapes.append(reference.shape[0])
        return absolute_map(reference, test)

    announce(part=lower("part", local, reach=0), whole=lower("whole", absolute_map))
    scores = metrics.score_maps(a, b, ["part", "whole"])
    assert np.array_equal(scores["part"], scores["whole"])
    assert sum(shapes) == 30


def raise_lines(reference: np.ndarray, test: np.ndarray) -> float:
    raise RuntimeError("no such\nweights")


def leave(reference: np.ndarray, test: np.ndarray) -> float:
    raise SystemExit(0)


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (raise_lines, "failed: RuntimeError: no such weights"),
        (leave, "failed: SystemExit: 0"),
        (lambda a, b: math.nan, "failed: ValueError: the result is NaN"),
        (lambda a, b: np.full(a.shape[:2], np.nan), "failed: ValueError: the result is NaN"),
        (lambda a, b: "0.5", "failed: TypeError"),
        (lambda a, b: None, "failed: TypeError"),
        (lambda a, b: np.zeros(a.shape), "the result has the shape (60, 48, 3), not (60, 48)"),
    ],
)
def test_any_fault_of_a_function_is_one_line(announce, function, words):
    announce(bad=lower("bad", function))
    with pytest.raises(UsageError) as raised:
        metrics.score(*two(np.random.default_rng(4)))
    assert str(raised.value).startswith("metric 'bad' ")
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("registered", "words"),
    [
        (absolute, "is a function; register an inim.scores.metrics.Metric"),
        (lower("other", absolute), "has the name 'other'"),
    ],
)
def test_announced_objects_must_be_metrics_of_that_name(announce, registered, words):
    announce(mine=registered)
    with pytest.raises(UsageError, match=f"^metric 'mine' {words}"):
        metrics.all_metrics()


@pytest.mark.parametrize("wrong", [0, 1])
def test_integers_are_refused_with_the_conversion(wrong):
    images = [np.zeros((16, 16, 3), np.uint8 if n == wrong else np.float32) for n in range(2)]
    with pytest.raises(UsageError, match=r"(reference|test) image is uint8; .*linear_from_srgb"):
        metrics.score(*images)


def halves(rng: np.random.Generator, image: np.ndarray, noise: float) -> NoisyImage:
    return NoisyImage.from_halves(
        *((image + rng.normal(0, noise, image.shape)).astype(np.float32) for _ in range(2))
    )


def test_score_without_a_map_is_as_sure_as_the_same_with_one(announce):
    announce(plain=lower("plain", absolute), local=lower("local", absolute_map))
    rng = np.random.default_rng(6)
    scene = rng.uniform(0.3, 0.6, (160, 192, 3)).astype(np.float32)
    test = np.clip(scene + rng.normal(0, 0.05, scene.shape), 0, 1).astype(np.float32)
    ratios = []
    for _ in range(12):
        pair = halves(rng, scene, 0.03), halves(rng, test, 0.03)
        scores = view_scores(*pair, keys=["plain", "local"])
        assert scores["plain"].plain == pytest.approx(scores["local"].plain, rel=1e-6)
        assert scores["plain"].bias == pytest.approx(scores["local"].bias, rel=0.5)
        assert scores["plain"].freedom == scores["plain"].value_freedom == 8
        ratios.append(
            [
                (getattr(scores["plain"], error) / getattr(scores["local"], error)) ** 2
                for error in ("error", "value_error")
            ]
        )
    # Each is a chi-square of 8 degrees over its mean, whose relative error is 1/2: 0.14 of twelve.
    np.testing.assert_allclose(np.mean(ratios, axis=0), 1, atol=0.45)


def test_tolerance_is_the_metrics_own(announce):
    def verdict(change: float) -> bool:
        old, new = (ScoreEstimate(v, 0.0, 8.0, 0.0) for v in (0.5, 0.5 + change))
        name = "hue_to_reference_deg"
        (check,) = compare_scores({"a/left": {name: old}}, {"a/left": {name: new}})
        assert (check.unit, check.name) == (
            "deg",
            "a/left: Hue angle to reference against the baseline",
        )
        return check.passed

    announce(hue=Metric("hue", absolute, unit="deg", label="Hue angle", tolerance=0.25))
    assert verdict(0.24)
    assert not verdict(0.26)
    assert not verdict(-0.26)


def test_score_whose_metric_is_gone_fails():
    scores = {"a/left": {"lpips_to_reference": ScoreEstimate(0.5, 0.0, 8.0, 0.0)}}
    (check,) = compare_scores(scores, scores)
    assert not check.passed
    assert check.detail == "its metric is not installed"
