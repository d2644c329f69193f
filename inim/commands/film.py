"""`inim film`: a report's display, filmed with an eye that moves."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from inim.commands.options import Command, add_quiet
from inim.errors import EXIT_PASSED

if TYPE_CHECKING:
    import argparse

__all__ = ["COMMANDS"]

_TRUTH = "truth"
_FILM = "film.webp"


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Film a report's display with an eye that moves along a path: an animated .gif or .webp, "
        "or an .mp4."
    )
    add = parser.add_argument
    add("folder", type=Path, metavar="OUT", help="a report's folder")
    add("-o", "--out", type=Path, metavar="FILM", help=f".gif, .webp or .mp4 (OUT/{_FILM})")
    add(
        "--show",
        action="append",
        metavar="NAME",
        help=f"algorithm, or {_TRUTH}; repeated: side by side (truth and the best algorithm)",
    )
    add(
        "--path",
        default="circle",
        help="'circle' inside the viewing zone, or eye positions 'x y [z], x y [z], ...' in mm, "
        "there and back (circle)",
    )
    add("--lens-model", help="pinhole, thin, thick or full (the report's)")
    add("--frames", type=int, default=48, metavar="N", help="frames (48)")
    add("--rate", type=float, default=16.0, metavar="FPS", help="frames per second (16)")
    add("--spp", type=int, default=32, metavar="N", help="samples per pixel (32)")
    add_quiet(parser)


def _run(args: argparse.Namespace) -> int:
    from inim.pipeline.film import FilmRequest, make_film
    from inim.report import Report
    from inim.report.wording import best_algorithm

    report = Report.load(args.folder)
    best = best_algorithm(report.data)
    settings = report.data.get("settings") or {}
    request = FilmRequest(
        folder=str(args.folder),
        out=str(args.out or args.folder / _FILM),
        show=tuple(args.show or [_TRUTH, *([best] if best else [])]),
        path=args.path,
        lens_model=args.lens_model or str(report.data.get("lens_model")),
        frames=args.frames,
        frames_per_second=args.rate,
        spp=args.spp,
        pixels_per_lens=int(settings.get("view_pixels_per_lens") or 4),
    )
    make_film(request, quiet=args.quiet, debug=args.debug)
    if not args.quiet:
        print(request.out)
    return EXIT_PASSED


COMMANDS = {"film": Command("film a report's display with an eye that moves", _add_arguments, _run)}
