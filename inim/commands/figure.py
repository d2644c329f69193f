"""Command `inim figure`: figures of a report for papers."""

from __future__ import annotations

import argparse
from pathlib import Path

from inim.commands.options import Command, add_shared, print_outcome
from inim.errors import EXIT_PASSED, UsageError


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Draw a figure of a report: views of one viewpoint with magnified insets, error maps, "
        "scores with 95 % intervals, and run time against error."
    )
    parser.add_argument("report", type=Path, metavar="REPORT", help="folder of a report")
    add_shared(parser, out="file to write: .pdf, .svg, .png or .eps (default: figure.pdf)")
    parser.add_argument(
        "--parts",
        default="views,errors,scores,time",
        help="parts to draw, separated by commas (default: %(default)s)",
    )
    parser.add_argument("--viewpoint", default="", help="viewpoint of the views (default: centre)")
    add_shared(parser, algorithms="algorithms of the report, separated by commas (default: all)")
    parser.add_argument(
        "--inset",
        action="append",
        default=[],
        metavar="X,Y,SIDE",
        help="square to magnify: centre and side as fractions of the view's width; may be repeated",
    )
    parser.add_argument(
        "--width",
        type=float,
        default=180.0,
        help="width of the figure in mm (default: %(default)g)",
    )
    parser.add_argument(
        "--maps", type=Path, metavar="DIR", help="also write the error maps of all views as EXR"
    )


def _run(args: argparse.Namespace) -> int:
    from inim.generators import algorithm_items
    from inim.report import Report
    from inim.report.figure import FigureRequest, Inset, write_error_maps, write_figure

    insets = []
    for text in args.inset:
        try:
            insets.append(Inset(*map(float, text.split(","))))
        except (TypeError, ValueError):
            raise UsageError(f"--inset {text}: write X,Y,SIDE, such as 0.5,0.4,0.2") from None
    report = Report.load(args.report)
    request = FigureRequest(
        tuple(part.strip() for part in args.parts.split(",") if part.strip()),
        args.viewpoint,
        algorithm_items(args.algorithms or ""),
        tuple(insets),
        args.width,
    )
    path = args.out or Path("figure.pdf")
    write_figure(report, request, path)
    print_outcome(f"figure: {path}")
    if args.maps:
        maps = write_error_maps(report, request, args.maps)
        print_outcome(f"{len(maps)} error maps: {args.maps}")
    return EXIT_PASSED


COMMANDS = {"figure": Command("draw a figure of a report for a paper", _add_arguments, _run)}
