"""Scores against their definitions in float64, closed forms and invariances."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from inim.apps.stress.oracles.colours import code_from_linear
from inim.apps.stress.relation import EPS32, Deviation, difference, excess, is_true, relation
from inim.scores import metrics
from inim.scores.metrics import Viewing, relic_region
from inim.scores.metrics.base import (
    left_out_changes,
    maps_of,
    mean_of_products,
    noise_free_maps,
)
from inim.scores.metrics.filters import separable_filter
from inim.scores.metrics.flip import FLIP_REACH
from inim.scores.metrics.flip import metric as flip_metric
from inim.scores.metrics.psnr import metric as psnr_metric
from inim.scores.metrics.ssim import metric as ssim_metric

_COVERS = "scores.metrics image.color"


def _images(seed: int = 0, shape: tuple[int, int] = (37, 41)) -> tuple[np.ndarray, np.ndarray]:
    """A picture with edges, texture and dark parts, in linear RGB, and a changed copy."""
    random = np.random.default_rng(seed)
    y, x = np.indices(shape)
    grey = 0.3 + 0.25 * ((x // 7 + y // 5) % 2) + 0.1 * np.sin(x / 1.3) * np.cos(y / 1.7)
    first = np.stack([grey, grey * 0.6 + 0.1, 0.02 + 0.3 * grey**2], axis=-1)
    second = np.roll(first, 1, axis=1) * 0.95 + 0.05 * random.random((*shape, 3))
    return first.astype(np.float32), second.astype(np.float32)


def _codes(linear: np.ndarray) -> np.ndarray:
    return code_from_linear(np.clip(linear.astype(float), 0, 1))


def _windows(image: np.ndarray) -> np.ndarray:
    """Weighted means over the Gaussian windows of 11 x 11 pixels inside an image, (R, C, ...)."""
    at = np.arange(-5, 6)
    weights = np.exp(-(at**2) / (2 * 1.5**2))
    weights /= weights.sum()
    view = np.lib.stride_tricks.sliding_window_view(image, (11, 11), axis=(0, 1))
    means: np.ndarray = np.einsum("...ij,i,j->...", view, weights, weights)
    return means


def _ssim(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """SSIM of codes by its definition, mean over colours, without the border."""
    a, b = _windows(first), _windows(second)
    var_a, var_b = _windows(first**2) - a**2, _windows(second**2) - b**2
    joint = _windows(first * second) - a * b
    c1, c2 = 0.01**2, 0.03**2
    values = (2 * a * b + c1) * (2 * joint + c2) / ((a**2 + b**2 + c1) * (var_a + var_b + c2))
    mean: np.ndarray = values.mean(axis=-1)
    return mean


@relation(
    "SSIM and PSNR", covers=_COVERS, limit=25, unit="1e-6", source="float32 windows; float64 means",
)  # fmt: skip
def _definitions(_: str, effort: int) -> Iterator[Deviation]:
    """Maps and scores are the definitions' in float64, also of the relic's region."""
    for seed in range(2 * effort):
        first, second = _images(seed, (37 + seed, 41))
        codes = _codes(first), _codes(second)
        expected = _ssim(*codes)
        own = metrics.ssim_map(first, second)
        yield difference("SSIM map", own[5:-5, 5:-5], expected, 1e-6)
        yield difference("SSIM", metrics.ssim(first, second), expected.mean(), 1e-6)
        squares = ((codes[0] - codes[1]) ** 2).mean(axis=-1)
        decibels = -10 * math.log10(squares.mean())
        yield difference("PSNR", metrics.psnr_db(first, second), decibels, 1e-5)
        region = np.zeros(first.shape[:2], bool)
        region[3:20, 11:36] = True
        scores = metrics.score(first, second, region)
        inner = region[5:-5, 5:-5]
        yield difference("SSIM on the relic", scores["ssim_on_relic"], expected[inner].mean(), 1e-6)
        on_relic = -10 * math.log10(squares[region].mean())
        yield difference("PSNR on the relic", scores["psnr_on_relic_db"], on_relic, 1e-5)
        whole = metrics.eia_scores(first, second)
        yield difference("EIA", (whole["ssim"], whole["psnr_db"]),
                         (expected.mean(), decibels), 1e-5)  # fmt: skip
        # Of constants a and b, only the comparison of means is left.
        a, b = np.float32([0.2, 0.5, 0.01]), np.float32([0.25, 0.1, 0.3])
        flat = np.ones((20, 20, 1), np.float32)
        x, y = _codes(a), _codes(b)
        means = (2 * x * y + 0.0001) / (x * x + y * y + 0.0001)
        yield difference("constants", metrics.ssim(a * flat, b * flat), means.mean(), 1e-6)


@relation(
    "invariances of scores", covers=_COVERS, limit=4, unit="1e-5", source="float32 sums",
)  # fmt: skip
def _invariances(_: str, effort: int) -> Iterator[Deviation]:
    """Equal images score best; mirrors, turns, exchange and channels change nothing."""
    first, second = _images(3)
    best = {"ssim": 1.0, "psnr_db": math.inf, "flip": 0.0}
    yield difference("identical", [metrics.score(first, first)[k] for k in best], [*best.values()])
    before = metrics.score(first, second)
    changes = {
        "mirrored": lambda v: v[:, ::-1],
        "upside down": lambda v: v[::-1],
        "turned": lambda v: np.rot90(v),
    }
    for name, change in changes.items():
        after = metrics.score(*(np.ascontiguousarray(change(v)) for v in (first, second)))
        yield difference(name, [after[k] for k in best], [before[k] for k in best], 1e-5)
    swapped = metrics.score(second, first)
    yield difference("exchanged", [swapped[k] for k in best], [before[k] for k in best], 1e-5)
    for key in ("ssim", "psnr_db"):
        other = metrics.score(first[..., ::-1], second[..., ::-1])[key]
        yield difference(f"channels: {key}", other, before[key], 1e-5)
    region = np.ones(first.shape[:2], bool)
    everywhere = metrics.score(first, second, region)
    for key, on_relic in (("ssim", "ssim_on_relic"), ("flip", "flip_on_relic")):
        yield difference(f"all of it: {key}", everywhere[on_relic], everywhere[key], 1e-6)
    # Whiter than white is white, and blacker than black is black.
    clipped = metrics.score(first * 3, second)
    yield difference("clipped", metrics.score(np.clip(first * 3, 0, 1), second)["ssim"],
                     clipped["ssim"], 1e-6)  # fmt: skip
    worse = [metrics.score(first, (1 - t) * first + t * second) for t in (0.1, 0.3, 1.0)]
    for key, sign in (("ssim", -1), ("psnr_db", -1), ("flip", 1)):
        yield is_true(f"farther is worse: {key}", np.diff([sign * s[key] for s in worse]) > 0)
    distance = 500.0
    degree = Viewing.of(0.25, (0, 300, 400), 100).pixels_per_degree
    yield difference("degree", degree, 2 * distance * math.tan(math.radians(0.5)) / 0.25, 1e-9)
    relic = np.zeros((30, 25), bool)
    relic[12, 9] = True
    expected = np.zeros_like(relic)
    expected[7:18, 4:15] = True
    yield difference("margin of the relic", relic_region(relic), expected)


@relation(
    "slopes of scores", covers="scores.metrics", limit=1, unit="1e-5 relative",
    source="central differences",
)  # fmt: skip
def _slopes(_: str, effort: int) -> Iterator[Deviation]:
    """The slope of a score that is not the mean of its map is its derivative."""
    for metric in metrics.all_metrics():
        if metric.score_from_mean is None:
            continue
        for mean in (1e-5, 1e-3, 0.04, 0.5):
            score, slope = metric.score_from_mean(mean)
            above, below = (metric.score_from_mean(mean * (1 + s))[0] for s in (1e-5, -1e-5))
            yield difference(
                f"{metric.key} at {mean:g}", slope * mean * 2e-5 / (above - below), 1.0, 1e-5
            )
            yield is_true(f"{metric.key} between", (below - score) * (above - score) < 0)


@relation(
    "maps in parts", covers=_COVERS, limit=2, unit="1e-6", source="the same sums of float32",
)  # fmt: skip
def _parts(_: str, effort: int) -> Iterator[Deviation]:
    """Maps are equal in bands of rows, and where images differ in a corner only."""
    first, second = _images(4, (90, 75))
    all_metrics = (ssim_metric, psnr_metric, flip_metric)
    corners = {"all": np.s_[:, :], "corner": np.s_[:9, :8], "pixel": np.s_[44:45, 30:31],
               "last": np.s_[-1:, -1:]}  # fmt: skip
    for name, part in corners.items():
        test = first.copy()
        test[part] = second[part]
        local = maps_of(all_metrics, first, test)
        whole = maps_of([replace(m, reach=None) for m in all_metrics], first, test)
        for key, values in local.items():
            yield difference(f"{name}: {key}", values, whole[key], 1e-6)
    yield difference("equal", maps_of([flip_metric], first, first)["flip"].max(), 0.0)
    reach = np.argwhere(maps_of([flip_metric], first, _with_dot(first))["flip"] > 0)
    yield excess("reach", np.abs(reach - (44, 30)).max(initial=0), FLIP_REACH)


def _with_dot(image: np.ndarray) -> np.ndarray:
    changed = image.copy()
    changed[44, 30] = (1, 0, 0)
    return changed


# XYZ of the sRGB primaries, as in the paper's supplement.
_XYZ = np.array([[0.4123907992, 0.3575843394, 0.1804807884],
                 [0.2126390059, 0.7151686788, 0.0721923154],
                 [0.0193308187, 0.1191947798, 0.9505321522]])  # fmt: skip


def _lab(linear: np.ndarray) -> np.ndarray:
    """Hunt-adjusted L*a*b* of linear sRGB colours, (n, 3), relative to the white of the matrix."""
    ratio = linear @ _XYZ.T / _XYZ.sum(axis=1)
    knee = 6 / 29
    curve = np.where(ratio > knee**3, np.cbrt(ratio), ratio / (3 * knee**2) + 4 / 29)
    lightness = 116 * curve[:, 1] - 16
    a, b = 500 * (curve[:, 0] - curve[:, 1]), 200 * (curve[:, 1] - curve[:, 2])
    return np.stack([lightness, a * lightness / 100, b * lightness / 100], axis=-1)


def _hyab(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    far = np.abs(_lab(first) - _lab(second))
    distance: np.ndarray = far[:, 0] + np.hypot(far[:, 1], far[:, 2])
    return distance


@relation(
    "FLIP", covers="scores.metrics image.color", limit=1, unit="1e-4",
    source="float32; Andersson et al. 2020",
)  # fmt: skip
def _flip(_: str, effort: int) -> Iterator[Deviation]:
    """Maps are those of two-dimensional kernels in float64; constants differ by HyAB."""
    colours = np.float32([(0, 0, 0), (1, 1, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0.2, 0.3, 0.25),
                          (0.21, 0.3, 0.25), (0.01, 0.0, 0.02), (0.9, 0.95, 0.2)])  # fmt: skip
    flat = np.ones((3, 3, 1), np.float32)
    largest = _hyab(np.eye(3)[1:2], np.eye(3)[2:])[0] ** 0.7
    for i, first in enumerate(colours):
        for second in colours[:i]:
            error = _hyab(first[None].astype(float), second[None].astype(float))[0] ** 0.7
            knee = 0.4 * largest
            part = 0.95 * error / knee
            if error >= knee:
                part = 0.95 + 0.05 * (error - knee) / (largest - knee)
            own = metrics.flip(first * flat, second * flat)
            yield difference(f"{first} {second}", own, min(part, 1.0), 1e-4)
    for seed in range(2 * effort):
        first, second = _images(seed, (24, 30))
        yield difference(f"map {seed}", metrics.flip_map(first, second),
                         _flip_map(first.astype(float), second.astype(float)), 1e-4)  # fmt: skip


def _flip_map(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """LDR-FLIP of linear RGB by two-dimensional kernels in float64, at 67 pixels per degree."""
    from scipy.ndimage import correlate

    ppd, matrix = 67.0, _XYZ / _XYZ.sum(axis=1, keepdims=True)
    opponent = np.array([[0, 116, 0], [500, -500, 0], [0, 200, -200]]) @ matrix

    def kernel(terms: tuple[tuple[float, float], ...]) -> np.ndarray:
        reach = math.ceil(3 * math.sqrt(0.04 / (2 * math.pi**2)) * ppd)
        y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1] / ppd
        values = sum(a * math.sqrt(math.pi / b) * np.exp(-(math.pi**2) * (x * x + y * y) / b)
                     for a, b in terms)  # fmt: skip
        return values / np.sum(values)

    kernels = [kernel(terms) for terms in (((1, 0.0047),), ((1, 0.0053),),
                                           ((34.1, 0.04), (13.5, 0.025)))]  # fmt: skip
    sigma = 0.5 * 0.082 * ppd
    reach = math.ceil(3 * sigma)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    bell = np.exp(-(x * x + y * y) / (2 * sigma**2))
    detectors = [-x * bell, (x * x / sigma**2 - 1) * bell]
    detectors = [np.where(d > 0, d / d[d > 0].sum(), -d / d[d < 0].sum()) for d in detectors]
    labs, features = [], []
    for image in (first, second):
        planes = image @ opponent.T
        visible = np.stack(
            [correlate(planes[..., c], kernels[c], mode="nearest") for c in range(3)], -1
        )
        rgb = np.clip(visible @ np.linalg.inv(opponent).T, 0, 1)
        labs.append(_lab(rgb.reshape(-1, 3)).reshape(rgb.shape))
        luminance = planes[..., 0] / 116
        joint = [[correlate(luminance, k, mode="nearest") for k in (d, d.T)] for d in detectors]
        features.append([np.hypot(*pair) for pair in joint])
    far = np.abs(labs[0] - labs[1])
    colour = (far[..., 0] + np.hypot(far[..., 1], far[..., 2])) ** 0.7
    largest = _hyab(np.eye(3)[1:2], np.eye(3)[2:])[0] ** 0.7
    knee = 0.4 * largest
    colour = np.where(
        colour < knee, 0.95 * colour / knee, 0.95 + 0.05 * (colour - knee) / (largest - knee)
    )
    apart = np.abs(np.subtract(*features)).max(axis=0) / math.sqrt(2)
    result: np.ndarray = np.minimum(colour, 1) ** (1 - np.sqrt(apart))
    return result


@relation(
    "separable filters", covers="scores.metrics.filters", limit=8, unit="ulp of float32",
    source="sums of float32",
)  # fmt: skip
def _filters(_: str, effort: int) -> Iterator[Deviation]:
    """Filters correlate with the outer product of two different kernels."""
    random = np.random.default_rng(0)
    for taps in (1, 3, 8):
        image = random.random((20, 23)).astype(np.float32)
        across, down = random.random((2, taps))
        window = np.lib.stride_tricks.sliding_window_view(image.astype(float), (taps, taps))
        expected = np.einsum("ijkl,k,l->ij", window, down, across)
        yield difference(f"{taps}", separable_filter(image, across, down), expected,
                         EPS32 * max(1.0, expected.max()))  # fmt: skip


# -- scores without noise -----------------------------------------------------------------------


def _pairs(values: np.ndarray) -> np.ndarray:
    """Mean over pairs of different replicates of the products, by two loops."""
    count = len(values)
    total = sum(values[j] * values[k] for j in range(count) for k in range(count) if j != k)
    mean: np.ndarray = total / (count * (count - 1))
    return mean


def _noise_free_ssim(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """SSIM of one colour without noise, and to first order, from (K, R, C) codes, by loops."""
    count = len(x)
    e = y - x
    mx, my, me = (np.stack([_windows(v) for v in values]) for values in (x, y, e))
    error, spread = {}, {}
    for j in range(count):
        for k in range(count):
            if j != k:
                error[j, k] = _windows(e[j] * e[k]) - me[j] * me[k]
                spread[j, k] = _windows(x[j] * x[k] + y[j] * y[k]) - mx[j] * mx[k] - my[j] * my[k]
    big_e, big_d = (sum(values.values()) / len(values) for values in (error, spread))
    apart = [(p, q) for p in error for q in error if not set(p) & set(q)]
    var = big_d**2 - sum(spread[p] * spread[q] for p, q in apart) / len(apart)
    cov = big_e * big_d - sum(error[p] * spread[q] for p, q in apart) / len(apart)
    plain_x, plain_y = x.mean(axis=0), y.mean(axis=0)
    plain = _windows(plain_x**2 + plain_y**2) - _windows(plain_x) ** 2 - _windows(plain_y) ** 2
    d = np.maximum(np.maximum(big_d, 0.5 * plain), 0) + 0.03**2
    light = 1 - _pairs(me) / (np.maximum(_pairs(mx) + _pairs(my), 0) + 0.01**2)
    second = np.clip(big_e * var / d**3 - cov / d**2, -0.3, 0.3)
    return light * (1 - big_e / d + second), light * (1 - big_e / d)


@relation(
    "scores without noise", covers="scores.metrics scores.regression.noise_free image.noisy_image",
    limit=6, unit="1e-5", source="float32 windows of shifted values",
)  # fmt: skip
def _noise_free(_: str, effort: int) -> Iterator[Deviation]:
    """Moments are means over pairs of different replicates, as loops over all pairs give them."""
    random = np.random.default_rng(5)
    first, second = (v[:24, :26] for v in _images(6))
    for count in (4, 6)[:effort]:
        noise = 0.05 * random.normal(size=(2, count, *first.shape))
        stacks = [np.clip(v + n, 0, None).astype(np.float32)
                  for v, n in zip((first, second), noise, strict=True)]  # fmt: skip
        maps = noise_free_maps([ssim_metric], *stacks)[ssim_metric.key]
        codes = [_pseudo_codes(stack.astype(float)) for stack in stacks]
        expected = [
            np.mean(
                [_noise_free_ssim(codes[0][..., c], codes[1][..., c])[k] for c in range(3)], axis=0
            )
            for k in (0, 1)
        ]
        for k, name in enumerate(("without noise", "to first order")):
            yield difference(f"{count}: {name}", maps[k, 5:-5, 5:-5], expected[k], 1e-5)
        squares = noise_free_maps([psnr_metric], *stacks)[psnr_metric.key][0]
        error = codes[1] - codes[0]
        yield difference(f"{count}: squares", squares, _pairs(error).mean(axis=-1), 1e-5)
        products = mean_of_products(error)
        yield difference(f"{count}: products", products, _pairs(error), 1e-9)
        without = [mean_of_products(np.delete(error, k, axis=0)) for k in range(count)]
        # A left out replicate lowers the mean by half of its share, once more in the pairs.
        change = np.stack([products - other for other in without])
        yield difference(f"{count}: left out", left_out_changes(error), change, 1e-9)
    same = np.repeat(first[None], 4, axis=0)
    yield difference(
        "no noise",
        noise_free_maps([ssim_metric], same, same)[ssim_metric.key][0],
        np.ones(first.shape[:2]),
    )
    other = np.repeat(second[None], 4, axis=0)
    clean = noise_free_maps([ssim_metric], same, other)[ssim_metric.key][0]
    yield difference("clean", clean, metrics.ssim_map(first, second), 1e-5)


def _pseudo_codes(stack: np.ndarray) -> np.ndarray:
    count, mean = len(stack), stack.mean(axis=0)
    without = (count * mean - stack) / (count - 1)
    codes: np.ndarray = count * _codes(mean) - (count - 1) * _codes(without)
    return codes
