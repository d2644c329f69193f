"""Command `inim export`: an EIA for printing, and its views for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from inim.commands.options import (
    Command,
    add_shared,
    check_report_arguments,
    display_and_settings,
)
from inim.errors import EXIT_PASSED, FileError, UsageError, ViewpointError

if TYPE_CHECKING:
    import argparse

    import numpy as np

    from inim.display import Display
    from inim.report import Report
    from inim.views.quilt import QuiltRequest

#: Quilts of published devices, by their columns and rows of views: width and height of a view in
#: pixels, and its width over its height as seen, where its pixels are not square.
_QUILTS = {
    (8, 6): (420, 560, 0.75),
    (5, 9): (819, 455, 16 / 9),
    (7, 7): (857, 857, 16 / 9),
    (11, 6): (372, 682, 9 / 16),
}
_TILES, _SPP = "8x6", 32


def _add_arguments(parser: argparse.ArgumentParser) -> None:
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
    add("--tiles", metavar="COLSxROWS", help=f"tiles of the quilt ({_TILES})")
    add("--view-size", metavar="WxH", help="size of a tile in pixels (8x6: 420x560)")
    add(
        "--aspect",
        type=float,
        help="displayed width over height of a tile (default: square pixels)",
    )
    add("--view-spp", type=int, metavar="N", help=f"samples per pixel of a tile ({_SPP})")
    add(
        "--scene",
        type=Path,
        metavar="XML",
        help="scene file for a quilt of the ground truth (default: the report's scene)",
    )
    add_shared(parser, "allow_folders", "quiet", "debug")


@dataclass(frozen=True)
class _ChosenEIA:
    """EIA to export, with the design of its display and the misaligned display.

    `distance_mm` is the distance of the eyes, and `description` is the name of the EIA with the
    reason of its choice.
    """

    path: Path
    display: Display
    misaligned: Display
    lens_model: str
    distance_mm: float | None
    description: str
    report: Report | None = None
    is_truth: bool = False

    @property
    def design_display(self) -> Display:
        """Display for which the EIA was generated: algorithms use the design."""
        return self.misaligned if self.is_truth else self.display


def _run(args: argparse.Namespace) -> int:
    if not (args.pdf or args.views or args.hci or args.quilt):
        raise UsageError(
            "nothing to write: give --pdf FILE, --views DIR, --hci DIR or --quilt FILE"
        )
    for option, path in (("--views", args.views), ("--hci", args.hci)):
        if path is not None and path.exists() and not path.is_dir():
            raise FileError(f"{option} {path}: is a file; name a folder")
    for option in ("tiles", "view_size", "aspect", "view_spp", "scene"):
        if getattr(args, option) is not None and args.quilt is None:
            raise UsageError(f"--{option.replace('_', '-')}: needs a quilt; add --quilt FILE")
    chosen = _choose_from_report(args) if args.source.is_dir() else _choose_eia(args)
    quilt = None if args.quilt is None else _quilt(args, chosen)
    lines = _write_sheet_and_views(args, chosen)
    if quilt is not None:
        from inim.views.frames import render_in_worker

        render_in_worker(quilt, quiet=args.quiet, debug=args.debug)
        lines.append(quilt.file)
    if not args.quiet:
        print("\n".join([*map(str, lines), f"exported {chosen.description}"]))
    return EXIT_PASSED


def _pair(option: str, text: str, most: int) -> tuple[int, int]:
    """Two whole numbers, across and down."""
    across, _, down = text.lower().partition("x")
    if not (across.isdecimal() and down.isdecimal() and 0 < int(across) * int(down) <= most):
        raise UsageError(f"{option} {text}: write ACROSSxDOWN, such as 9x9, of at most {most}")
    return int(across), int(down)


def _choose_eia(args: argparse.Namespace) -> _ChosenEIA:
    from inim.display.misalignment import misaligned

    if args.algorithms:
        raise UsageError("--algorithms: needs a report's folder; an EIA has no algorithms")
    design, settings = display_and_settings(args)
    real, distance = misaligned(design, settings.misalign), settings.viewing_distance_mm
    return _ChosenEIA(args.source, design, real, settings.lens_model, distance, args.source.name)


def _choose_from_report(args: argparse.Namespace) -> _ChosenEIA:
    """Given algorithm or the ground truth; by default the best by the headline score."""
    from inim.display.misalignment import misaligned
    from inim.report import TRUTH, Report

    check_report_arguments(args)
    report = Report.load(args.source)
    name, why = (args.algorithms, "") if args.algorithms else _best(report)
    path, design = report.eia_path(name, "--algorithms"), report.display
    return _ChosenEIA(
        path,
        design,
        misaligned(design, report.data.misalign),
        report.data.lens_model,
        report.data.settings.viewing_distance_mm,
        name + why,
        report,
        name == TRUTH,
    )


def _best(report: Report) -> tuple[str, str]:
    """Best algorithm, with a phrase for the reason."""
    from inim.metrics.headline import HEADLINE_WORDS

    names, best = list(report.data.algorithms), report.data.best_algorithm
    if len(names) == 1:
        return names[0], ", the report's only algorithm"
    if best is None:
        raise UsageError(
            f"{report.folder}: has no scores to choose by; name one with --algorithms: "
            f"{', '.join([*names, 'truth'])}"
        )
    return best, f", the best of {len(names)} by {HEADLINE_WORDS}"


def _write_sheet_and_views(args: argparse.Namespace, chosen: _ChosenEIA) -> list[Path]:
    from inim.files.eia_file import read_eia, write_true_size_pdf
    from inim.files.light_field import sub_aperture_views, write_hci
    from inim.image.color import srgb_codes

    grid = None if args.grid is None else _pair("--grid", args.grid, 10_000)[::-1]
    if args.pdf is None and args.views is None and args.hci is None:
        return []
    display = chosen.design_display
    eia = read_eia(chosen.path, display)[0]
    codes = srgb_codes(eia)
    views = None if args.views is None else sub_aperture_views(codes, display, grid)
    field = None if args.hci is None else _light_field(args, chosen, codes, grid)
    if args.pdf is not None:
        write_true_size_pdf(args.pdf, eia, display.pixel_pitch_mm)
    if views is not None:
        _write_views(args.views, views)
    if field is not None:
        write_hci(args.hci, field[0], display, field[1])
    return [path for path in (args.pdf, args.views, args.hci) if path is not None]


def _light_field(
    args: argparse.Namespace, chosen: _ChosenEIA, codes: np.ndarray, grid: tuple[int, int] | None
) -> tuple[np.ndarray, np.ndarray | None]:
    """Views; for a report also the disparity of the centre view."""
    from inim.files.image import read_rgbd
    from inim.files.light_field import centre_disparity, sub_aperture_views, view_grid

    display = chosen.design_display
    if chosen.report is None:
        return sub_aperture_views(codes, display, grid), None
    if grid is None:  # odd numbers, for a centre view
        down, across = (n - 1 + n % 2 for n in view_grid(display))
    elif not (grid[0] % 2 and grid[1] % 2):
        raise UsageError(
            f"--grid {args.grid}: has no centre view, which needs a disparity; use odd numbers"
        )
    else:
        down, across = grid
    rgbd = read_rgbd(chosen.report.folder / "rgbd.exr")
    views = sub_aperture_views(codes, display, (down, across))
    return views, centre_disparity(rgbd, display, across)


def _write_views(folder: Path, views: np.ndarray) -> None:
    from PIL import Image

    from inim.files.image import write_atomically

    for row, line in enumerate(views):
        for column, view in enumerate(line):
            save = partial(Image.fromarray(view).save, format="PNG")
            write_atomically(folder / f"view_{row:02}_{column:02}.png", save)


def _quilt(args: argparse.Namespace, chosen: _ChosenEIA) -> QuiltRequest:
    """Request for the quilt, checked."""
    from inim.views.frames import TracedScene
    from inim.views.quilt import QuiltRequest

    if args.scene is not None and not chosen.is_truth:
        raise UsageError("--scene: needs the ground truth; add --algorithms truth")
    columns, rows = tiles = _pair("--tiles", args.tiles or _TILES, 1000)
    if args.view_size is not None:
        width, height = _pair("--view-size", args.view_size, 2**28)
        aspect = width / height
    elif tiles in _QUILTS:
        width, height, aspect = _QUILTS[tiles]
    else:
        raise UsageError(f"--tiles {args.tiles}: unknown size of a tile; give --view-size WxH")
    request = QuiltRequest(
        out=args.quilt,
        sources={
            "quilt": TracedScene.of(chosen.report, args.scene, args.allow_folders)
            if chosen.is_truth and chosen.report
            else chosen.path
        },
        label=chosen.path,
        design=chosen.display,
        misaligned_display=chosen.misaligned,
        lens_model=chosen.lens_model,
        spp=_SPP if args.view_spp is None else args.view_spp,
        distance_mm=chosen.distance_mm,
        columns=columns,
        rows=rows,
        width=width,
        height=height,
        aspect=aspect if args.aspect is None else args.aspect,
    )
    try:
        request.check()
    except ViewpointError as error:
        raise FileError(f"{args.source}: {error}") from None
    return request


COMMANDS = {
    "export": Command("write an EIA as PDF, views, light field or quilt", _add_arguments, _run)
}
