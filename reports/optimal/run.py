"""Compare the optimal EIA with the other algorithms, through pinholes and thick lenses.

    python -m reports.optimal.run scenes/altar.xml scenes/amphora.xml ... -o reports/optimal

Each scene is validated with both lens models; finished validations in the working folder are read
again. The page lists the mean PSNR of whole views to the ground truth, which `optimal` maximises.
For the first scene, finished EIAs are also seen from viewpoints in between, for which they are not
optimised. `reports.bench.optimal.run` measures the time.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import inim
from inim.lens import LensModelName
from inim.report import Report

LENS_MODELS: tuple[LensModelName, ...] = ("pinhole", "thick")
OPTIMAL, REFERENCE = "optimal", "reference"
ALGORITHMS = (OPTIMAL, "template", "template:samples=1", "layered")
#: Viewpoints between the five default ones, in mm at the default distance of a nominal display.
IN_BETWEEN = "a=12 11, b=-10 12, c=-12 -10, d=11 -12"


def mean_psnr(views: Mapping[str, Mapping[str, float | None]]) -> float:
    """Mean PSNR of whole views to the ground truth, dB; None in a report is infinite."""
    values = (view["psnr_db"] for view in views.values())
    return fmean(math.inf if value is None else value for value in values)


def score_scene(scene: Path, lens_model: LensModelName, work: Path, lazy: bool) -> dict[str, Any]:
    """Mean view PSNR of all algorithms and of the reference.

    `lazy` leaves out panel pixels that no view shows, which does not change the views.
    """
    folder = work / f"{scene.stem}-{lens_model}"
    if (folder / "report.json").is_file():
        report = Report.load(folder)
    else:
        report = inim.validate(
            scene, folder, lens_model=lens_model, algorithms=ALGORITHMS, lazy=lazy
        )
    algorithms = report.data.algorithms
    psnr_db = {name: mean_psnr(result.views) for name, result in algorithms.items()}
    psnr_db[REFERENCE] = mean_psnr(report.data.reference.views)
    return {"relic": scene.stem, "lens_model": lens_model, "psnr_db": psnr_db}


def score_in_between(scene: Path, lens_model: LensModelName, work: Path) -> dict[str, Any]:
    """Mean view PSNR of finished EIAs from viewpoints in between."""
    folder = work / f"{scene.stem}-{lens_model}" / "eia"
    report = inim.validate(
        scene, work / f"{scene.stem}-{lens_model}-between", lens_model=lens_model,
        algorithms="none", viewpoints=IN_BETWEEN,
        eias={f"finished-{name}": folder / f"{name}.exr" for name in (OPTIMAL, "template")},
    )  # fmt: skip
    psnr_db = {
        name.removeprefix("finished-"): mean_psnr(result.views)
        for name, result in report.data.algorithms.items()
    }
    psnr_db[REFERENCE] = mean_psnr(report.data.reference.views)
    return {"relic": scene.stem, "lens_model": lens_model, "psnr_db": psnr_db}


def lead(row: Mapping[str, Any]) -> float:
    """Mean view PSNR of `optimal` minus that of the best other EIA, dB."""
    return float(row["psnr_db"][OPTIMAL] - row["psnr_db"][_best_other(row)])


def _best_other(row: Mapping[str, Any]) -> str:
    others = [name for name in row["psnr_db"] if name != OPTIMAL]
    best: str = max(others, key=lambda name: row["psnr_db"][name])
    return best


def write_page(data: Mapping[str, Any]) -> str:
    """Markdown page with the smallest lead first."""
    rows: Sequence[Mapping[str, Any]] = sorted(data["rows"], key=lead)
    names = [*ALGORITHMS, REFERENCE]
    lines = [
        "# The optimal EIA and the other algorithms",
        "",
        "Made by `python -m reports.optimal.run SCENE.xml ... -o reports/optimal`.",
        "",
        "Mean PSNR in dB of the whole views to the ground truth, at the five default viewpoints of",
        "the nominal display, corrected for noise. The smallest lead of `optimal` is first.",
        "",
        f"| relic | lens model | {' | '.join(f'`{n}`' for n in names)} | best other | lead |",
        f"| --- | --- |{' --: |' * len(names)} --- | --: |",
    ]
    for row in rows:
        scores = " | ".join(f"{row['psnr_db'][name]:.2f}" for name in names)
        lines.append(
            f"| {row['relic']} | {row['lens_model']} | {scores} | {_best_other(row)} | "
            f"{lead(row):.2f} |"
        )
    lines += ["", _between_page(data["in_between"])]
    return "\n".join(lines) + "\n"


def _between_page(rows: Sequence[Mapping[str, Any]]) -> str:
    """Scores from viewpoints for which `optimal` is not optimised."""
    names = (OPTIMAL, "template", REFERENCE)
    lines = [
        "## Between the viewpoints",
        "",
        "The same EIAs from four other viewpoints. `optimal` is not made for them and loses there:",
        "it bounds the scores of the viewpoints of its own run, and is not an EIA to display.",
        "",
        f"| relic | lens model | {' | '.join(f'`{name}`' for name in names)} |",
        f"| --- | --- |{' --: |' * len(names)}",
    ]
    for row in rows:
        scores = " | ".join(f"{row['psnr_db'][name]:.2f}" for name in names)
        lines.append(f"| {row['relic']} | {row['lens_model']} | {scores} |")
    return "\n".join(lines)


def main() -> None:
    """Validate the scenes and write the page and its data."""
    parser = argparse.ArgumentParser(prog="python -m reports.optimal.run")
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--work", type=Path, default=Path("out/optimal"))
    args = parser.parse_args()
    data = {
        "rows": [
            score_scene(scene, model, args.work, lazy=scene != args.scenes[0])
            for scene in args.scenes
            for model in LENS_MODELS
        ],
        "in_between": [score_in_between(args.scenes[0], m, args.work) for m in LENS_MODELS],
    }
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "optimal.json").write_text(json.dumps(data, indent=1) + "\n", "utf-8")
    (args.out / "optimal.md").write_text(write_page(data), "utf-8")


if __name__ == "__main__":
    main()
