"""Measure bias, coverage and width of scores without noise, on many relics.

    python -m reports.coverage.run scenes/amphora.xml ... -o reports/coverage

Each scene is evaluated with several seeds, with the samples of a preview or with those that its
scores need. The replicates of an image from all seeds are one pool. A draw takes as many replicates
as a run has, at random, and scores them as the run does. It is compared with the score of the whole
pool, which contains it: the difference has the share 1 - 1 / seeds of the draw's variance, and is
divided by the square root of that share. An interval covers the score if it contains it after that.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np

from inim.image.noisy_image import REPLICATES, NoisyImage
from inim.pipeline.job import setup
from inim.pipeline.output import Images
from inim.pipeline.plan import make_plan
from inim.pipeline.request import PREVIEW, Request
from inim.pipeline.validate import evaluate
from inim.report.labels import per_cent
from inim.report.study import PagePart, Table
from inim.scores.metrics import MAIN
from inim.scores.regression.scores import ScoreEstimate, difference, view_scores
from inim.system.process.observer import Observer
from reports.study import Results, Study, add_scenes

#: The default, and the paper's algorithm.
ALGORITHMS = ("template", "wang2024")
_VIEW = "centre"
# As many samples as the scores need, the usual ones, and those of a preview.
_MODES = ("default", "usual", "preview")
_DEFINITIONS: Mapping[str, Mapping[str, Any]] = {
    "default": {}, "usual": {"inim.score_error": 0.0}, "preview": PREVIEW,
}  # fmt: skip
_TARGET = (0.92, 0.98)
_TIME = (
    "Of an evaluation of the centre view, with the panel pixels that it observes. From the second "
    "evaluation on, the samples are known and taken in one round."
)
# A draw by score: value, interval, and the score of all other replicates.
_Draw = tuple[float, float, float, float]


class _KeptViews(Images):
    """Images of a run that are kept in memory instead of files."""

    def __init__(self, observer: Observer) -> None:
        super().__init__(Path("unused"), {}, observer, data_only=True)
        self.views: dict[str, NoisyImage] = {}

    def save_views(self, name: str, views: Mapping[str, Any]) -> None:
        """Keep the view."""
        self.views[name] = views[_VIEW]


class Pool(NamedTuple):
    """Replicates of each view from all seeds, (n, rows, columns, 3), and the relic's region."""

    views: dict[str, np.ndarray]
    region: np.ndarray
    samples: dict[str, int]  #: Samples per pixel of each seed, by setting.
    cpu_s: float  #: Processor time of an evaluation, mean without the first, which compiles.


def collect_replicates(scene: Path, mode: str, seeds: int) -> Pool:
    """Evaluate a scene with several seeds; the first one decides the samples of all."""
    # Lazy: the view observes a small part of the panel.
    request = Request(
        scene, Path("unused"), algorithms=ALGORITHMS, viewpoints=(_VIEW,), lazy=True,
        definitions=_DEFINITIONS[mode],
    )  # fmt: skip
    plan = make_plan(request)
    pools: dict[str, list[np.ndarray]] = {}
    times = []
    for seed in range(1, seeds + 1):
        started, observer = time.process_time(), Observer()
        seeded = replace(plan, settings=replace(plan.settings, seed=seed))
        run, renderer, _ = setup(seeded, Path("unused"), observer, data_only=True)
        images = _KeptViews(observer)
        evaluation = evaluate(seeded, renderer, images, run)
        truth = evaluation.truth
        plan = replace(evaluation.plan, by_need=())
        for name, view in {"truth": truth.views[_VIEW], **images.views}.items():
            assert view.replicates is not None
            pools.setdefault(name, []).append(view.replicates)
        times.append(time.process_time() - started)
    views = {name: np.concatenate(parts) for name, parts in pools.items()}
    return Pool(views, truth.regions[_VIEW], plan.samples, fmean(times[1:]))


def draw_scores(pool: Pool, seeds: int, draws: int) -> dict[str, list[_Draw]]:
    """Draws of all scores, by ``algorithm score``, and of the algorithms' difference."""
    random = np.random.default_rng(0)
    count = REPLICATES * seeds
    best = _scores({name: _groups(view) for name, view in pool.views.items()}, pool.region)
    results: dict[str, list[_Draw]] = {}
    for _ in range(draws):
        # Algorithms share the captures of a seed, so they take the same replicates.
        orders = {name: random.permutation(count) for name in ("truth", "reference")}
        orders |= dict.fromkeys(ALGORITHMS, random.permutation(count))
        scores = _scores(
            {n: _groups(view[orders[n][:REPLICATES]]) for n, view in pool.views.items()},
            pool.region,
        )
        for key, score in scores.items():
            results.setdefault(key, []).append(_draw(score.value, score.interval, best[key].value))
        for key in [key for key in scores if key.startswith(ALGORITHMS[0])]:
            other = key.replace(ALGORITHMS[0], ALGORITHMS[1])
            value, interval = difference(scores[key], scores[other])
            name = key.replace(ALGORITHMS[0], " - ".join(ALGORITHMS))
            rest = best[key].value - best[other].value
            results.setdefault(name, []).append(_draw(value, interval, rest))
    return results


def _draw(value: float, interval: tuple[float, float], best: float) -> _Draw:
    low, high = interval
    return round(value, 5), round(low, 5), round(high, 5), round(best, 5)


def _groups(replicates: np.ndarray) -> NoisyImage:
    """Image whose replicates are the means of equal groups of replicates."""
    size = len(replicates) // REPLICATES
    groups = replicates.reshape(REPLICATES, size, *replicates.shape[1:])
    return NoisyImage.from_replicates(groups.mean(axis=1))


def _scores(views: Mapping[str, NoisyImage], region: np.ndarray) -> dict[str, ScoreEstimate]:
    """Scores on the relic of each algorithm, to the truth and to the reference."""
    return {
        f"{name} {key} to {against}": score
        for name in ALGORITHMS
        for against in ("reference", "truth")
        for key, score in view_scores(views[against], views[name], region).items()
        if "on_relic" in key
    }


def summarize(scenes: Mapping[str, Sequence[_Draw]], seeds: int) -> list[str]:
    """Cells of a score's row: bias, worst relic, rms, coverage, its lowest, mean width."""
    errors, covered, widths = {}, {}, []
    share = math.sqrt(1 - 1 / seeds)
    for scene, draws in scenes.items():
        errors[scene] = [value - best for value, _, _, best in draws]
        covered[scene] = [
            low <= value - (value - best) / share <= high for value, low, high, best in draws
        ]
        widths += [high - low for _, low, high, _ in draws if math.isfinite(high - low)]
    biases = {scene: fmean(values) for scene, values in errors.items()}
    shares = {scene: fmean(values) for scene, values in covered.items()}
    worst = max(biases, key=lambda scene: abs(biases[scene]))
    lowest = min(shares, key=lambda scene: shares[scene])
    squares = [error**2 for values in errors.values() for error in values]
    return [
        f"{fmean(biases.values()):+.4f}", f"{biases[worst]:+.4f} ({worst})",
        f"{math.sqrt(fmean(squares)):.4f}", per_cent(fmean(shares.values()), 0),
        f"{shares[lowest]:.0%} ({lowest})", f"{fmean(widths):.4f}" if widths else "unlimited",
    ]  # fmt: skip


def page(results: Results) -> tuple[list[str], list[PagePart]]:
    """A table of each mode."""
    modes: dict[str, dict[str, dict[str, Any]]] = {}
    for name, case in results.items():
        scene, mode = name.split("/")
        for key, draws in _with_infinite_ends(case["draws"]).items():
            modes.setdefault(mode, {}).setdefault(key, {})[scene] = draws
    seeds = {case["seeds"] for case in results.values()}
    heads = ["algorithm and score", "bias", "worst relic", "rms", "coverage", "lowest", "width"]
    parts = []
    for mode, scores in modes.items():
        relics = len(next(iter(scores.values())))
        rows = [[key, *summarize(scenes, min(seeds))] for key, scenes in scores.items()]
        caption = f"{mode} samples, {relics} relics, centre view"
        parts.append(
            PagePart(mode, f"{mode} samples".capitalize(), "", [Table(caption, heads, rows)])
        )
    headline = f"{ALGORITHMS[0]} {MAIN.on_relic_key} to reference"
    rows = []
    for name, case in results.items():
        draws = _with_infinite_ends(case["draws"])[headline]
        widths = [high - low for _, low, high, _ in draws]
        errors = [value - best for value, _, _, best in draws]
        rms = math.sqrt(fmean(error**2 for error in errors))
        counts = map(str, case["samples"].values())
        rows.append([name, *counts, f"{case['cpu_s']:.1f}", f"{fmean(widths):.4f}", f"{rms:.4f}"])
    heads = ["relic and mode", "RGB-D", "EIA", "view", "processor time, s", "width", "rms error"]
    table = Table(f"Samples per pixel, time and {headline}", heads, rows)
    parts.append(PagePart("time", "Time against error", _TIME, [table]))
    low, high = _TARGET
    return [
        f"Target: {low:.0%} to {high:.0%} of the intervals contain the score.",
        "The width is the mean of finite intervals; one of PSNR may have no upper end.",
    ], parts


def _with_infinite_ends(draws: Mapping[str, Sequence[Any]]) -> dict[str, list[_Draw]]:
    """Draws by score from JSON, which has null instead of infinite ends."""
    return {
        key: [
            (value, -math.inf if low is None else low, math.inf if high is None else high, best)
            for value, low, high, best in rows
        ]
        for key, rows in draws.items()
    }


def measure(scene: Path, mode: str, seeds: int, draws: int) -> dict[str, Any]:
    """Draws of a scene, with the numbers of seeds and samples."""
    pool = collect_replicates(scene, mode, seeds)
    return {
        "seeds": seeds, "samples": pool.samples, "cpu_s": pool.cpu_s,
        "draws": draw_scores(pool, seeds, draws),
    }  # fmt: skip


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the scenes and the numbers of seeds and draws."""
    add_scenes(parser)
    parser.add_argument("--seeds", type=int, default=8, help="evaluations of each scene (8)")
    parser.add_argument("--draws", type=int, default=20, help="draws of each scene (20)")
    parser.add_argument("--modes", nargs="+", default=_MODES, choices=_MODES)


def cases(args: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Each scene in each mode."""
    return {
        f"{scene.stem}/{mode}": {
            "scene": scene, "mode": mode, "seeds": args.seeds, "draws": args.draws
        }
        for mode in args.modes
        for scene in args.scenes
    }  # fmt: skip


STUDY = Study(
    "reports.coverage.run", "Bias, coverage and width of scores without noise", __doc__, arguments,
    cases, measure, page,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(STUDY.main())
