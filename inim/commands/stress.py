"""The command line of the stress run."""

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
        "Set every generator and lens model, in float32 and float64, against oracles of their own "
        "definitions where numbers are worst; say where results can be trusted."
    )
    parser.add_argument(
        "scene",
        type=Path,
        nargs="?",
        help="Mitsuba scene (.xml) whose depth is jittered; two synthetic spheres otherwise",
    )
    parser.add_argument("-o", "--out", type=Path, help="folder (default: SCENE-stress)")
    add_definitions(parser)
    parser.add_argument("--quick", action="store_true", help="fewer and smaller cases")
    add_quiet(parser)


def run(args: argparse.Namespace) -> int:
    """Carry out `inim stress`; the exit code."""
    from inim.stress.job import run_stress
    from inim.stress.request import StressRequest, default_out

    request = StressRequest(
        out=args.out or default_out(args.scene),
        scene=args.scene,
        definitions=tuple(args.definitions),
        quick=args.quick,
    )
    passed = run_stress(request, quiet=args.quiet, debug=args.debug)
    if not args.quiet:
        print_outcome(f"{'passed' if passed else 'FAILED'}; {request.out / 'stress.html'}")
    return EXIT_PASSED if passed else EXIT_CHECK_FAILED
