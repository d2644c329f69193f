"""The command line of the bench."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from pathlib import Path

from inim.errors import EXIT_PASSED

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `inim bench`."""
    parser.description = (
        "Time each algorithm on a scene's display-ready picture, and set the times against the "
        "errors. All take turns with a reference kernel of one 4-byte gather per display pixel; "
        "times are given in its time, too: in yardsticks."
    )
    parser.add_argument("scene", type=Path, help="Mitsuba scene (.xml)")
    parser.add_argument("-o", "--out", type=Path, help="folder (default: SCENE-bench)")
    parser.add_argument(
        "-D",
        dest="definitions",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override an inim.* setting or a scene parameter; may be repeated",
    )
    parser.add_argument("--display", help="display preset: nominal or phone")
    parser.add_argument(
        "--algorithms",
        help="generators with options, separated by commas (all, other packages' included)",
    )
    parser.add_argument("--runs", type=int, default=9, metavar="N", help="timed runs (9)")
    parser.add_argument("--warmups", type=int, default=2, metavar="N", help="runs before (2)")
    parser.add_argument("--threads", type=int, metavar="T", help="threads to time with (all)")
    parser.add_argument("--quiet", action="store_true", help="print errors only")
    parser.add_argument("--debug", action="store_true", help="show tracebacks of internal errors")


def run(args: argparse.Namespace) -> int:
    """Carry out `inim bench`; the exit code."""
    from inim.bench.job import BenchRequest, default_out, run_bench

    # SIGTERM takes the worker and its half-written files along, as Ctrl-C does.
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    request = BenchRequest(
        scene=args.scene,
        out=args.out or default_out(args.scene),
        definitions=tuple(args.definitions),
        display=args.display,
        algorithms=args.algorithms,
        runs=args.runs,
        warmups=args.warmups,
        threads=args.threads,
    )
    run_bench(request, quiet=args.quiet, debug=args.debug)
    if not args.quiet:
        try:
            print(f"bench: {request.out / 'bench.html'}", flush=True)
        except OSError:  # the reader left, or its disk is full
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return EXIT_PASSED
