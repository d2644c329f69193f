"""Time of whole validations against the error of their scores, for several sample counts.

    python -m reports.bench.samples.run scenes/amphora.xml scenes/jade.xml -o reports/bench/samples

Every scene is validated from the centre with several sample counts and seeds, and once with many
more samples. The errors are relative to the noise-corrected scores of that validation.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from inim.cache import FOLDER_VARIABLE
from inim.report.labels import number
from inim.report.plots import draw_front, draw_point, new_figure, plain_ticks, style
from inim.report.study import PagePart, Table
from reports.bench.parts import items, part
from reports.bench.study import new_parser, run_study, run_validation

ALGORITHM = "template"
# Samples per pixel of the ground-truth EIA and of the ground-truth view.
LEVELS = ((16, 32), (32, 64), (64, 256))
_REFERENCE = {"eia_spp": 128, "view_spp": 512, "capture_spp": 128, "reconstruction_spp": 128}
_SEEDS = (1,)
# Scores of a view, by method.
SCORES = {
    ALGORITHM: (
        "ssim_on_relic_to_reference", "ssim_on_relic", "flip_on_relic_to_reference", "flip_on_relic"
    ),
    "reference": ("ssim_on_relic", "flip_on_relic"),
}  # fmt: skip


def bench_samples(
    scenes: Sequence[Path],
    listener: Any,
    folder: Path,
    variables: Mapping[str, str],
    levels: Sequence[tuple[int, int]] = LEVELS,
    seeds: Sequence[int] = _SEEDS,
    options: Sequence[str] = (),
) -> dict[str, Any]:
    """Validate every scene at every level with every seed.

    Parameters
    ----------
    scenes : sequence of Path
    listener : Observer
    folder : Path
        Empty folder for the reports.
    variables : mapping of str to str
        Environment variables of the validations.
    levels : sequence of (int, int)
    seeds : sequence of int
        The reference has seed 0.
    options : sequence of str
        Further options of the validations.

    Returns
    -------
    dict
        Under the names of bench.json, for each validation: `seconds`, wall-clock time of its
        process; `processor_seconds` of all its processes; and for each score `plain`, `value`, half
        the width of its interval, and the reference's value.
    """

    def validate(scene: Path, seed: int, settings: Mapping[str, int]) -> dict[str, Any]:
        listener.stage(f"{scene.stem}: {settings['eia_spp']}, {settings['view_spp']}, seed {seed}")
        out = folder / "report"
        shutil.rmtree(out, ignore_errors=True)
        command = ["inim.validate", str(scene), "-o", str(out), *options]
        command += ["--algorithms", ALGORITHM, "--viewpoints", "centre", "--quiet"]
        for name, value in {**settings, "seed": seed}.items():
            command += ["-D", f"inim.{name}={value}"]
        run = run_validation(command, {**variables, FOLDER_VARIABLE: "off"}, str(scene))
        report = json.loads((out / "report.json").read_text("utf-8"))
        times = {key: run[key] for key in ("seconds", "processor_seconds")}
        return {**times, "scores": _scores(report)}

    runs = []
    for scene in scenes:
        reference = validate(scene, 0, _REFERENCE)["scores"]
        for eia_spp, view_spp in levels:
            for seed in seeds:
                settings = {"eia_spp": eia_spp, "view_spp": view_spp}
                run = validate(scene, seed, settings)
                for name, score in run["scores"].items():
                    score["reference"] = reference[name]["value"]
                runs.append({"scene": scene.stem, "seed": seed, **settings, **run})
                listener.line(
                    f"{scene.stem:12} {eia_spp:4} {view_spp:4}  "
                    f"{run['processor_seconds']:6.1f} s  rms error "
                    f"{_rms([runs[-1]], 'plain', 'ssim'):.4f} uncorrected, "
                    f"{_rms([runs[-1]], 'value', 'ssim'):.4f} noise-corrected"
                )
    return {"algorithm": ALGORITHM, "reference": _REFERENCE, "runs": runs}


def _scores(report: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    """Scores of the centre view, by ``METHOD SCORE``."""
    scores = {}
    for name, keys in SCORES.items():
        method = report["reference"] if name == "reference" else report["algorithms"][name]
        for key in keys:
            precision = method["precision"]["centre"][key]
            low, high = precision["interval"]
            scores[f"{name} {key}"] = {
                "plain": precision["plain"],
                "value": method["views"]["centre"][key],
                "half_width": (high - low) / 2,
            }
    return scores


def _rms(runs: Iterable[Mapping[str, Any]], kind: str, metric: str) -> float:
    """Root mean square of errors or half widths, over runs and the scores of a metric."""
    values = [
        score[kind] - (0.0 if kind == "half_width" else score["reference"])
        for run in runs
        for name, score in run["scores"].items()
        if f" {metric}_" in name
    ]
    return math.sqrt(math.fsum(value**2 for value in values) / len(values))


# -- the report ---------------------------------------------------------------------------------


def parts_of(data: Mapping[str, Any]) -> list[PagePart]:
    """Part of the page: a table of all scenes, one per scene, and a plot of time against error."""
    runs = items(part(data, "samples"), "runs")
    scenes = list(dict.fromkeys(run["scene"] for run in runs))
    groups = {"All scenes": runs} | {s: [r for r in runs if r["scene"] == s] for s in scenes}
    lead = (
        "Whole validations from the centre, by the samples per pixel of the ground-truth EIA and "
        "of the ground-truth view. The scores on the relic are those of "
        f"{ALGORITHM} to the reference view and to the ground-truth view, and those of the "
        "reference view to the ground-truth view. Errors are relative to the noise-corrected "
        "scores of a validation with twice the largest sample count listed here. They are root "
        "mean squares over seeds and scores."
    )
    tables = [_table(name, group) for name, group in groups.items()]
    remark = (
        "Processor seconds of all processes of a validation, without the result cache; one view "
        "and one algorithm. Wall-clock seconds are in bench.json."
    )
    return [PagePart("samples", "Samples", lead, tables, "samples", _figure(groups), [remark])]


def _levels(runs: Iterable[Mapping[str, Any]]) -> dict[tuple[int, int], list[Mapping[str, Any]]]:
    levels: dict[tuple[int, int], list[Mapping[str, Any]]] = {}
    for run in runs:
        levels.setdefault((run["eia_spp"], run["view_spp"]), []).append(run)
    return levels


def _seconds(runs: Sequence[Mapping[str, Any]]) -> float:
    """Mean over scenes of the smallest processor time; other load can only increase a time."""
    least: dict[str, float] = {}
    for run in runs:
        least[run["scene"]] = min(run["processor_seconds"], least.get(run["scene"], math.inf))
    return math.fsum(least.values()) / len(least)


def _table(name: str, runs: Sequence[Mapping[str, Any]]) -> Table:
    heads = ["samples of EIA, view", "processor seconds"]
    kinds = {"plain": "uncorrected", "value": "noise-corrected", "half_width": "half interval"}
    for metric in ("SSIM", "FLIP"):
        heads += [f"{metric}, {label}" for label in kinds.values()]
    rows = [
        [
            f"{eia}, {view}",
            number(_seconds(group), 1),
            *(
                number(_rms(group, kind, metric), 4)
                for metric in ("ssim", "flip")
                for kind in kinds
            ),
        ]
        for (eia, view), group in _levels(runs).items()
    ]
    return Table(name, heads, rows)


def _figure(groups: Mapping[str, Sequence[Mapping[str, Any]]]) -> Any:
    """Time against the error of SSIM, a panel for each scene."""
    scenes = {name: runs for name, runs in groups.items() if name != "All scenes"}
    figure, axes = new_figure(len(scenes), 4.0, sharey=True)
    for axis, (name, runs) in zip(axes, scenes.items(), strict=True):
        for kind, label in (("plain", "uncorrected"), ("value", "noise-corrected")):
            points = [
                (_seconds(group), _rms(group, kind, "ssim")) for group in _levels(runs).values()
            ]
            for point in points:
                draw_point(axis, label, *point, kind == "value")
            draw_front(axis, points)
        style(
            axis,
            f"{name}: grey uncorrected, coloured noise-corrected",
            "processor seconds",
            "rms error of SSIM",
        )
        axis.set_xscale("log")
        axis.set_yscale("log")
        plain_ticks(axis)
    return figure


# -- the command --------------------------------------------------------------------------------


def main() -> int:
    """Run the study and return the exit code."""
    variables = dict(os.environ)  # copied before the backend adds its variables
    parser = new_parser(__doc__, "bench-samples")
    parser.add_argument("scenes", type=Path, nargs="+", help="Mitsuba scenes (.xml)")
    args = parser.parse_args()

    def measure(rounds: Any, listener: Any, folder: Path) -> dict[str, Any]:  # noqa: ARG001
        return {"samples": bench_samples(args.scenes, listener, folder, variables)}

    return run_study(args, "reports.bench.samples.run", "Bench: samples", measure, parts_of)


if __name__ == "__main__":
    sys.exit(main())
