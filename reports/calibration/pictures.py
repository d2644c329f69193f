"""Pictures for the calibration how-to, from simulated photographs of a misaligned phone.

    python -m reports.calibration.pictures scenes/amphora.xml -o docs/images

A case of `reports.calibration.cases` is photographed and calibrated. A scene's EIA for the
calibrated display is shown on the misaligned display, photographed and simulated. The script writes
`photographs.webp`, the patterns through the sheet, and `photograph.webp`, the EIA's photograph next
to its simulation.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from reports.calibration.cases import Case, draw_case
from reports.calibration.landing import Sheet
from reports.calibration.photographs import Shot, calibrate_case, run_inim
from reports.gallery.pictures import save_small

_CASE = 1
# White, and a wave of columns and of rows.
_PATTERNS = ("1-white", "2-column-phase-000", "5-row-phase-000")
# Width of each picture in pixels.
_WIDTH = 480
# Share of the photographs' width, about their middle, that the lower row magnifies.
_MAGNIFIED = 0.12


def _photographs(patterns: Path, position: Path) -> Image.Image:
    """Photographs of some patterns, each with a magnified part below it."""
    names = [path.stem for path in sorted(patterns.glob("*.png"))]
    photographs = sorted(position.glob("*.jpg"))
    columns = []
    for name in _PATTERNS:
        with Image.open(photographs[names.index(name)]) as image:
            columns.append(_stacked(image.convert("RGB")))
    return _side_by_side(columns)


def _stacked(image: Image.Image) -> Image.Image:
    width = _MAGNIFIED * image.width
    left, top = (image.width - width) / 2, (image.height - width * image.height / image.width) / 2
    box = (left, top, image.width - left, image.height - top)
    size = (_WIDTH, round(_WIDTH * image.height / image.width))
    whole = Image.new("RGB", (size[0], 2 * size[1] + 8), "white")
    whole.paste(image.resize(size, Image.Resampling.LANCZOS))
    whole.paste(image.resize(size, Image.Resampling.NEAREST, box), (0, size[1] + 8))
    return whole


def _side_by_side(images: list[Image.Image]) -> Image.Image:
    width = sum(image.width for image in images) + 8 * (len(images) - 1)
    whole = Image.new("RGB", (width, images[0].height), "white")
    left = 0
    for image in images:
        whole.paste(image, (left, 0))
        left += image.width + 8
    return whole


def _photograph_eia(case: Case, eia: Path, out: Path) -> None:
    """Photograph an EIA on the misaligned display from the first position."""
    with Image.open(eia) as image:
        codes = np.asarray(image.convert("RGB"))
    rays = Sheet(case.display).trace(case.camera, case.poses[0], seed=_CASE)
    shot = Shot(rays, case.camera, case.sensor, case.display.eia_shape)
    Image.fromarray(shot.photograph(codes, seed=_CASE)).save(out, quality=90)


def main() -> None:
    """Write both pictures."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("-o", "--out", type=Path, default=Path("docs/images"))
    args = parser.parse_args()
    case = draw_case(_CASE)
    with tempfile.TemporaryDirectory() as folder_name:
        folder = Path(folder_name)
        display_file = calibrate_case(case, folder)
        patterns = _photographs(folder / "patterns", folder / "photographs" / "position-1")
        save_small(patterns, args.out / "photographs.webp")
        report = folder / "report"
        algorithm = "template"
        options = ("--display", display_file, "--algorithms", algorithm, "--viewpoints", "centre")
        run_inim("validate", args.scene, *options, "--preview", "-o", report)
        eia, photograph = report / "eia" / f"{algorithm}.png", folder / "photograph.jpg"
        _photograph_eia(case, eia, photograph)
        comparison = folder / "comparison"
        position = ("--display", display_file, "--position", "position-1")
        run_inim("photo", photograph, "--eia", eia, *position, "-o", comparison)
        pair = []
        for name in ("photograph.png", "simulation.png"):
            with Image.open(comparison / name) as image:
                box = (image.width // 4, 0, 3 * image.width // 4, image.height)
                size = (_WIDTH, round(_WIDTH * image.height / (box[2] - box[0])))
                relic = image.convert("RGB").resize(size, Image.Resampling.LANCZOS, box)
                pair.append(relic)
        save_small(_side_by_side(pair), args.out / "photograph.webp")


if __name__ == "__main__":
    main()
