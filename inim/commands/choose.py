"""Command `inim choose`: the lens sheet for a panel."""

from __future__ import annotations

import argparse
import math
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

from inim.commands import Command, add_shared
from inim.errors import EXIT_PASSED, UsageError

if TYPE_CHECKING:
    from inim.documents.choose import CandidateRecord, ChooseDocument

# Rows of the table; JSON has all.
_MOST_ROWS = 10
_COLUMNS = 100
_HEADS = (
    "",
    "lenses",
    "gap",
    "",
    "depth range",
    "detail",
    "sharp",
    "zone",
    "head",
    "light",
    "score",
)


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Find the lens sheet for a panel: design a display with each sheet, compare detail, depth, "
        "viewing zone and brightness, and recommend one. All lengths are in mm."
    )
    add = parser.add_argument
    add(
        "--panel",
        required=True,
        help="columns, rows and diagonal, '2400x1080, 6.7 in'; or the pixel, '2400x1080, 63.6 um'; "
        "or a preset with that panel",
    )
    add("--distance", type=float, default=500.0, help="viewing distance (%(default)g)")
    add("--depth", type=float, default=30.0, help="depth of the picture (%(default)g)")
    add(
        "--move",
        type=float,
        default=20.0,
        help="movement of the head to either side, with both eyes in the viewing zone "
        "(%(default)g)",
    )
    add(
        "--sheets",
        type=Path,
        metavar="FILE",
        help="table of the sheets to compare (.toml with [[sheet]] name, pitch_mm and "
        "focal_length_mm); default: inim's table, and sheets of any pitch",
    )
    add(
        "--lattice",
        default="square",
        help="layouts of the sheets of any pitch: square, hexagonal, lenticular; separated by "
        "commas (%(default)s)",
    )
    add(
        "--scene",
        type=Path,
        help="relic, a scene (.xml): the expected score of the best displays, by a quick "
        "validation (a minute or more each)",
    )
    add_shared(parser, out="display file of the recommended display (.xml)")
    add("--json", action="store_true", help="print JSON instead of text")
    add_shared(parser, "debug")


def _run(args: argparse.Namespace) -> int:
    from inim.choose import choose
    from inim.choose.search import Need, parse_panel
    from inim.choose.sheets import TABLE, any_sheets, read_sheets
    from inim.documents.document import encode

    for name in ("distance", "depth", "move"):
        value = getattr(args, name)
        if not (math.isfinite(value) and (value > 0 or (name == "move" and value == 0))):
            raise UsageError(f"--{name} {value:g}: give a length above 0, in millimetres")
    need = Need(*parse_panel(args.panel), args.distance, args.depth, args.move)
    if args.sheets is None:
        lattices = [word.strip() for word in args.lattice.split(",")]
        sheets = (*read_sheets(TABLE), *any_sheets(lattices))
    else:
        sheets = read_sheets(args.sheets)
    document, candidates = choose(need, sheets, args.scene)
    if args.out is not None:
        candidates[0].display.save(args.out)
    print(encode(document) if args.json else _as_text(document))
    if args.out is not None and not args.json:
        print(f"\nwritten: {args.out}")
    return EXIT_PASSED


def _as_text(data: ChooseDocument) -> str:
    """Table of the candidates, and the recommendation."""
    records = data.candidates[:_MOST_ROWS]
    records += [record for record in data.candidates[_MOST_ROWS:] if record.source]
    table = [_HEADS, *map(_row, records)]
    if data.scene is None:
        table = [cells[:-1] for cells in table]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    rows = [
        "  ".join(f"{cell:<{w}}" if n < 1 else f"{cell:>{w}}" for n, (cell, w) in enumerate(row))
        for row in (zip(cells, widths, strict=True) for cells in table)
    ]
    best = data.candidates[0]
    display, accuracy = best.display, best.suitability.accuracy
    return "\n".join(
        [
            f"Panel of {data.panel_columns} x {data.panel_rows} pixels of "
            f"{1e3 * data.pixel_pitch_mm:.4g} µm; viewer at {data.distance_mm:g} mm",
            "",
            *(row.rstrip() for row in rows),
            "",
            "Lengths in mm. detail: finest detail at the worst depth; sharp: depths with sharp "
            "details;",
            "head: movement to either side; light: brightness, % of the panel's"
            + ("." if data.scene is None else "; score: SSIM on the relic."),
            "",
            *textwrap.wrap(
                f"Recommended: {best.sheet}. Reason: {data.reason}. Buy a sheet with a pitch of "
                f"{display.pitch_mm:g} mm and a focal length of {display.focal_length_mm:g} mm; "
                f"mount it with an air-equivalent gap of {display.gap_mm:g} mm. Its alignment "
                f"must be known to {1e3 * accuracy['shift_x_mm']:.2g} µm and "
                f"{accuracy['rotation_deg']:.2g}° (inim calibrate).",
                _COLUMNS,
                break_on_hyphens=False,
            ),
        ]
    )


def _row(record: CandidateRecord) -> tuple[str, ...]:
    figures, display = record.suitability, record.display
    low, high = display.depth_range_mm
    height = figures.zone_height_mm
    return (
        record.sheet,
        f"{figures.lens_columns} x {figures.lens_rows}",
        f"{display.gap_mm:.4g}",
        f"±{figures.accuracy['gap_mm']:.2f}",
        f"{low:.1f} .. {high:.1f}",
        f"{figures.detail_mm:.2f}",
        f"{figures.sharp_depth_mm:.0f}",
        f"{figures.zone_width_mm:.0f} x {'any' if height is None else f'{height:.0f}'}",
        f"±{figures.head_movement_mm or 0:.0f}",
        f"{100 * figures.brightness:.0f} %",
        "-" if record.score is None else f"{record.score:.3f}",
    )


COMMANDS = {"choose": Command("find the lens sheet for a panel", _add_arguments, _run)}
