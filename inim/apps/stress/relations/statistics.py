"""Statistics of scores and images against closed forms, loops, and simulated noise."""

import math
from collections.abc import Iterator

import numpy as np

from inim.apps.stress.relation import Deviation, difference, excess, is_true, relation
from inim.image.noisy_image import NoisyImage
from inim.scores import metrics
from inim.scores.regression.light import light_scores
from inim.scores.regression.noise_free import (
    BLOCK_PX,
    COUPLING,
    error_of_responses,
    estimators,
    sum_blocks,
)
from inim.scores.regression.scores import (
    ScoreEstimate,
    compare_scores,
    half_width,
    is_above,
    view_scores,
)
from inim.scores.regression.scores import difference as score_difference
from inim.scores.regression.tiles import eia_tile, tile_statistics, view_tile
from inim.scores.regression.verdict import (
    binomial_interval,
    freedom_of_sum,
    judge,
    sidak,
    welch_freedom,
    welch_half_width,
    welch_p_value,
    within,
)


@relation(
    "distributions", covers="scores.regression.verdict", limit=1e-9, unit="absolute",
    source="distributions with closed forms",
)  # fmt: skip
def _distributions(_: str, effort: int) -> Iterator[Deviation]:
    """P-values and intervals are those of Student's distributions of 1, 2 and infinite freedom."""
    t = np.array([0.1, 1.0, 3.0, -2.0])
    unit, zero = np.ones(4), np.zeros(4)
    cauchy = welch_p_value(t, unit, unit, zero, unit)
    yield difference("one degree", cauchy, 1 - 2 / math.pi * np.arctan(np.abs(t)))
    two = welch_p_value(t * 0.3, 0.3 * unit, 2 * unit, zero, unit)
    yield difference("two degrees", two, 1 - np.abs(t) / np.sqrt(2 + t * t))
    normal = welch_p_value(t, 0.6 * unit, 1e12 * unit, 0.8 * unit, 1e12 * unit)
    yield difference("normal", normal, [math.erfc(abs(v) / math.sqrt(2)) for v in t], 10.0)
    yield difference("no noise", welch_p_value(np.array([0.0, 0.1]), *zero.reshape(4, 1)), (1, 0))
    for level in (0.05, 0.5):
        half = float(
            welch_half_width(
                np.float64(2.0), np.float64(1.0), np.float64(0.0), np.float64(1.0), level
            )
        )
        yield difference(f"half width {level}", half, 2 * math.tan(math.pi / 2 * (1 - level)), 1e3)
        back = float(welch_p_value(*map(np.float64, (half, 2.0, 1.0, 0.0, 1.0))))
        yield difference("inverse", back, level)
    yield is_true(
        "unknown", np.isnan(welch_half_width(*map(np.float64, (math.nan, 1, 1, 1)), 0.05))
    )
    freedom = welch_freedom(np.float64(0.3), np.float64(7), np.float64(0.3), np.float64(7))
    yield difference("equal errors", freedom, 14.0)
    uneven = welch_freedom(np.float64(3.0), np.float64(4), np.float64(1.0), np.float64(9))
    yield difference("uneven", uneven, 100 / (81 / 4 + 1 / 9))
    squares, fourths = np.array([5.0, 1.0, 0.0]), np.array([5.0, 1.0, 0.0])
    yield difference("freedom of sums", freedom_of_sum(squares, fourths, 2), (4 * 5 - 2, 2, 1))
    yield difference("one each", freedom_of_sum(squares, fourths), (13, 1, 1))
    for level, tests in ((0.05, 7), (1e-3, 1000), (0.2, 1)):
        yield difference("family", 1 - (1 - sidak(level, tests)) ** tests, level)
    for count, trials in ((0, 9), (9, 9), (3, 12)):
        low, high = binomial_interval(count, trials, 0.1)
        ends = (low, range(count, trials + 1)), (high, range(count + 1))
        tails = [
            sum(math.comb(trials, k) * p**k * (1 - p) ** (trials - k) for k in ks) for p, ks in ends
        ]
        expected = (0.05 if count else 1.0, 0.05 if count < trials else 1.0)
        yield difference(f"{count} of {trials}", tails, expected)
    for change, half, passes in (
        (0.1, 0.2, True), (-0.3, 0.2, False), (0.3, 0.4, True), (math.nan, 0.1, False),
        (0.0, math.inf, False), (0.26, 0.1, False),
    ):  # fmt: skip
        verdict = within("score", "score", change, half, 0.25)
        yield difference(f"change {change:g}, {half:g}", verdict.passed, passes)
        word, _ = judge([verdict], inputs_changed=False, allow_changed_inputs=False)
        yield difference("verdict", word == "passed", passes)
    word, _ = judge([], inputs_changed=False, allow_changed_inputs=False)
    yield difference("no score", word == "passed", False)


@relation(
    "errors of means", covers="scores.regression.noise_free scores.regression.scores", limit=1e-9,
    unit="relative", source="float64 sums",
)  # fmt: skip
def _errors(_: str, effort: int) -> Iterator[Deviation]:
    """Errors add up over blocks of 16 pixels, with the coupling of neighbours."""
    random = np.random.default_rng(0)
    values = random.normal(size=(40, 35))
    sums = sum_blocks(values)
    expected = np.array([[values[r : r + 16, c : c + 16].sum() for c in range(0, 35, 16)]
                         for r in range(0, 40, 16)])  # fmt: skip
    yield difference("blocks", sums, expected)
    yield difference("coupling", COUPLING, 1 / (1 - 2.2 / BLOCK_PX) ** 2)
    responses = random.normal(size=(8, 3, 3))
    error, freedom = error_of_responses(responses)
    squares = (responses**2).sum(axis=0)
    yield difference("error", error, math.sqrt(COUPLING * squares.sum()))
    yield difference("freedom", freedom, 9 * squares.sum() ** 2 / (squares**2).sum() - 2)
    alone, _ = error_of_responses(responses[:, :1, :1])
    yield difference("one block", alone, math.sqrt(squares[0, 0]))


def _noisy(truth: np.ndarray, count: int, size: float, seed: int) -> NoisyImage:
    noise = np.random.default_rng(seed).normal(size=(count, *truth.shape))
    return NoisyImage.from_replicates((truth * (1 + size * noise)).astype(np.float32))


def _scene() -> tuple[np.ndarray, np.ndarray]:
    y, x = np.indices((48, 64))
    grey = 0.3 + 0.2 * ((x // 11 + y // 9) % 2) + 0.08 * np.sin(x / 1.3) * np.cos(y / 1.7)
    scene = np.stack([grey, 0.8 * grey, 0.5 * grey], axis=-1)
    return scene, 0.93 * np.roll(scene, 1, axis=1) + 0.005


@relation(
    "scores of noisy images", covers="scores.regression scores.metrics image.noisy_image",
    limit=4.5, unit="standard errors", source="simulated noise; 1 of 100,000 beyond it",
)  # fmt: skip
def _noisy_scores(_: str, effort: int) -> Iterator[Deviation]:
    """Scores without noise hit those of the noiseless images, with honest errors and intervals."""
    truth, test = (v.astype(np.float32) for v in _scene())
    clean = metrics.score(truth, test)
    region = np.zeros(truth.shape[:2], bool)
    region[10:40, 8:50] = True
    on_relic = metrics.score(truth, test, region)
    runs = [
        view_scores(_noisy(truth, 8, 0.06, 2 * k), _noisy(test, 8, 0.06, 2 * k + 1), region)
        for k in range(3 + 3 * effort)
    ]
    for key in ("ssim", "psnr_db", "flip", "ssim_on_relic", "psnr_on_relic_db"):
        expected = (clean | on_relic)[key]
        errors = np.array([run[key].value_error for run in runs])
        far = np.array([run[key].value for run in runs]) - expected
        slack = max(max(run[key].extension) for run in runs)
        mean = max(abs(far.mean()) - slack, 0) / (errors.mean() / math.sqrt(len(runs)))
        yield excess(f"{key}: mean", mean, 0.0)
        spread = far.std(ddof=1) / errors.mean()
        yield is_true(f"{key}: honest error {spread:.2f}", 0.25 < spread < 2.2)
        inside = [run[key].interval[0] <= expected <= run[key].interval[1] for run in runs]
        yield is_true(f"{key}: interval", np.mean(inside) >= 0.6, len(inside))
        plain = np.array([run[key].plain - expected for run in runs]).mean()
        bias = np.array([run[key].bias for run in runs]).mean()
        yield is_true(f"{key}: bias", bias * plain > 0 and 0.4 < bias / plain < 1.6)
    first = runs[0]["ssim"]
    half = float(
        welch_half_width(*map(np.float64, (0, 1, first.value_error, first.value_freedom)), 0.05)
    )
    half += sum(first.extension) / 2
    yield difference("half width", half_width(first), half, 1e-9)
    same, (low, high) = score_difference(first, first)
    yield difference("the same score", (same, low <= 0 <= high), (0.0, True), 1e-9)
    better = view_scores(_noisy(truth, 8, 0.06, 0), _noisy(truth * 0.99, 8, 0.06, 1))["ssim"]
    yield difference("above", (is_above(better, first), is_above(first, better)), (True, False))
    identical = NoisyImage.from_image(truth)
    exact = view_scores(identical, identical)
    yield difference("identical", [exact[k].value for k in ("ssim", "psnr_db", "flip")],
                     (1.0, math.inf, 0.0))  # fmt: skip
    yield difference("no error", [exact[k].error for k in ("ssim", "psnr_db", "flip")], (0, 0, 0))
    halves = [view_scores(NoisyImage.from_halves(*_halves(truth, k)),
                          NoisyImage.from_halves(*_halves(test, k + 50)))["ssim"]
              for k in range(4)]  # fmt: skip
    far = np.mean([s.value - clean["ssim"] for s in halves])
    error = np.mean([s.value_error for s in halves]) / 2
    allowed = np.mean([max(s.extension) for s in halves])
    yield excess("by halves", max(abs(far) - allowed, 0) / error, 0.0)
    checks = compare_scores({"eye": {"ssim": first}}, {"eye": {"ssim": runs[1]["ssim"]}})
    yield is_true("fresh seeds", [check.passed for check in checks])
    checks = compare_scores({"eye": {"ssim": first}}, {"eye": {"ssim": better}})
    yield is_true("a real change", [not check.passed for check in checks])
    checks = compare_scores({"eye": {"ssim": first}}, {})
    yield is_true("missing", [not check.passed for check in checks])


def _halves(truth: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    noise = np.random.default_rng(seed).normal(size=(2, *truth.shape))
    first, second = (truth * (1 + 0.06 * noise)).astype(np.float32)
    return first, second


@relation(
    "estimators of means", covers="scores.regression.noise_free scores.metrics", limit=1e-6,
    unit="absolute", source="float64 means of float32 maps",
)  # fmt: skip
def _estimators(_: str, effort: int) -> Iterator[Deviation]:
    """Estimates are means of the maps without noise, with jackknife errors, or extrapolations."""
    from inim.scores.metrics.base import noise_free_maps
    from inim.scores.metrics.ssim import metric as ssim_metric

    truth, test = _scene()
    stacks = [_noisy(v, 8, 0.05, k).replicates for k, v in enumerate((truth, test))]
    own = estimators(
        [m for m in metrics.all_metrics() if m.name in ("ssim", "flip")], *stacks, None
    )
    mask = ssim_metric.score_mask(truth.shape[:2])
    yield difference("border", mask, np.pad(np.ones((38, 54), bool), 5))
    maps = noise_free_maps([ssim_metric], *stacks)[ssim_metric.key]
    estimate = own["ssim"](mask)
    yield difference("mean", estimate.mean, maps[0][mask].mean(dtype=float))
    changes = np.where(mask, maps[3:].astype(float), 0)
    blocks = np.stack([sum_blocks(c) for c in changes]) * math.sqrt(7 / 8) / mask.sum()
    yield difference("error", estimate.error, error_of_responses(blocks)[0])
    rest = 0.5 * (maps[1][mask].mean(dtype=float) - maps[0][mask].mean(dtype=float))
    yield difference("rest", estimate.extension, (max(-rest, 0), max(rest, 0)))
    everything = np.ones(truth.shape[:2], bool)
    levels = []
    for parts in (1, 2, 4, 8):
        size = 8 // parts
        means = [[s[i : i + size].mean(axis=0) for s in stacks] for i in range(0, 8, size)]
        levels.append(np.mean([metrics.flip(*pair) for pair in means]))
    steps = np.diff(levels)
    ratio = min(max((steps[1] + steps[2]) / (steps[0] + steps[1]) + 0.1, 1.3), 2.0)
    flip = own["flip"](everything)
    yield difference("extrapolated", flip.mean, levels[0] - steps[0] / (ratio - 1), 10.0)
    quarter = 0.25 * abs(steps[0] / (ratio - 1))
    yield difference("quarter of it", flip.extension, (quarter, quarter), 10.0)


def _design_effect(observed: np.ndarray, independent: np.ndarray) -> float:
    """Variance of tiles' means over that of independent pixels, in the mean or the median tile."""
    median = float(np.median(observed / independent)) / 0.454936  # of a squared normal number
    return float(max(1.0, observed.sum() / independent.sum(), median))


@relation(
    "statistics of tiles", covers="scores.regression.tiles", limit=1, unit="1e-5 relative",
    source="float32 storage of float64 sums",
)  # fmt: skip
def _tiles(_: str, effort: int) -> Iterator[Deviation]:
    """Means, powers and errors of tiles are those of loops over their pixels."""
    truth, _ = _scene()
    first, second = _halves(truth, 3)
    image = NoisyImage.from_halves(first, second)
    tile = (10, 9)  # the last ones are cut
    own = tile_statistics(image, tile)
    a, b = first.astype(float), second.astype(float)
    rows, columns = truth.shape[:2]
    mean, power, variance, sums, evenness, count = [], [], [], [], [], []
    for r in range(0, rows, 10):
        for c in range(0, columns, 9):
            part = np.s_[r : r + 10, c : c + 9]
            n = a[part].shape[0] * a[part].shape[1]
            mean.append((a + b)[part].mean(axis=(0, 1)) / 2)
            power.append((a * b)[part].mean())
            variance.append((((a - b)[part] / 2) ** 2).sum(axis=(0, 1)) / n**2)
            sums.append((a - b)[part].sum(axis=(0, 1)) / n)
            squares = ((a - b)[part] / 2) ** 2
            evenness.append(squares.sum(axis=(0, 1)) ** 2 / (squares**2).sum(axis=(0, 1)))
            count.append([n])
    shape = own.mean.shape
    yield difference("mean", own.mean, np.reshape(mean, shape), 1e-5)
    yield difference("power", own.power, np.reshape(power, shape[:2]), 1e-5)
    observed, independent = np.array(sums) ** 2 / 4, np.array(variance)
    effect = _design_effect(observed, independent)
    error = np.sqrt(effect * independent).reshape(shape)
    yield difference("error", own.mean_error, error, 1e-5)
    degrees = np.maximum(np.minimum(3 * np.array(evenness) - 2, count) / effect, 1.0)
    yield difference("freedom", own.freedom, np.reshape(degrees, shape), 1e-4)
    noise = (a - b) ** 2
    spread = np.sqrt(((a + b) / 2) ** 2 * noise + noise**2 / 12).mean(axis=-1)
    powers = [
        (spread[r : r + 10, c : c + 9] ** 2).sum() / spread[r : r + 10, c : c + 9].size ** 2
        for r in range(0, rows, 10) for c in range(0, columns, 9)
    ]  # fmt: skip
    expected = np.sqrt(effect * np.array(powers)).reshape(shape[:2])
    yield difference("error of power", own.power_error, expected, 1e-5)
    # Pixels that repeat one another count once.
    repeated = NoisyImage.from_halves(*(np.repeat(np.repeat(v[::2, ::2], 2, 0), 2, 1)
                                        for v in (first, second)))  # fmt: skip
    sets = tile_statistics(repeated, (8, 8), generated=True)
    plain = tile_statistics(repeated, (8, 8))
    changes = ((a - b)[::2, ::2] / 2).reshape(rows // 8, 4, columns // 8, 4, 3)
    squares, fourths = ((changes**power).sum(axis=(1, 3)) for power in (2, 4))
    effect = _design_effect(changes.sum(axis=(1, 3)) ** 2, squares)
    degrees = np.maximum(np.minimum(3 * squares**2 / fourths - 2, 64) / effect, 1.0)
    yield difference("freedom of sets", sets.freedom, degrees, 1e-4)
    yield is_true("sets are noisier", (sets.mean_error / plain.mean_error).mean() > 0.9)
    yield is_true("fewer degrees", (sets.freedom < plain.freedom + 1e-3).mean() > 0.5)
    alone = tile_statistics(NoisyImage.from_halves(first, second), (8, 8), generated=True)
    yield is_true("no repeats", alone.freedom > sets.freedom, alone.freedom.size)
    for size, expected_tile in (((48, 64), 8), ((300, 64), 10), ((1025, 20), 33)):
        yield difference("tile of a view", view_tile(size), (expected_tile,) * 2)
    yield difference("tile of an EIA", eia_tile((68, 85), (4, 5)), (17, 17))
    yield difference("two lenses", eia_tile((680, 850), (40, 50)), (34, 34))


@relation(
    "light of a region", covers="scores.regression.light image.noisy_image", limit=1,
    unit="millionths of white", source="means of float32 pixels",
)  # fmt: skip
def _light(_: str, effort: int) -> Iterator[Deviation]:
    """Light is a mean in per cent; noise of one pixel has the error of the mean of its parts."""
    rng, shape = np.random.default_rng(3), (64, 96)
    region = np.zeros(shape, bool)
    region[10:50, 8:80] = True
    image = rng.random((*shape, 3))
    for parts, side in ((8, (8, 12)), (2, (4, 4))):
        # Windows of four blocks, and noise that is correlated over 4.4 pixels.
        reserve = math.prod(1 - 4.4 / (4 * n) for n in side)
        for row, column in ((11, 9), (31, 47), (32, 48), (49, 79), (60, 90)):
            noise = 0.1 * rng.normal(size=(parts, 3))
            draws = np.broadcast_to(image, (parts, *image.shape)).copy()
            draws[:, row, column] += noise
            test = NoisyImage.from_parts(draws.astype(np.float32))
            still = NoisyImage.from_parts(np.repeat(image[None], parts, 0).astype(np.float32))
            scores, case = light_scores(still, test, region), f"{parts} parts, {row} {column}"
            halves = {"relic": region, "upper_half": region & (np.arange(64) < 30)[:, None],
                      "right_half": region & (np.arange(96) >= 44)}  # fmt: skip
            for name, mask in halves.items():
                for c, colour in enumerate(("red", "green", "blue")):
                    score = scores[f"light_on_{name}_{colour}"]
                    means = draws[..., c][:, mask].mean(axis=1)
                    error = means.std(ddof=1) / math.sqrt(parts * reserve)
                    yield difference(f"{case}: {name}", score.plain, 100 * means.mean(), 1e-4)
                    yield difference(f"{case}: error", score.error, 100 * error, 1e-4)
            grey = image[region].mean()
            change = 100 * (draws.mean(axis=0)[region] - image[region]).mean(axis=0) / grey
            for c, colour in enumerate(("red", "green", "blue")):
                own = scores[f"light_on_relic_{colour}_to_reference"]
                yield difference(f"{case}: to the reference", own.plain, change[c], 1e-4)


@relation(
    "other numbers of samples", covers="scores.regression.scores", limit=1e-9, unit="absolute",
    source="a bias that is proportional to the variance",
)  # fmt: skip
def _other_samples(_: str, effort: int) -> Iterator[Deviation]:
    """A score that moves with the variance of the noise only is no change."""
    for bias in (-0.02, 0.013):
        for ratio in (0.8, 1.0, 1.3):
            scale = ratio**2
            old = ScoreEstimate(0.9 + bias, 0.001, 30.0, bias)
            new = ScoreEstimate(0.9 + scale * bias, 0.001, 30.0, scale * bias)
            name = metrics.MAIN.to_reference_key
            check = compare_scores({"view": {name: old}}, {"view": {name: new}}, ratio)[0]
            yield difference(f"{bias:g}, {ratio:g}", check.value, 0.0)
            yield is_true("passes", check.passed)
