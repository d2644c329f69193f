"""Measure how often the intervals of scores contain the score with many samples.

    python -m reports.coverage.run scenes/amphora.xml ... -o reports/coverage

Each scene is evaluated with new seeds, with the samples of a preview and with the default samples.
A score of an evaluation is covered if its interval contains the value of a single evaluation with
another seed and 64 times the samples of a preview, which are 16 times the default samples (32 times
those of the RGB-D picture).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from inim.display.settings import PREFIX, Settings
from inim.pipeline.adaptive_sampling import SAMPLE_COUNTS
from inim.pipeline.job import setup
from inim.pipeline.plan import make_plan
from inim.pipeline.request import PREVIEW, Request
from inim.pipeline.validate import evaluate
from inim.report.labels import per_cent
from inim.report.study import PagePart
from inim.scores.regression.scores import INTERVAL_LEVEL
from inim.system.process.observer import Observer
from reports.study import Results, Study, add_scenes, table

#: The default, the same sources with the nearest colour of one ray, and layers.
ALGORITHMS = ("template", "template:samples=1:colour=nearest", "layered")
FACTOR = 64
_PREVIEW = {name: PREVIEW[f"{PREFIX}{name}"] for name in SAMPLE_COUNTS}
_TRUTH = "truth"
_SAMPLES: dict[str, dict[str, int]] = {
    "preview": _PREVIEW,
    "default": {name: getattr(Settings(), name) for name in SAMPLE_COUNTS},
    _TRUTH: {name: FACTOR * count for name, count in _PREVIEW.items()},
}
_TRUTH_SEED = 1_000_003
_TARGET = (0.90, 0.99)


def evaluate_scene(scene: Path, mode: str, seed: int) -> dict[str, list[float]]:
    """Value and interval of every score of a scene, by ``algorithm/viewpoint score``."""
    request = Request(scene, Path("unused"), algorithms=ALGORITHMS, viewpoints=("centre",))
    plan = make_plan(request)
    changes: dict[str, Any] = {**_SAMPLES[mode], "seed": seed}
    plan = replace(plan, settings=replace(plan.settings, **changes))
    with tempfile.TemporaryDirectory() as folder:
        run, renderer, images = setup(plan, Path(folder), Observer(), data_only=True)
        evaluation = evaluate(plan, renderer, images, run)
    views = {f"reference/{name}": scores for name, scores in evaluation.reference_scores.items()}
    for result in evaluation.results.values():
        views |= result.statistics.scores
    return {
        f"{view} {name}": [score.value, *score.interval]
        for view, scores in views.items()
        for name, score in scores.items()
    }


def cases(args: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """The truth of each scene, then all seeds."""
    runs = [(scene, _TRUTH, _TRUTH_SEED) for scene in args.scenes]
    for mode, count in (("preview", args.previews), ("default", args.defaults)):
        runs += [(scene, mode, seed) for seed in range(1, count + 1) for scene in args.scenes]
    return {
        f"{scene.stem}/{mode}/{seed}": {"scene": scene, "mode": mode, "seed": seed}
        for scene, mode, seed in runs
    }


def count_covered(
    truth: Mapping[str, Sequence[float]], evaluations: Iterable[Mapping[str, Sequence[float]]]
) -> dict[str, tuple[int, int]]:
    """Number of intervals that contain the true score, and of all, by algorithm and score."""
    counts: dict[str, tuple[int, int]] = {}
    for evaluation in evaluations:
        for key, (_, low, high) in evaluation.items():
            view, score = key.rsplit(" ", 1)
            name = f"{view.rsplit('/', 1)[0]} {score}"
            covered, total = counts.get(name, (0, 0))
            counts[name] = covered + (low <= truth[key][0] <= high), total + 1
    return counts


def summarize(counts: Mapping[str, Mapping[str, tuple[int, int]]]) -> list[dict[str, Any]]:
    """Coverage by algorithm and score over all scenes, and the scene with the least."""
    rows = []
    for key in dict.fromkeys(key for scene in counts.values() for key in scene):
        shares = {name: scene[key] for name, scene in counts.items() if key in scene}
        worst = min(shares, key=lambda name: shares[name][0] / shares[name][1])
        covered, total = (sum(values) for values in zip(*shares.values(), strict=True))
        rows.append({
            "score": key, "covered": covered, "intervals": total, "coverage": covered / total,
            "worst_scene": worst, "worst_coverage": shares[worst][0] / shares[worst][1],
        })  # fmt: skip
    return sorted(rows, key=lambda row: (row["coverage"], row["worst_coverage"]))


def page(results: Results) -> tuple[list[str], list[PagePart]]:
    """Coverage in each mode, the lowest first."""
    low, high = _TARGET
    remark = (
        f"Share of {1 - INTERVAL_LEVEL:.0%} intervals that contain the score with {FACTOR} times "
        f"the samples of a preview. Target: {low:.0%} to {high:.0%}."
    )
    evaluations: dict[str, dict[str, list[Any]]] = {}
    for name, scores in results.items():
        scene, mode, _ = name.split("/")
        evaluations.setdefault(mode, {}).setdefault(scene, []).append(scores)
    truth = {scene: scores[0] for scene, scores in evaluations.pop(_TRUTH).items()}
    parts = []
    for mode, by_scene in evaluations.items():
        rows = summarize({scene: count_covered(truth[scene], e) for scene, e in by_scene.items()})
        inside = sum(low <= row["coverage"] <= high for row in rows)
        below = sum(row["coverage"] < low for row in rows)
        caption = (
            f"{mode}: of {len(rows)} scores, {inside} are in the target, {below} below and "
            f"{len(rows) - inside - below} above it; {len(next(iter(by_scene.values())))} seeds"
        )
        columns = {
            "algorithm and score": lambda r: r["score"],
            "covered": lambda r: str(r["covered"]),
            "of": lambda r: str(r["intervals"]),
            "share": lambda r: per_cent(r["coverage"], 1),
            "lowest of a scene": lambda r: f"{r['worst_coverage']:.0%} ({r['worst_scene']})",
        }
        parts.append(PagePart(mode, mode.capitalize(), "", [table(caption, rows, columns)]))
    return [remark], parts


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the scenes and the numbers of seeds."""
    add_scenes(parser)
    parser.add_argument("--previews", type=int, default=40, help="seeds with preview samples")
    parser.add_argument("--defaults", type=int, default=40, help="seeds with default samples")


STUDY = Study(
    "reports.coverage.run", "Coverage of the intervals of scores", __doc__, arguments, cases,
    evaluate_scene, page,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(STUDY.main())
