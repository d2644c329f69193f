"""Time of a whole validation until its headline scores are precise, for this code and another.

    python -m reports.bench.precision.run SCENE.xml ... --other CHECKOUT -o reports/bench/precision

Each run is a process of its own, with an empty result cache and compiled kernels, timed from start
to end. The runs of a scene alternate between both codes. A run is precise if the half width of the
95 % interval of SSIM on the relic, to the reference, is at most 0.01: in the mean over the
viewpoints, for the less precise algorithm. Both codes are asked for that (`inim.score_error`).
The half width falls with the root of the number of samples, and the time of a run grows at most in
proportion to it: time x (half width)^2 compares runs of different precision.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from statistics import fmean, geometric_mean, median
from typing import Any

from inim.report.labels import MISSING, number
from inim.report.study import PagePart
from inim.scores.metrics import HEADLINE
from inim.system.cache import FOLDER_VARIABLE
from reports.bench.study import doubts, run_validation
from reports.study import ROOT, Results, Study, add_scenes, table

ALGORITHMS = "template,wang2024"
ERROR = 0.01


def validate(scene: Path, code: Path, *further: str) -> tuple[float, dict[str, Any]]:
    """Seconds of a validation by the code of a checkout, and its report."""
    with tempfile.TemporaryDirectory() as out:
        words = ["inim.validate", str(scene.resolve()), "--quiet", "--algorithms", ALGORITHMS]
        words += ["-D", f"inim.score_error={ERROR}", *further]
        variables = {**os.environ, FOLDER_VARIABLE: "off", "PYTHONPATH": str(code.resolve())}
        variables["PYTHONSAFEPATH"] = "1"  # not the code of the working folder
        seconds = run_validation([*words, "-o", out], variables, f"{scene.name}, {code}")["seconds"]
        report = json.loads(Path(out, "report.json").read_text("utf-8"))
    return seconds, report


def half_width(report: Mapping[str, Any]) -> float:
    """Half width of the headline's interval, of the less precise algorithm of a report."""
    widths = []
    for algorithm in report["algorithms"].values():
        intervals = [view[HEADLINE]["interval"] for view in algorithm["precision"].values()]
        widths.append(fmean((high - low) / 2 for low, high in intervals))
    return max(widths)


def measure(scene: Path, other: Path, runs: int) -> dict[str, list[dict[str, float]]]:
    """Runs of both codes in alternation, after a preview by each that compiles kernels."""
    codes = {"this": ROOT, "other": other}
    results: dict[str, list[dict[str, float]]] = {name: [] for name in codes}
    for code in codes.values():
        validate(scene, code, "--preview")
    for _ in range(runs):
        for name, code in codes.items():
            seconds, report = validate(scene, code)
            results[name].append({"seconds": seconds, "half_width": half_width(report)})
    return results


def page(results: Results) -> tuple[list[str], list[PagePart]]:
    """Times of all scenes, the slowest first."""
    rows = sorted(map(_row, results, results.values()), key=lambda row: -row["this"])
    columns = {
        "scene": lambda r: r["scene"],
        "seconds": lambda r: number(r["this"], 1),
        "before": lambda r: number(r["other"], 1),
        "ratio": lambda r: number(r["this"] / r["other"], 2),
        "half width": lambda r: f"{r['half_width']:.4f}",
        "half width before": lambda r: f"{r['half_width_before']:.4f}",
        "ratio at equal precision": lambda r: number(_equal_ratio(r), 2),
        "precise": lambda r: "yes" if r["half_width"] <= ERROR else "no",
    }
    whole, equal = (
        number(geometric_mean(map(ratio, rows)), 2) if rows else MISSING
        for ratio in (lambda r: r["this"] / r["other"], _equal_ratio)
    )
    precise = sum(row["half_width_before"] <= ERROR for row in rows)
    remark = (
        f"A cold validation of {ALGORITHMS.replace(',', ' and ')} takes {whole} times as long as "
        f"before, in the geometric mean over {len(rows)} scenes, of which {precise} were precise "
        f"before. At equal precision it takes {equal} of the time: time x (half width)^2."
    )
    lead = "Medians of alternating runs with an empty result cache."
    tables = [table(f"Time to a headline interval of ±{ERROR}", rows, columns)]
    return [remark], [PagePart("precision", "Time to a precise score", lead, tables)]


def _equal_ratio(row: Mapping[str, Any]) -> float:
    """Ratio of time x (half width)^2 of this code to that of the other one."""
    return float(row["this"] / row["other"] * (row["half_width"] / row["half_width_before"]) ** 2)


def _row(scene: str, runs: Mapping[str, Any]) -> dict[str, Any]:
    def middle(code: str, key: str) -> float:
        return float(median(run[key] for run in runs[code]))

    return {
        "scene": scene,
        "this": middle("this", "seconds"),
        "other": middle("other", "seconds"),
        "half_width": middle("this", "half_width"),
        "half_width_before": middle("other", "half_width"),
    }


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the scenes, the other code and the number of runs."""
    add_scenes(parser)
    parser.add_argument("--other", type=Path, required=True, help="checkout of the code before")
    parser.add_argument("--runs", type=int, default=1, help="counted runs of each code (1)")


def cases(args: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """One case for each scene."""
    return {
        scene.stem: {"scene": scene, "other": args.other, "runs": args.runs}
        for scene in args.scenes
    }


STUDY = Study(
    "reports.bench.precision.run", "Bench: time to a precise score", __doc__, arguments, cases,
    measure, page, stem="bench", doubts=doubts,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(STUDY.main())
