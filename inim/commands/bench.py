"""The command line of the bench."""

from __future__ import annotations

import argparse
from pathlib import Path

from inim.commands.options import add_definitions, add_exit_codes, add_quiet, print_outcome
from inim.errors import EXIT_PASSED

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "time the algorithms against their error, in yardsticks"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `inim bench`."""
    add_exit_codes(parser)
    parser.description = (
        "Time each algorithm on a scene's display-ready picture, all in turn with a yardstick of "
        "one gather per display pixel, and set the times against their errors."
    )
    parser.add_argument("scene", type=Path, nargs="?", help="Mitsuba scene (.xml)")
    parser.add_argument("-o", "--out", type=Path, help="folder (default: SCENE-bench)")
    add_definitions(parser)
    parser.add_argument("--display", help="display preset: nominal or phone")
    parser.add_argument("--algorithms", help="generators with options, separated by commas")
    parser.add_argument("--runs", type=int, default=9, metavar="N", help="timed runs (9)")
    parser.add_argument("--warmups", type=int, default=2, metavar="N", help="runs before (2)")
    parser.add_argument("--threads", type=int, metavar="T", help="threads to time with (all)")
    parser.add_argument(
        "--scaling", action="store_true", help="time against display and scene pixels; memory"
    )
    parser.add_argument(
        "--paper", action="store_true", help="the paper's three experiments; some minutes"
    )
    parser.add_argument(
        "--views", action="store_true", help="views by each lens model, and a textured rectangle"
    )
    parser.add_argument(
        "--layers",
        type=Path,
        nargs="+",
        default=[],
        metavar="SCENE",
        help="what layers are worth and cost on each of these scenes; some minutes",
    )
    parser.add_argument(
        "--commands",
        type=Path,
        metavar="SCENE",
        help="whole commands on this scene: cold, unchanged, changed, --lazy; some minutes",
    )
    add_quiet(parser)


def run(args: argparse.Namespace) -> int:
    """Carry out `inim bench`; the exit code."""
    from inim.bench.job import run_bench
    from inim.bench.request import BenchRequest, default_out

    request = BenchRequest(
        out=args.out or default_out(args.scene),
        scene=args.scene,
        definitions=tuple(args.definitions),
        display=args.display,
        algorithms=args.algorithms,
        runs=args.runs,
        warmups=args.warmups,
        threads=args.threads,
        scaling=args.scaling,
        paper=args.paper,
        views=args.views,
        layers=tuple(args.layers),
        commands=args.commands,
    )
    run_bench(request, quiet=args.quiet, debug=args.debug)
    if not args.quiet:
        print_outcome(f"bench: {request.out / 'bench.html'}")
    return EXIT_PASSED
