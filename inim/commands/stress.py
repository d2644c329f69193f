"""The command line of the stress run."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from pathlib import Path

from inim.errors import EXIT_CHECK_FAILED, EXIT_PASSED

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `inim stress`."""
    parser.description = (
        "Set algorithms, other people's too, against the exact first hits and against relations "
        "that hold whatever the right answer is; measure what small errors of depth cost."
    )
    parser.add_argument(
        "scene",
        type=Path,
        nargs="?",
        help="Mitsuba scene (.xml) whose depth is jittered; two synthetic spheres otherwise",
    )
    parser.add_argument("-o", "--out", type=Path, help="folder (default: SCENE-stress)")
    parser.add_argument(
        "-D",
        dest="definitions",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override an inim.* setting or a scene parameter; may be repeated",
    )
    parser.add_argument(
        "--algorithms",
        default="",
        metavar="LIST",
        help="separated by commas, with options as name:key=value (default: all there are)",
    )
    parser.add_argument("--quick", action="store_true", help="fewer and smaller cases")
    parser.add_argument("--quiet", action="store_true", help="print errors only")
    parser.add_argument("--debug", action="store_true", help="show tracebacks of internal errors")


def run(args: argparse.Namespace) -> int:
    """Carry out `inim stress`; the exit code."""
    from inim.stress.job import StressRequest, default_out, run_stress

    # An asked-for end takes the worker and its half-written files along, as Ctrl-C does.
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    request = StressRequest(
        out=args.out or default_out(args.scene),
        scene=args.scene,
        definitions=tuple(args.definitions),
        algorithms=args.algorithms,
        quick=args.quick,
    )
    passed = run_stress(request, quiet=args.quiet, debug=args.debug)
    if not args.quiet:
        try:
            print(f"{'passed' if passed else 'FAILED'}; {request.out / 'stress.html'}", flush=True)
        except OSError:  # the reader left, or its disk is full; the verdict stands
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return EXIT_PASSED if passed else EXIT_CHECK_FAILED
