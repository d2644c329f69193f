"""Measure false alarms and power of the comparison with a baseline.

    python -m reports.regression.run scenes/jade.xml scenes/amphora.xml -o reports/regression

A scene is validated with many seeds, and every two runs are compared: each alarm is false. For the
power, a change is planted into the picture that the algorithm gets in some of the runs, and these
are compared with all sound runs of other seeds. The smallest change that nine of ten comparisons
find is interpolated between the measured ones.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

from inim.display.settings import PREFIX
from inim.generators import parse_algorithm
from inim.image.rgbd import RGBD
from inim.pipeline.baseline import collect_statistics
from inim.pipeline.job import setup
from inim.pipeline.plan import make_plan
from inim.pipeline.request import Request
from inim.pipeline.stages.capture import CapturedInput
from inim.pipeline.stages.generation import prepare_generator
from inim.pipeline.stages.reconstruction import DisplayViews, reconstruct_views
from inim.pipeline.stages.scoring import compute_truth_statistics, score_method
from inim.pipeline.validate import evaluate
from inim.report.study import PagePart
from inim.scores.metrics import HEADLINE
from inim.scores.regression.comparison import compare
from inim.scores.regression.run_statistics import RunStatistics
from inim.scores.regression.verdict import FALSE_ALARM_RATE, binomial_interval
from inim.system.process.observer import Observer
from reports.study import CODE, Results, Study, add_scenes, entry, table

ALGORITHM = "template"
_SETTINGS = {
    "lens_columns": 16, "lens_rows": 16, "capture_spp": 64, "eia_spp": 64, "view_spp": 64,
    "reconstruction_spp": 16,
}  # fmt: skip
_VIEWPOINTS = ("left", "centre")
_FOUND = 0.9
_KINDS = ("picture", "noise", "score", "light")


def darker(rgbd: RGBD, size: float) -> RGBD:
    """Darken a picture by a share."""
    return replace(rgbd, color=np.float32(1 - size) * rgbd.color)


def redder(rgbd: RGBD, size: float) -> RGBD:
    """Brighten red by a share."""
    factors = np.array([1 + size, 1, 1], np.float32)
    return replace(rgbd, color=(rgbd.color * factors).astype(np.float32))


def deeper(rgbd: RGBD, size: float) -> RGBD:
    """Scale the depth by one plus a share."""
    return replace(rgbd, depth_mm=np.float32(1 + size) * rgbd.depth_mm)


def shifted(rgbd: RGBD, size: float) -> RGBD:
    """Shift the colours to the right by a share of a picture pixel."""
    mixed = (1 - size) * rgbd.color + size * np.roll(rgbd.color, 1, axis=1)
    return replace(rgbd, color=mixed.astype(np.float32))


#: Changes of a picture, and the sizes to plant.
CHANGES: Mapping[str, tuple[Callable[[RGBD, float], RGBD], tuple[float, ...]]] = {
    "brightness": (darker, (0.0025, 0.005, 0.01, 0.02, 0.04)),
    "red": (redder, (0.0025, 0.005, 0.01, 0.02, 0.04)),
    "depth": (deeper, (0.003, 0.01, 0.03, 0.1)),
    "position, picture pixels": (shifted, (0.03, 0.1, 0.3, 1.0)),
}


def run_seed(
    scene: Path, seed: int, changes: Iterable[tuple[str, float]]
) -> tuple[RunStatistics, dict[tuple[str, float], RunStatistics]]:
    """Statistics of a run, and those of the same run with each of the changes."""
    settings = {f"{PREFIX}{key}": value for key, value in (_SETTINGS | {"seed": seed}).items()}
    plan = make_plan(Request(
        scene, Path("unused"), algorithms=(ALGORITHM,), viewpoints=_VIEWPOINTS,
        definitions=settings,
    ))  # fmt: skip
    run, renderer, images = setup(plan, Path("unused"), Observer(), data_only=True)
    with images.thread, run.ahead:
        sound = evaluate(plan, renderer, images, run)
        display_views = DisplayViews(plan.viewpoints, plan.optics, renderer, run=run)
        generate = prepare_generator(
            parse_algorithm(ALGORITHM), sound.capture.camera, None, display_views.observed, run=run
        )
        truth = compute_truth_statistics(sound.truth, sound.reference_scores, run=run)
        changed = {}
        for name, size in changes:
            pictures = [CHANGES[name][0](p, size) for p in sound.capture.inputs[RGBD].parts or ()]
            output = generate(replace(sound.capture, inputs={RGBD: CapturedInput.of(pictures)}))
            views = reconstruct_views(ALGORITHM, output.eia, display_views, run=run)
            result = score_method(ALGORITHM, output, views, sound.truth, run=run)
            evaluation = replace(sound, results={ALGORITHM: result})
            changed[name, size] = collect_statistics(evaluation, truth)
        return collect_statistics(sound, truth), changed


def _alarms(baseline: RunStatistics, candidate: RunStatistics) -> set[str]:
    """Kinds of the checks that fail; empty if the verdict is a pass."""
    comparison = compare(baseline, candidate)
    if comparison.verdict == "passed":
        return set()
    return {str(check.kind) for check in comparison.checks if not check.passed} or {"improved"}


def measure(scene: Path, seeds: int, changed_seeds: int) -> dict[str, Any]:
    """False alarms of every two runs, and the power against each change."""
    sizes = [(name, size) for name, (_, sizes) in CHANGES.items() for size in sizes]
    runs = [run_seed(scene, n + 1, sizes if n < changed_seeds else ()) for n in range(seeds)]
    sound = [statistics for statistics, _ in runs]
    alarms = Counter(dict.fromkeys(("any", *_KINDS), 0))
    pairs = [*combinations(sound, 2)]
    for a, b in pairs:
        kinds = _alarms(a, b)
        alarms.update([*kinds, *(["any"] if kinds else [])])
    power: dict[str, list[dict[str, Any]]] = {name: [] for name in CHANGES}
    for name, size in sizes:
        candidates = [(i, runs[i][1][name, size]) for i in range(changed_seeds)]
        kinds_found = [
            _alarms(baseline, candidate)
            for i, candidate in candidates
            for j, baseline in enumerate(sound)
            if j != i
        ]
        power[name].append({
            "size": size,
            "found": fmean(map(bool, kinds_found)),
            "ssim": fmean(_headline(changed) - _headline(sound[i]) for i, changed in candidates),
            "by": sorted(set().union(*kinds_found)),
        })  # fmt: skip
    return {"runs": seeds, "comparisons": len(pairs), "alarms": alarms, "power": power}


def _headline(run: RunStatistics) -> float:
    return run.scores[f"{ALGORITHM}/{_VIEWPOINTS[-1]}"][HEADLINE].value


def smallest_found(rows: Iterable[Mapping[str, Any]], key: str = "size") -> float | None:
    """Size, or change of SSIM, that is found nine times in ten; None above the largest one."""
    points = [(0.0, 0.0), *((row["found"], abs(row[key])) for row in rows)]
    for (low, small), (high, large) in pairwise(points):
        if high >= _FOUND > low:
            return float(small + (large - small) * (_FOUND - low) / (high - low))
    return None


def page(results: Results) -> tuple[list[str], list[PagePart]]:
    """Rates of false alarms with intervals, and the power by change."""

    def highest_rate(row: Any) -> str:
        count, total = row[1]["alarms"]["any"], row[1]["comparisons"]
        return f"{1000 * binomial_interval(count, total, 0.05)[1]:.2f}"

    def smallest(row: Any, key: str = "size") -> str:
        size = smallest_found(row[2], key)
        return f"> {abs(row[2][-1][key]):.3g}" if size is None else f"{size:.2g}"

    alarms = table(
        "Comparisons of unchanged runs with an alarm",
        results.items(),
        {
            "scene": entry(0),
            "comparisons": entry(1, "comparisons"),
            **{kind: entry(1, "alarms", kind) for kind in ("any", *_KINDS)},
            "per 1,000, at most": highest_rate,
        },
    )
    rows = [
        (scene, name, r) for scene, result in results.items() for name, r in result["power"].items()
    ]
    power = table(
        "Smallest change that is found nine times in ten",
        rows,
        {
            "scene": entry(0),
            "change": entry(1),
            "smallest found": smallest,
            "change of SSIM there": lambda row: smallest(row, "ssim"),
            "found by size": lambda row: ", ".join(
                f"{r['size']:g}: {r['found']:.0%}" for r in row[2]
            ),
            "by": lambda row: ", ".join(row[2][-1]["by"]),
        },
    )
    settings = ", ".join(f"{key} {value}" for key, value in _SETTINGS.items())
    remarks = [
        f"Algorithm {ALGORITHM}, viewpoints {' and '.join(_VIEWPOINTS)}; {settings}.",
        "Every two runs are compared, so the comparisons are not independent. The upper end of the "
        "rate is that of as many independent comparisons, with 95 % confidence.",
        "The changes are planted into the picture of the algorithm, not into its code: the check "
        "of the reference input, which finds any change of the code, does not see them.",
    ]
    return remarks, [
        PagePart("alarms", "False alarms", "", [alarms]),
        PagePart("power", "Power", "", [power]),
    ]


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the scenes and the numbers of runs."""
    add_scenes(parser)
    parser.add_argument("--seeds", type=int, default=64, help="runs of each scene (64)")
    parser.add_argument("--changed", type=int, default=8, help="runs with changes (8)")


def cases(args: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Each scene."""
    return {
        scene.stem: {"scene": scene, "seeds": args.seeds, "changed_seeds": args.changed}
        for scene in args.scenes
    }


def passed(results: Results) -> bool:
    """True unless more alarms were counted than the promised rate lets expect."""
    return all(
        binomial_interval(r["alarms"]["any"], r["comparisons"], 0.05)[0] <= FALSE_ALARM_RATE
        for r in results.values()
    )


STUDY = Study(
    "reports.regression.run", "False alarms and power of the comparison with a baseline", __doc__,
    arguments, cases, measure, page, passed=passed, code=(*CODE, "inim/scores"),
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(STUDY.main())
