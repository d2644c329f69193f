"""Commands `inim view` (the virtual display as an HTML file) and `export`."""

from __future__ import annotations

import argparse
from pathlib import Path

from inim.apps.export.tiles import SPP, TILES
from inim.pipeline.options import (
    Command,
    add_shared,
    choices_of,
    default_out,
    open_page,
    opens_pages,
    print_lines,
)
from inim.system.errors import EXIT_PASSED


def _add_view_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Write the virtual display of a report, or of any elemental image array, as one "
        "self-contained HTML file."
    )
    out = "HTML file to write (default: OUT-view.html or EIA-view.html)"
    add_shared(parser, "source", "display", "definitions", out=out)
    parser.add_argument(
        "--open",
        action=argparse.BooleanOptionalAction,
        help="open it in the browser (default: on a terminal with a screen)",
    )


def _view(args: argparse.Namespace) -> int:
    from inim.apps.export.source import refuse_display
    from inim.report.view_page import view_eia, view_report

    out = args.out or default_out(args.source, "view.html")
    if args.source.is_dir():
        refuse_display(args.source, args.display, args.definitions)
        view_report(args.source, out)
    else:
        view_eia(args.source, out, **choices_of(args))
    print_lines(out)
    if opens_pages() if args.open is None else args.open:
        open_page(out)
    return EXIT_PASSED


_EXPORT_OPTIONS = (
    *("pdf", "views", "hci", "quilt", "tiles", "view_size", "aspect", "view_spp"),
    *("native", "scene", "allow_folders", "quiet", "debug"),
)


def _add_export_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Write an EIA as a PDF to print, its sub-aperture views (one pixel per lens) as images or "
        "as an HCI light field, or a quilt of views rendered through the lens array; or the native "
        "picture of a Looking Glass from a quilt."
    )
    add = parser.add_argument
    algorithms = "algorithm, or truth for the ground-truth EIA (default: the best algorithm)"
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
        "--quilt",
        type=Path,
        metavar="FILE",
        help="write a quilt, .png; _qsCOLSxROWSaASPECT is added to its name",
    )
    add(
        "--native",
        type=Path,
        metavar="FILE",
        help="write the native picture of a lenticular display, .png; the source is a quilt of any "
        "program (.png, .jpg)",
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
    add_shared(parser, "allow_folders", "quiet")


def _export(args: argparse.Namespace) -> int:
    from inim.apps.export.export import export

    notes: list[str] = []
    options = {name: getattr(args, name) for name in _EXPORT_OPTIONS}
    choices = choices_of(args)
    choices.pop("algorithms", None)
    files = export(args.source, algorithm=args.algorithms, **choices, **options, say=notes.append)
    if not args.quiet:
        print_lines(*files, *notes)
    return EXIT_PASSED


COMMANDS = {
    "view": Command(
        "view a report's EIAs, or any EIA, in a browser",
        _add_view_arguments,
        _view,
        "inim view out/jade",
    ),
    "export": Command(
        "write an EIA as PDF, views, light field or quilt",
        _add_export_arguments,
        _export,
        "inim export out/jade --pdf sheet.pdf",
    ),
}
