"""Compare the displays of `inim choose` with the presets of the same panel, on relics.

    python -m reports.choose.run scenes/amphora.xml scenes/tripod.xml RELIC.xml -o reports/choose

A preset is seen from its own default distance and shows the relic over its own depth range. The
search has the same panel, distance and depth, and its viewing zone must be as wide as the preset's.
Sheets may have any pitch. The displays with the finest details by the closed forms are validated,
as `inim choose --scene` does.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from inim.choose import score
from inim.choose.search import Candidate, Need, front, search
from inim.choose.sheets import LensSheet, any_sheets
from inim.display import DISPLAYS
from inim.display.viewpoint import default_distance_mm
from inim.inspection.suitability import suitability

PRESETS = ("nominal", "phone")
#: Displays of the search that are validated.
VALIDATED = 2
MODEL = "thick"


def compare(preset: str, scenes: Sequence[Path]) -> dict[str, Any]:
    """Figures and scores of a preset and of the displays of the search, by scene."""
    display = DISPLAYS[preset]
    distance = default_distance_mm(display)
    figures = suitability(display, distance, MODEL)
    rows, columns = display.eia_shape
    need = Need(
        columns,
        rows,
        display.pixel_pitch_mm,
        distance,
        figures.depth_mm,
        round(figures.head_movement_mm or 0.0, 6),
    )
    sheet = LensSheet(preset, display.pitch_mm, display.focal_length_mm)
    displays = [Candidate(sheet, display, figures), *front(search(need, any_sheets()))[:VALIDATED]]
    return {
        "preset": preset,
        "distance_mm": distance,
        "depth_mm": figures.depth_mm,
        "displays": [_entry(candidate, need, scenes) for candidate in displays],
    }


def _entry(candidate: Candidate, need: Need, scenes: Sequence[Path]) -> dict[str, Any]:
    figures, display = candidate.suitability, candidate.display
    return {
        "name": candidate.sheet.name,
        "gap_mm": display.gap_mm,
        "depth_range_mm": display.depth_range_mm,
        "lenses": [figures.lens_columns, figures.lens_rows],
        "detail_mm": figures.detail_mm,
        "zone_width_mm": figures.zone_width_mm,
        "scores": {scene.stem: _score(candidate, need, scene) for scene in scenes},
    }


def _score(candidate: Candidate, need: Need, scene: Path) -> float:
    value = score(candidate, need, scene)
    print(f"{candidate.sheet.name}, {scene.stem}: {value:.3f}", flush=True)
    return value


def as_markdown(comparisons: Sequence[dict[str, Any]], command: str) -> str:
    """The table of the report."""
    relics = list(comparisons[0]["displays"][0]["scores"])
    lines = [
        "# Displays of the search against presets with the same panel",
        "",
        f"Made by `{command}`.",
        "",
        "Scores are the mean SSIM on the relic, against the scene, of the views of two eyes, in a",
        "quick validation. All displays of a panel are seen from the same distance and show the",
        "same depth, at different places. A view's pixel is 0.14 to 0.15 mm. The eyes are at the",
        "border of the viewing zone of `nominal`. Depths and zones are in mm.",
        "",
        "| panel of | display | lenses | gap | depth range | detail | zone | "
        + " | ".join(relics)
        + " |",
        "| --- | --- | --- | --: | --- | --: | --: |" + " --: |" * len(relics),
    ]
    for comparison in comparisons:
        for entry in comparison["displays"]:
            low, high = entry["depth_range_mm"]
            scores = " | ".join(f"{entry['scores'][name]:.3f}" for name in relics)
            lines.append(
                f"| {comparison['preset']} | {entry['name']} | "
                f"{' x '.join(map(str, entry['lenses']))} | {entry['gap_mm']:.4g} | "
                f"{low:.1f} to {high:.1f} | {entry['detail_mm']:.2f} | "
                f"{entry['zone_width_mm']:.0f} | {scores} |"
            )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the comparison and write `choose.json` and `choose.md`."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("-o", "--out", type=Path, required=True)
    args = parser.parse_args()
    comparisons = [compare(preset, args.scenes) for preset in PRESETS]
    args.out.mkdir(parents=True, exist_ok=True)
    scenes = " ".join(scene.name for scene in args.scenes)
    command = f"python -m reports.choose.run {scenes} -o reports/choose"
    (args.out / "choose.json").write_text(json.dumps(comparisons, indent=1) + "\n", "utf-8")
    (args.out / "choose.md").write_text(as_markdown(comparisons, command), "utf-8")


if __name__ == "__main__":
    main()
