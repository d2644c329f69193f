"""`inim stress`: where the numbers stop being trustworthy."""

from __future__ import annotations

import argparse
from pathlib import Path

from inim.commands.options import add_definitions, add_exit_codes, add_quiet, print_outcome
from inim.errors import EXIT_CHECK_FAILED, EXIT_PASSED

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "find where the numbers stop being trustworthy"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `inim stress`."""
    add_exit_codes(parser)
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
    add_definitions(parser)
    parser.add_argument(
        "--algorithms",
        default="",
        metavar="LIST",
        help="separated by commas, with options as name:key=value (default: all there are)",
    )
    parser.add_argument("--quick", action="store_true", help="fewer and smaller cases")
    add_quiet(parser)


def run(args: argparse.Namespace) -> int:
    """Carry out `inim stress`; the exit code."""
    from inim.stress.job import StressRequest, default_out, run_stress

    request = StressRequest(
        out=args.out or default_out(args.scene),
        scene=args.scene,
        definitions=tuple(args.definitions),
        algorithms=args.algorithms,
        quick=args.quick,
    )
    passed = run_stress(request, quiet=args.quiet, debug=args.debug)
    if not args.quiet:
        print_outcome(f"{'passed' if passed else 'FAILED'}; {request.out / 'stress.html'}")
    return EXIT_PASSED if passed else EXIT_CHECK_FAILED
