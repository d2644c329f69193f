"""One row of pixels in all views of the middle row: true views and methods.

    python -m reports.scoreboard.strip FOLDER --row 72 --rvs RVS -o reports/scoreboard/strip.png

The lines are views, the leftmost on top: an epipolar image. A surface at one depth has straight
edges, steeper for smaller disparities. Uncovered surfaces begin at the edge that hides them.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import inim
from inim.system.process.atomic_file import write_atomically
from reports.scoreboard.field import LightField, Views, codes, read
from reports.scoreboard.rivals import rvs, splat

_ALGORITHMS = ("template", "template:colour=nearest:fill=hidden", "gu2020", "wang2024")
_ENLARGED, _GAP = 4, 6


def strip(views: Views, field: LightField, row: int) -> np.ndarray:
    """One line for each view, with the middle view, (side, columns, 3) uint8."""
    lines = {place[1]: view[row] for place, view in views}
    lines[field.side // 2] = field.middle[row]
    return np.stack([lines[column] for column in range(field.side)])


def main() -> None:
    """Draw the strips of all methods."""
    from PIL import Image, ImageDraw

    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="a light field")
    parser.add_argument("--row", type=int, required=True, help="of pixels")
    parser.add_argument("--rvs", type=Path, required=True, help="executable of MPEG's RVS")
    parser.add_argument("-o", "--out", type=Path, required=True)
    args = parser.parse_args()
    whole = read(args.folder)
    row = whole.side // 2
    field = replace(whole, views={p: v for p, v in whole.views.items() if p[0] == row})
    views_by_method = {
        "true views": iter(field.views.items()),
        "naive splat": splat(field),
        "RVS": rvs(field, args.rvs),
        **{
            name: field.of_eia(codes(inim.generate(field.rgbd, field.display, name)))
            for name in _ALGORITHMS
        },
    }
    high, wide = field.side * _ENLARGED, field.rgbd.shape[1] * _ENLARGED
    text = 14
    sheet = Image.new("RGB", (wide, len(views_by_method) * (high + text + _GAP)), "white")
    draw = ImageDraw.Draw(sheet)
    for n, (name, views) in enumerate(views_by_method.items()):
        top = n * (high + text + _GAP)
        draw.text((2, top + 1), name, fill="black")
        lines = Image.fromarray(strip(views, field, args.row))
        sheet.paste(lines.resize((wide, high), Image.Resampling.NEAREST), (0, top + text))
    write_atomically(args.out, lambda p: sheet.quantize().save(p, "PNG", optimize=True))


if __name__ == "__main__":
    main()
