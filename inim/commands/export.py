"""`inim export`: an EIA for printing, and what it shows as views for other programs."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from inim.commands.options import Command, add_debug, add_display
from inim.errors import EXIT_PASSED, FileError, UsageError

if TYPE_CHECKING:
    import argparse

    import numpy as np

    from inim.display import Display

__all__ = ["COMMANDS"]


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Write an EIA as a sheet to print, or its sub-aperture views: one picture each, as an HCI "
        "light field, or as a Looking Glass quilt. A view has one pixel per lens."
    )
    add = parser.add_argument
    add("what", type=Path, metavar="OUT|EIA", help="a report's folder, or an EIA (.png, .exr)")
    add_display(parser)
    add("--name", help="of a report's EIAs, which one (the best algorithm's)")
    add("--pdf", type=Path, metavar="FILE", help="a PDF that prints at true size")
    add("--views", type=Path, metavar="DIR", help="folder for view_ROW_COLUMN.png")
    add(
        "--hci", type=Path, metavar="DIR", help="folder for input_Cam000.png ... and parameters.cfg"
    )
    add("--quilt", type=Path, metavar="FILE", help=".png; _qsCOLSxROWSaASPECT is added to its name")
    add("--grid", metavar="COLSxROWS", help="of the views, or of the quilt's tiles")
    add_debug(parser)


def _run(args: argparse.Namespace) -> int:
    if not (args.pdf or args.views or args.hci or args.quilt):
        raise UsageError(
            "nothing to write: give --pdf FILE, --views DIR, --hci DIR or --quilt FILE"
        )
    for option, path in (("--views", args.views), ("--hci", args.hci)):
        if path is not None and path.exists() and not path.is_dir():
            raise FileError(f"{option} {path}: is a file; name a folder")
    grid = _grid(args.grid)
    from inim.color import srgb_codes
    from inim.files.eia_file import write_true_size_pdf

    eia, display = _eia(args)
    codes = srgb_codes(eia)
    if args.pdf is not None:
        write_true_size_pdf(args.pdf, eia, display.pixel_pitch_mm)
    written = [
        *([] if args.pdf is None else [args.pdf]),
        *_write_views(args, codes, display, grid),
        *([] if args.quilt is None else [_write_quilt(args.quilt, codes, display, grid)]),
    ]
    for path in written:
        print(path)
    return EXIT_PASSED


def _grid(text: str | None) -> tuple[int, int] | None:
    """Columns and rows."""
    if text is None:
        return None
    across, _, down = text.lower().partition("x")
    if not (across.isdecimal() and down.isdecimal() and 0 < int(across) * int(down) <= 10_000):
        raise UsageError(f"--grid {text}: write COLUMNSxROWS, such as 9x9, of at most 10000 views")
    return int(across), int(down)


def _eia(args: argparse.Namespace) -> tuple[np.ndarray, Display]:
    """The EIA, linear, and its display."""
    from inim.files.eia_file import read_eia
    from inim.scene.file import chosen_display

    if args.what.is_dir():
        if args.display or args.definitions:
            raise UsageError(
                f"{args.what}: is a report, which has its own display; --display and -D are for "
                "an EIA"
            )
        path, display = _of_report(args.what, args.name)
    else:
        if args.name:
            raise UsageError("--name: is for a report's folder; an EIA has no others beside it")
        path, display = args.what, chosen_display(args.display, args.definitions, "inim export")[0]
    return read_eia(path, display)[0], display


def _of_report(folder: Path, name: str | None) -> tuple[Path, Display]:
    from inim.report import Report
    from inim.report.wording import best_algorithm

    report = Report.load(folder)
    names = list(report.data["algorithms"])
    chosen = name if name is not None else best_algorithm(report.data)
    if chosen not in names:
        said = "--name" if name is None else f"--name {name}"
        raise UsageError(f"{said}: {folder} has {', '.join(names) or 'no EIA'}")
    return folder / "eia" / f"{chosen}.png", report.design()


def _write_views(
    args: argparse.Namespace, codes: np.ndarray, display: Display, grid: tuple[int, int] | None
) -> list[Path]:
    from inim.files.image import write_atomically
    from inim.files.light_field import sub_aperture_views, write_hci

    if args.views is None and args.hci is None:
        return []
    from PIL import Image

    views = sub_aperture_views(codes, display, None if grid is None else grid[::-1])
    if args.views is not None:
        for row, line in enumerate(views):
            for column, view in enumerate(line):
                picture = Image.fromarray(view)
                put = partial(picture.save, format="PNG")
                write_atomically(args.views / f"view_{row:02}_{column:02}.png", put)
    if args.hci is not None:
        write_hci(args.hci, views, display)
    return [path for path in (args.views, args.hci) if path is not None]


def _write_quilt(
    path: Path, codes: np.ndarray, display: Display, grid: tuple[int, int] | None
) -> Path:
    """Views from left to right, seen from the middle's height."""
    from inim.files.light_field import sub_aperture_views, view_grid, write_quilt

    count = view_grid(display)[1] if grid is None else grid[0] * grid[1]
    views = sub_aperture_views(codes, display, (1, count))[0]
    return write_quilt(path, views, display.width_mm / display.height_mm, grid)


COMMANDS = {
    "export": Command(
        "write an EIA as PDF, or its views: pictures, HCI, quilt", _add_arguments, _run
    )
}
