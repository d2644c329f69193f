"""Command `inim export`: an EIA for printing, and its views for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from inim.commands.options import Command, add_shared, choices_of
from inim.errors import EXIT_PASSED

if TYPE_CHECKING:
    import argparse

_OPTIONS = (
    *("pdf", "views", "hci", "quilt", "grid", "tiles", "view_size", "aspect", "view_spp"),
    *("scene", "allow_folders", "quiet", "debug"),
)


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    from inim.views.export import SPP, TILES

    parser.description = (
        "Write an EIA as a PDF to print, its sub-aperture views (one pixel per lens) as images or "
        "as an HCI light field, or a quilt of views rendered through the lens array."
    )
    add = parser.add_argument
    algorithms = "report: algorithm, or truth for the ground-truth EIA (the best algorithm)"
    add_shared(parser, "source", "display", "definitions", algorithms=algorithms)
    add("--pdf", type=Path, metavar="FILE", help="write a PDF that prints at true size")
    add(
        "--views",
        type=Path,
        metavar="DIR",
        help="write sub-aperture views, view_ROW_COLUMN.png, into this folder",
    )
    add(
        "--hci",
        type=Path,
        metavar="DIR",
        help="write an HCI light field into this folder; with the true disparity for a report",
    )
    add(
        "--grid",
        metavar="COLSxROWS",
        help="number of sub-aperture views (default: the pixels per lens)",
    )
    add(
        "--quilt",
        type=Path,
        metavar="FILE",
        help="write a quilt, .png; _qsCOLSxROWSaASPECT is added to its name",
    )
    add("--tiles", metavar="COLSxROWS", help=f"tiles of the quilt ({TILES})")
    add("--view-size", metavar="WxH", help="size of a tile in pixels (8x6: 420x560)")
    add(
        "--aspect",
        type=float,
        help="displayed width over height of a tile (default: square pixels)",
    )
    add("--view-spp", type=int, metavar="N", help=f"samples per pixel of a tile ({SPP})")
    add(
        "--scene",
        type=Path,
        metavar="XML",
        help="scene file for a quilt of the ground truth (default: the report's scene)",
    )
    add_shared(parser, "allow_folders", "quiet", "debug")


def _run(args: argparse.Namespace) -> int:
    from inim.views.export import export

    notes: list[str] = []
    options = {name: getattr(args, name) for name in _OPTIONS}
    choices = choices_of(args)
    choices.pop("algorithms", None)
    files = export(args.source, algorithm=args.algorithms, **choices, **options, say=notes.append)
    if not args.quiet:
        print("\n".join([*map(str, files), *notes]))
    return EXIT_PASSED


COMMANDS = {
    "export": Command("write an EIA as PDF, views, light field or quilt", _add_arguments, _run)
}
