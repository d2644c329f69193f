"""`inim bench`: the algorithms timed against their error."""

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
        "Time each algorithm on a scene's display-ready picture, and set the times against the "
        "errors. All take turns with a reference kernel of one 4-byte gather per display pixel; "
        "times are given in its time, too: in yardsticks."
    )
    parser.add_argument("scene", type=Path, help="Mitsuba scene (.xml)")
    parser.add_argument("-o", "--out", type=Path, help="folder (default: SCENE-bench)")
    add_definitions(parser)
    parser.add_argument("--display", help="display preset: nominal or phone")
    parser.add_argument(
        "--algorithms",
        help="generators with options, separated by commas (all, other packages' included)",
    )
    parser.add_argument("--runs", type=int, default=9, metavar="N", help="timed runs (9)")
    parser.add_argument("--warmups", type=int, default=2, metavar="N", help="runs before (2)")
    parser.add_argument("--threads", type=int, metavar="T", help="threads to time with (all)")
    add_quiet(parser)


def run(args: argparse.Namespace) -> int:
    """Carry out `inim bench`; the exit code."""
    from inim.bench.job import BenchRequest, default_out, run_bench

    request = BenchRequest(
        out=args.out or default_out(args.scene),
        scene=args.scene,
        definitions=tuple(args.definitions),
        display=args.display,
        algorithms=args.algorithms,
        runs=args.runs,
        warmups=args.warmups,
        threads=args.threads,
    )
    run_bench(request, quiet=args.quiet, debug=args.debug)
    if not args.quiet:
        print_outcome(f"bench: {request.out / 'bench.html'}")
    return EXIT_PASSED
