"""Compare depths that `inim depth` finds by a picture's outline with the true depth.

    python -m reports.depth.run scenes/amphora.xml ... -o reports/depth --picture depth.webp

The colour picture of each scene keeps its colours; its depth is replaced. The template generator
makes EIAs, and an eye at the side looks at them through the scene's lenses. Scores are the SSIM on
the relic to the view of the ground-truth EIA, not corrected for noise, at equal samples.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import inim
from inim.from_camera import outline_depth
from inim.image.color import srgb_from_linear, srgb_to_uint8
from inim.image.rgbd import RGBD
from inim.metrics.ssim import ssim
from reports.panel.run import Bench

VIEWPOINT = "left"
DEPTHS = {
    "true": "the depth of the scene",
    "relief": "`inim depth`, outline found in the picture",
    "layers": "`inim depth --method layers`",
}


def pictures(rgbd: RGBD, name: str) -> dict[str, RGBD]:
    """Pictures with true and estimated depths; a display's depth range is the true range."""
    low, high = (float(f(rgbd.depth_mm[rgbd.covered])) for f in (np.min, np.max))
    codes = srgb_to_uint8(srgb_from_linear(np.where(rgbd.covered[..., None], rgbd.color, 0)))
    subject = outline_depth.find_subject(codes, name)
    result = {"true": rgbd}
    for label, method in outline_depth.METHODS.items():
        nearness = method.nearness(subject)
        share = (nearness - method.far) / (method.near - method.far)
        depth = (low + (high - low) * share).astype(np.float32)
        result[label] = replace(rgbd, depth_mm=depth, covered=subject)
    return result


def score(scene: Path) -> tuple[dict[str, Any], list[np.ndarray]]:
    """SSIM of a scene's side view by the depth of its picture, errors of the depths, and views."""
    bench = Bench(scene, VIEWPOINT)
    rgbd, display = bench.rgbd, bench.plan.display
    row: dict[str, Any] = {"scene": scene.stem}
    views = []
    for name, picture in pictures(rgbd, scene.stem).items():
        common = picture.covered & rgbd.covered
        error = (picture.depth_mm - rgbd.depth_mm)[common]
        views.append(bench.view(inim.generate(picture, display), display))
        row[name] = {
            "ssim": ssim(bench.ideal, views[-1], bench.relic),
            "outline_iou": common.sum() / (picture.covered | rgbd.covered).sum(),
            "depth_rms_mm": float(np.sqrt((error**2).mean())),
        }
    return row, views


def write_page(data: Mapping[str, Any]) -> str:
    """Markdown page of the scores, the worst relief first."""
    rows = sorted(data["rows"], key=lambda row: float(row["relief"]["ssim"]))
    lines = [
        "# Depth from an outline",
        "",
        f"Made by `python -m reports.depth.run {' '.join(data['scenes'])} -o reports/depth`.",
        "",
        f"SSIM on the relic of the `{VIEWPOINT}` view to that of the ground-truth EIA, by depth:",
        "",
        *(f"* *{name}*: {text}" for name, text in DEPTHS.items()),
        "",
        "*Outline*: intersection over union of the subject and the relic. *Error*: root mean",
        "square of the relief's depth.",
        "",
        f"| scene | {' | '.join(DEPTHS)} | outline | error, mm |",
        f"| --- |{' --: |' * (len(DEPTHS) + 2)}",
    ]
    for row in rows:
        scores = " | ".join(f"{row[name]['ssim']:.3f}" for name in DEPTHS)
        relief = row["relief"]
        lines.append(
            f"| {row['scene']} | {scores} | {relief['outline_iou']:.3f} "
            f"| {relief['depth_rms_mm']:.1f} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Score the scenes and write the page and its data."""
    parser = argparse.ArgumentParser(prog="python -m reports.depth.run")
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--picture", type=Path, help="views of the first scene, .webp")
    args = parser.parse_args()
    scenes = [scene.as_posix() for scene in args.scenes]
    rows, views = zip(*map(score, args.scenes), strict=True)
    data = {"scenes": scenes, "rows": rows}
    if args.picture is not None:
        codes = srgb_to_uint8(srgb_from_linear(np.hstack(views[0])))
        Image.fromarray(codes).save(args.picture, quality=90)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "depth.json").write_text(json.dumps(data, indent=1) + "\n", "utf-8")
    (args.out / "depth.md").write_text(write_page(data), "utf-8")


if __name__ == "__main__":
    main()
