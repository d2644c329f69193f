"""Compare the algorithms of one RGB-D picture, several cameras, and layers, on many relics.

    python -m reports.one_picture.run scenes/*.xml MORE.xml ... -o reports/one_picture

`inim.validate` validates each scene from three viewpoints with the scene's settings; `inim
new-scene` makes a scene from a scanned relic. Finished runs in ``out/one_picture`` are reused:
remove them after a change. The tables begin with the relic on which `template` leads least.
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
#: The default, and the same sources with nearest colours of four rays and of one.
_DEFAULT = "template"
_FOUR = "template:samples=4:colour=nearest"
_ONE = "template:samples=1:colour=nearest"
_SOLID = "template:columns=solid:samples=1:colour=nearest"
_SOLID_FOUR = "template:columns=solid:samples=4:colour=nearest"
#: The literature, with one ray per panel pixel and nearest colours.
_LITERATURE = ("wang2024", "wang2024:matching=ray", "gu2020", "li2012")
_FIVE_CAMERAS = "cameras:views=5"
_CAMERAS = ("cameras:views=1", "cameras:views=2", _FIVE_CAMERAS, "cameras:views=9")
_LAYERED = "layered"
ALGORITHMS = (_DEFAULT, _FOUR, _SOLID_FOUR, _ONE, _SOLID, *_LITERATURE, *_CAMERAS, _LAYERED)
_VIEWPOINTS = "centre,right,up"
_PSNR, _SSIM = "eia_psnr_db", "relic_ssim"
_TITLES = {_PSNR: "EIA PSNR, dB", _SSIM: "SSIM on the relic, to the reference"}
#: Targets: largest distance of five cameras from `layered`, and of `layered` from the noise floor.
_CAMERAS_DB, _FLOOR_DB = 0.5, 2.0


def validate_scene(scene: Path) -> dict[str, Any]:
    """Report of a scene's validation, from an earlier run if there is one."""
    folder = RUNS / scene.stem
    if not (folder / "report.json").is_file():
        command = ["-m", "inim.validate", str(scene), "--algorithms", ",".join(ALGORITHMS)]
        command += ["--viewpoints", _VIEWPOINTS, "-o", folder.as_posix(), "--quiet"]
        print(scene.stem, flush=True)
        subprocess.run([sys.executable, *command], check=True)
    report: dict[str, Any] = json.loads((folder / "report.json").read_text("utf-8"))
    return report


def collect_scores(name: str, report: Mapping[str, Any]) -> dict[str, Any]:
    """Scores of one relic by algorithm: PSNR of the EIA, and the mean SSIM of its views."""
    algorithms = report["algorithms"]
    return {
        "relic": name,
        "noise_floor_db": report["noise_floor"]["eia"]["psnr_db"],
        _PSNR: {name: algorithms[name]["eia"]["psnr_db"] for name in ALGORITHMS},
        _SSIM: {
            name: fmean(
                view["ssim_on_relic_to_reference"] for view in algorithms[name]["views"].values()
            )
            for name in ALGORITHMS
        },
    }


def lead(row: Mapping[str, Any], score: str, algorithm: str) -> float:
    """Score of an algorithm minus that of the best algorithm of the literature."""
    scores: Mapping[str, float] = row[score]
    return scores[algorithm] - max(scores[name] for name in _LITERATURE)


def summarize(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Numbers of relics on which each statement of the page holds, and extreme differences."""

    def differences(first: str, second: str) -> list[float]:
        return [row[_PSNR][first] - row[_PSNR][second] for row in rows]

    to_layered = differences(_FIVE_CAMERAS, _LAYERED)
    to_floor = [row[_PSNR][_LAYERED] - row["noise_floor_db"] for row in rows]
    return {
        "relics": len(rows),
        "above_the_literature": {
            f"`{algorithm}`, {title}": sum(lead(row, score, algorithm) > 0 for row in rows)
            for algorithm in (_DEFAULT, _FOUR, _ONE)
            for score, title in _TITLES.items()
        },
        "gain_over_solid_db": [min(differences(_ONE, _SOLID)), fmean(differences(_ONE, _SOLID))],
        "one_picture_to_layered_db": [
            min(differences(_DEFAULT, _LAYERED)),
            fmean(differences(_DEFAULT, _LAYERED)),
        ],
        "five_cameras_to_layered_db": [min(to_layered), max(to_layered)],
        "five_cameras_close": sum(value > -_CAMERAS_DB for value in to_layered),
        "five_cameras_above_one_picture": sum(
            value > 0 for value in differences(_FIVE_CAMERAS, _DEFAULT)
        ),
        "layered_to_floor_db": [min(to_floor), max(to_floor)],
        "layered_close": sum(value > -_FLOOR_DB for value in to_floor),
    }


def write_page(rows: Sequence[Mapping[str, Any]], summary: Mapping[str, Any]) -> str:
    """Markdown page with the summary and one table per score."""
    count = summary["relics"]
    lines = [
        "# One picture and several cameras, relic by relic",
        "",
        "Made by `python -m reports.one_picture.run SCENE.xml ... -o reports/one_picture`. Each",
        "table begins with the relic on which `template` leads the literature least.",
        "",
        f"Number of relics, of {count}, on which an algorithm is above all of "
        f"{', '.join(f'`{name}`' for name in _LITERATURE)}:",
        "",
        *(f"* {name}: {value}" for name, value in summary["above_the_literature"].items()),
        "",
        "Differences of EIA PSNR:",
        "",
        "* Columns that end, above solid columns, one ray per pixel: {:.1f} dB at least, {:.1f} dB "
        "on average.".format(*summary["gain_over_solid_db"]),
        "* `template`, from one picture, to `layered`: {:.1f} dB at worst, {:.1f} dB on "
        "average.".format(*summary["one_picture_to_layered_db"]),
        "* Five cameras to `layered`: {:+.2f} to {:+.2f} dB; ".format(
            *summary["five_cameras_to_layered_db"]
        )
        + f"within {_CAMERAS_DB} dB or above on {summary['five_cameras_close']} relics; above "
        f"`template` on {summary['five_cameras_above_one_picture']}.",
        "* `layered` to the noise floor: {:+.1f} to {:+.1f} dB; ".format(
            *summary["layered_to_floor_db"]
        )
        + f"within {_FLOOR_DB:g} dB or above on {summary['layered_close']} relics.",
    ]
    for score, title in _TITLES.items():
        lines += ["", f"## {title}", "", *_table(rows, score)]
    return "\n".join(lines) + "\n"


def _table(rows: Sequence[Mapping[str, Any]], score: str) -> list[str]:
    """Markdown table of one score, with a row of means; EIA PSNR has the noise floor, too."""
    digits = 1 if score == _PSNR else 3
    columns = {f"`{name}`": [row[score][name] for row in rows] for name in ALGORITHMS}
    if score == _PSNR:
        columns["noise floor"] = [row["noise_floor_db"] for row in rows]
    order = sorted(range(len(rows)), key=lambda index: lead(rows[index], score, _DEFAULT))
    lines = [f"| relic | {' | '.join(columns)} |", f"| --- |{' --: |' * len(columns)}"]
    for index in order:
        cells = [f"{values[index]:.{digits}f}" for values in columns.values()]
        lines.append(f"| {rows[index]['relic']} | {' | '.join(cells)} |")
    means = [f"{fmean(values):.{digits}f}" for values in columns.values()]
    return [*lines, f"| **mean** | {' | '.join(means)} |"]


def main(argv: Sequence[str] | None = None) -> None:
    """Validate the scenes and write the page and its data."""
    parser = argparse.ArgumentParser(prog="python -m reports.one_picture.run")
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    args = parser.parse_args(argv)
    rows = [collect_scores(scene.stem, validate_scene(scene)) for scene in args.scenes]
    summary = summarize(rows)
    args.out.mkdir(parents=True, exist_ok=True)
    data = json.dumps({"summary": summary, "relics": rows}, indent=1)
    (args.out / "one_picture.json").write_text(data + "\n", "utf-8")
    (args.out / "one_picture.md").write_text(write_page(rows, summary), "utf-8")


if __name__ == "__main__":
    main()
