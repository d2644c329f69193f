"""What algorithms make of one picture, and of several cameras, relic by relic, the worst first.

    python -m reports.one_picture.run scenes/*.xml MORE.xml ... -o reports/one_picture

Each scene is validated by `inim.validate`, from three eyes, with the settings it has. A scanned
relic becomes a scene by `inim new-scene`. A run that is there already, below ``out/one_picture``,
is taken as it is: remove it after a change.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

RUNS = Path("out", "one_picture")
_ONE, _FOUR = "template", "template:samples=4"
_SOLID, _SOLID_FOUR = "template:columns=solid", "template:columns=solid:samples=4"
_RIVALS = ("wang2024", "wang2024:matching=ray", "gu2020", "li2012")
_LAYERED = "layered"
_CAMERAS = tuple(f"cameras:views={views}" for views in (1, 2, 5, 9))
_EYES = "centre,right,up"
_ALGORITHMS = (_FOUR, _ONE, _SOLID_FOUR, _SOLID, *_RIVALS, *_CAMERAS, _LAYERED)
_SCORES = {"eia_psnr_db": "EIA PSNR, dB", "relic_ssim": "SSIM on the relic, to the reference"}
# How far `layered` may be from the noise floor.
_CLOSE_DB = 2.0


def validated(scene: Path) -> dict[str, Any]:
    """The report of a scene's validation, made if it is not there."""
    folder = RUNS / scene.stem
    if not (folder / "report.json").is_file():
        command = ["-m", "inim.validate", str(scene), "--algorithms", ",".join(_ALGORITHMS)]
        command += ["--viewpoints", _EYES, "-o", folder.as_posix(), "--quiet"]
        print(scene.stem, flush=True)
        subprocess.run([sys.executable, *command], check=True)
    report: dict[str, Any] = json.loads((folder / "report.json").read_text("utf-8"))
    return report


def scored(name: str, report: Mapping[str, Any]) -> dict[str, Any]:
    """What is compared of a relic: each algorithm's EIA and the mean of its views."""
    algorithms = report["algorithms"]
    return {
        "relic": name,
        "noise_floor_db": report["noise_floor"]["eia"]["psnr_db"],
        "eia_psnr_db": {a: algorithms[a]["eia"]["psnr_db"] for a in _ALGORITHMS},
        "relic_ssim": {
            a: fmean(v["ssim_on_relic_to_reference"] for v in algorithms[a]["views"].values())
            for a in _ALGORITHMS
        },
    }


def lead(row: Mapping[str, Any], score: str, algorithm: str) -> float:
    """How far an algorithm of one picture is above the best of the others."""
    scores: Mapping[str, float] = row[score]
    return scores[algorithm] - max(scores[a] for a in _RIVALS)


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What the study is for, in numbers."""
    gains = [r["eia_psnr_db"][_FOUR] - r["eia_psnr_db"][_SOLID_FOUR] for r in rows]
    to_layered = [r["eia_psnr_db"]["cameras:views=5"] - r["eia_psnr_db"][_LAYERED] for r in rows]
    to_floor = [r["eia_psnr_db"][_LAYERED] - r["noise_floor_db"] for r in rows]
    ahead = {
        f"`{algorithm}`, {title}:": sum(lead(r, score, algorithm) > 0 for r in rows)
        for algorithm in (_FOUR, _ONE)
        for score, title in _SCORES.items()
    }
    return {
        "relics": len(rows),
        "ahead_of_all_rivals": ahead,
        "mean_gain_over_solid_db": fmean(gains),
        "least_gain_over_solid_db": min(gains),
        "five_cameras_to_layered_db": [min(to_layered), max(to_layered)],
        "layered_to_floor_db": [min(to_floor), max(to_floor)],
        "layered_within_2_db": sum(d > -_CLOSE_DB for d in to_floor),
    }


def page(rows: Sequence[Mapping[str, Any]], found: Mapping[str, Any], command: str) -> str:
    """The study as Markdown."""
    n = found["relics"]
    low, high = found["layered_to_floor_db"]
    lines = [
        "# One picture, relic by relic",
        "",
        f"Made by `{command}`, whose docstring says how. The worst relic first.",
        "",
        f"* Above all of {', '.join(f'`{a}`' for a in _RIVALS)}, of {n} relics:",
        *(f"  {k} on {v}" for k, v in found["ahead_of_all_rivals"].items()),
        f"* `{_FOUR}` over `{_SOLID_FOUR}`: {found['mean_gain_over_solid_db']:.1f} dB in the mean, "
        f"{found['least_gain_over_solid_db']:.1f} dB at least.",
        f"* Five cameras are {found['five_cameras_to_layered_db'][0]:+.1f} to "
        f"{found['five_cameras_to_layered_db'][1]:+.1f} dB from `layered`.",
        f"* `layered` is {low:+.1f} to {high:+.1f} dB from the noise floor, on "
        f"{found['layered_within_2_db']} of {n} within {_CLOSE_DB:g} dB of it or above.",
    ]
    for score, title in _SCORES.items():
        digits = 1 if score == "eia_psnr_db" else 3
        floor = score == "eia_psnr_db"
        heads = ["relic", *(f"`{a}`" for a in _ALGORITHMS), *(["noise floor"] if floor else [])]
        ends = " --: |" * (len(heads) - 1)
        lines += ["", f"## {title}", "", f"| {' | '.join(heads)} |", f"| --- |{ends}"]
        for row in sorted(rows, key=lambda r: lead(r, score, _FOUR)):
            cells = [f"{row[score][a]:.{digits}f}" for a in _ALGORITHMS]
            cells += [f"{row['noise_floor_db']:.1f}"] if floor else []
            lines.append(f"| {row['relic']} | {' | '.join(cells)} |")
        means = [f"{fmean(r[score][a] for r in rows):.{digits}f}" for a in _ALGORITHMS]
        means += [f"{fmean(r['noise_floor_db'] for r in rows):.1f}"] if floor else []
        lines.append(f"| **mean** | {' | '.join(means)} |")
    return "\n".join(lines) + "\n"


def main(argv: Sequence[str] | None = None) -> None:
    """Validate the scenes and write the tables."""
    parser = argparse.ArgumentParser(prog="python -m reports.one_picture.run")
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    args = parser.parse_args(argv)
    rows = [scored(scene.stem, validated(scene)) for scene in args.scenes]
    found = summary(rows)
    command = "python -m reports.one_picture.run SCENE.xml ... -o reports/one_picture"
    args.out.mkdir(parents=True, exist_ok=True)
    data = json.dumps({"summary": found, "relics": rows}, indent=1)
    (args.out / "one_picture.json").write_text(data + "\n", "utf-8")
    (args.out / "one_picture.md").write_text(page(rows, found, command), "utf-8")


if __name__ == "__main__":
    main()
