"""Measure how often the intervals of scores contain the score with many samples.

    python -m reports.coverage.run scenes/amphora.xml ... -o reports/coverage

Each scene is evaluated with new seeds, with the samples of a preview and with the default samples.
A score of an evaluation is covered if its interval contains the value of a single evaluation with
another seed and 64 times the samples of a preview, which are 16 times the default samples (32 times
those of the RGB-D picture). Finished evaluations in ``out/coverage`` are reused: remove them after
a change.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections import defaultdict
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
from inim.scores.regression.scores import INTERVAL_LEVEL, score_interval
from inim.system.process.observer import Observer

RUNS = Path("out", "coverage")
#: The default, the same sources with the nearest colour of one ray, and layers.
ALGORITHMS = ("template", "template:samples=1:colour=nearest", "layered")
VIEWPOINTS = ("centre",)
FACTOR = 64
_PREVIEW = {name: int(PREVIEW[f"{PREFIX}{name}"]) for name in SAMPLE_COUNTS}
_SAMPLES: dict[str, dict[str, int]] = {
    "preview": _PREVIEW,
    "default": {name: getattr(Settings(), name) for name in SAMPLE_COUNTS},
    "truth": {name: FACTOR * count for name, count in _PREVIEW.items()},
}
_TRUTH_SEED = 1_000_003
_TARGET = (0.90, 0.99)

Intervals = dict[str, tuple[float, float, float]]


def evaluate_scene(scene: Path, samples: Mapping[str, Any], seed: int) -> Intervals:
    """Value and interval of every score of a scene, by ``algorithm/viewpoint score``.

    `samples` replace the scene's sample counts.
    """
    request = Request(scene=scene, out=Path("unused"), algorithms=ALGORITHMS, viewpoints=VIEWPOINTS)
    plan = make_plan(request)
    plan = replace(plan, settings=replace(plan.settings, **samples, seed=seed))
    with tempfile.TemporaryDirectory() as folder:
        run, renderer, images = setup(plan, Path(folder), Observer(), data_only=True)
        evaluation = evaluate(plan, renderer, images, run)
    views = {f"reference/{name}": scores for name, scores in evaluation.reference_scores.items()}
    for result in evaluation.results.values():
        views |= result.statistics.scores
    return {
        f"{view} {name}": (score.value, *score_interval(score))
        for view, scores in views.items()
        for name, score in scores.items()
    }


def stored(scene: Path, mode: str, seed: int) -> Intervals:
    """Evaluate a scene as a preview, with default samples, or for the truth; once."""
    path = RUNS / f"{scene.stem}-{mode}-{seed}.json"
    if not path.is_file():
        result = evaluate_scene(scene, _SAMPLES[mode], seed)
        print(path.stem, flush=True)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(result), "utf-8")
    intervals: Intervals = json.loads(path.read_text("utf-8"))
    return intervals


def count_covered(
    truth: Mapping[str, Sequence[float]], evaluations: Iterable[Mapping[str, Sequence[float]]]
) -> dict[str, tuple[int, int]]:
    """Number of intervals that contain the true score, and of all, by algorithm and score."""
    counts: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    for evaluation in evaluations:
        for key, (_, low, high) in evaluation.items():
            view, score = key.rsplit(" ", 1)
            count = counts[f"{view.rsplit('/', 1)[0]} {score}"]
            count[0] += low <= truth[key][0] <= high
            count[1] += 1
    return {key: (covered, total) for key, (covered, total) in counts.items()}


def summarize(counts: Mapping[str, Mapping[str, tuple[int, int]]]) -> list[dict[str, Any]]:
    """Coverage by algorithm and score over all scenes, and the scene with the least."""
    keys = {key: None for scene in counts.values() for key in scene}
    rows = []
    for key in keys:
        scenes = {name: scene[key] for name, scene in counts.items() if key in scene}
        worst = min(scenes, key=lambda name: scenes[name][0] / scenes[name][1])
        covered, total = (sum(values) for values in zip(*scenes.values(), strict=True))
        algorithm, score = key.rsplit(" ", 1)
        rows.append(
            {
                "algorithm": algorithm,
                "score": score,
                "covered": covered,
                "intervals": total,
                "coverage": covered / total,
                "worst_scene": worst,
                "worst_coverage": scenes[worst][0] / scenes[worst][1],
            }
        )
    return sorted(rows, key=lambda row: (row["coverage"], row["worst_coverage"]))


def table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Markdown table of a mode, lowest coverage first."""
    lines = ["| algorithm | score | covered | of | share | lowest of a scene |", "|" + "---|" * 6]
    return lines + [
        f"| `{r['algorithm']}` | `{r['score']}` | {r['covered']} | {r['intervals']} "
        f"| {r['coverage']:.1%} | {r['worst_coverage']:.0%} ({r['worst_scene']}) |"
        for r in rows
    ]


def page(modes: Mapping[str, Sequence[Mapping[str, Any]]], seeds: Mapping[str, int]) -> str:
    """Markdown page with the coverage in each mode."""
    low, high = _TARGET
    lines = [
        "# Coverage of the intervals of scores",
        "",
        f"Share of {1 - INTERVAL_LEVEL:.0%} intervals that contain the score with {FACTOR} times "
        f"the samples of a preview. Target: {low:.0%} to {high:.0%}.",
    ]
    for mode, rows in modes.items():
        covered, total = (sum(row[key] for row in rows) for key in ("covered", "intervals"))
        inside = sum(low <= row["coverage"] <= high for row in rows)
        below = sum(row["coverage"] < low for row in rows)
        lines += [
            "",
            f"## {mode}",
            "",
            f"{seeds[mode]} seeds. All scores: {covered} of {total}, {covered / total:.1%}. Of "
            f"{len(rows)} scores, {inside} are in the target, {below} below and "
            f"{len(rows) - inside - below} above it.",
            "",
            *table(rows),
        ]
    return "\n".join([*lines, ""])


def main() -> None:
    """Evaluate all scenes and seeds, and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--previews", type=int, default=40, help="seeds with preview samples")
    parser.add_argument("--defaults", type=int, default=40, help="seeds with default samples")
    options = parser.parse_args()
    seeds = {"preview": options.previews, "default": options.defaults}
    truth = {scene: stored(scene, "truth", _TRUTH_SEED) for scene in options.scenes}
    for number in range(1, max(seeds.values()) + 1):
        for mode in seeds:
            for scene in options.scenes if number <= seeds[mode] else ():
                stored(scene, mode, number)
    modes = {}
    for mode, count in seeds.items():
        evaluations = {
            scene: [stored(scene, mode, number) for number in range(1, count + 1)]
            for scene in options.scenes
        }
        modes[mode] = summarize(
            {scene.stem: count_covered(truth[scene], evaluations[scene]) for scene in truth}
        )
    options.out.mkdir(parents=True, exist_ok=True)
    document = json.dumps({"seeds": seeds, "factor": FACTOR, "coverage": modes}, indent=1)
    (options.out / "coverage.json").write_text(document + "\n", "utf-8")
    (options.out / "coverage.md").write_text(page(modes, seeds), "utf-8")


if __name__ == "__main__":
    main()
