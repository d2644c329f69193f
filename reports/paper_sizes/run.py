"""Compare the paper's algorithms on relics at the sizes of its experiment.

    python -m reports.paper_sizes.run scenes/amphora.xml ... -o reports/paper_sizes

Wang et al., Heritage Science 2024, doi 10.1186/s40494-024-01462-4, generate EIAs of 1080 x 1080
pixels for about 68 x 68 lenses of 1 mm from RGB-D pictures of 200 x 200 pixels. Each scene is
validated on the square middle of the `phone` display with such a picture. The page lists the views'
SSIM to the ground truth, as the paper does, and the scores that separate the algorithm from the
display.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import inim
from inim.display import Display

DISPLAY = inim.DISPLAYS["phone"].replace(lens_columns=68, panel_columns=1080, name="phone, square")
PICTURE_PIXELS = 200
#: SSIM of the middle view in the paper, of its own scenes.
PUBLISHED_SSIM = {"li2012": 0.67, "gu2020": 0.74, "wang2024": 0.78}
ALGORITHMS = (
    "li2012",
    "gu2020",
    "wang2024",
    "wang2024:step_pixel=scene",
    "wang2024:matching=ray",
    "template:samples=1:colour=nearest",
    "template",
)
SCORES = {
    "middle_ssim": "SSIM of the middle view to the ground truth, whole image",
    "relic_ssim": "SSIM on the relic to the reference, mean of five views",
    "eia_psnr_db": "PSNR of the EIA to the ground-truth EIA, dB",
}


def pixels_per_pitch(display: Display) -> float:
    """Resolution at which the capture has `PICTURE_PIXELS` rows and columns."""
    for hundredths in range(100, 500):
        if display.capture_shape(hundredths / 100) == (PICTURE_PIXELS, PICTURE_PIXELS):
            return hundredths / 100
    raise ValueError(f"{display.name}: no resolution gives {PICTURE_PIXELS} pixels")


def score_scene(scene: Path, work: Path) -> dict[str, Any]:
    """Scores of all algorithms for one scene, and the middle view's SSIM of the reference."""
    report = inim.validate(
        scene,
        work / scene.stem,
        display=DISPLAY,
        algorithms=ALGORITHMS,
        definitions={"inim.capture_pixels_per_pitch": pixels_per_pitch(DISPLAY)},
    )
    algorithms = report.data.algorithms
    views: dict[str, Any] = {name: result.views for name, result in algorithms.items()}
    return {
        "relic": scene.stem,
        "reference_middle_ssim": report.data.reference.views["centre"]["ssim"],
        "middle_ssim": {name: views[name]["centre"]["ssim"] for name in ALGORITHMS},
        "relic_ssim": {
            name: fmean(view["ssim_on_relic_to_reference"] for view in views[name].values())
            for name in ALGORITHMS
        },
        "eia_psnr_db": {name: algorithms[name].eia["psnr_db"] for name in ALGORITHMS},
    }


def write_page(rows: Sequence[Mapping[str, Any]]) -> str:
    """Markdown page with one table per score, the relic with the smallest lead first."""
    rows_, columns = DISPLAY.eia_shape
    lines = [
        "# The paper's experiment at its sizes",
        "",
        "Made by `python -m reports.paper_sizes.run SCENE.xml ... -o reports/paper_sizes`.",
        "",
        f"EIAs of {columns} x {rows_} pixels for {DISPLAY.lens_columns} x {DISPLAY.lens_rows} "
        f"lenses, from one RGB-D picture of {PICTURE_PIXELS} x {PICTURE_PIXELS} pixels "
        f"({pixels_per_pitch(DISPLAY)} per pitch).",
        "All algorithms read the same picture. All trace one ray per panel pixel and copy the",
        "nearest picture pixel, except `template` with its defaults: four rays, smooth colours.",
        "The paper gives SSIM of the middle view of its own scenes: "
        + ", ".join(f"`{name}` {value}" for name, value in PUBLISHED_SSIM.items())
        + ".",
    ]
    for score, title in SCORES.items():
        heads = ["relic", *(f"`{name}`" for name in ALGORITHMS)]
        if score == "middle_ssim":
            heads.append("reference")
        digits = 1 if score.endswith("_db") else 3
        lines += ["", f"## {title}", "", f"| {' | '.join(heads)} |"]
        lines.append(f"| --- |{' --: |' * (len(heads) - 1)}")
        for row in sorted(rows, key=lambda row: _lead(row[score])):
            cells = [f"{row[score][name]:.{digits}f}" for name in ALGORITHMS]
            if score == "middle_ssim":
                cells.append(f"{row['reference_middle_ssim']:.3f}")
            lines.append(f"| {row['relic']} | {' | '.join(cells)} |")
        means = [f"{fmean(row[score][name] for row in rows):.{digits}f}" for name in ALGORITHMS]
        if score == "middle_ssim":
            means.append(f"{fmean(row['reference_middle_ssim'] for row in rows):.3f}")
        lines.append(f"| **mean** | {' | '.join(means)} |")
    return "\n".join(lines) + "\n"


def _lead(scores: Mapping[str, float]) -> float:
    """Lead of `template` with one ray over the best of the paper's algorithms."""
    return scores["template:samples=1:colour=nearest"] - max(
        value for name, value in scores.items() if not name.startswith("template")
    )


def main() -> None:
    """Validate the scenes and write the page and its data."""
    parser = argparse.ArgumentParser(prog="python -m reports.paper_sizes.run")
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--work", type=Path, default=Path("out/paper_sizes"))
    args = parser.parse_args()
    rows = [score_scene(scene, args.work) for scene in args.scenes]
    args.out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(rows, indent=1) + "\n"
    (args.out / "paper_sizes.json").write_text(text, "utf-8")
    (args.out / "paper_sizes.md").write_text(write_page(rows), "utf-8")


if __name__ == "__main__":
    main()
