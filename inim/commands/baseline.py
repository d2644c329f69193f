"""`inim baseline accept`: a report becomes what later runs are compared with."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from inim.commands.options import add_exit_codes
from inim.errors import EXIT_PASSED

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "accept a report as what later runs are compared with"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `inim baseline`."""
    add_exit_codes(parser)
    actions: Any = parser.add_subparsers(required=True, metavar="accept")
    accept = actions.add_parser("accept", help="make a report the baseline of its scene")
    accept.add_argument("out", type=Path, metavar="OUT", help="folder of a report")
    accept.add_argument("--reason", required=True, help="why, in a line; kept in the baseline")
    accept.add_argument(
        "--to",
        type=Path,
        metavar="DIR",
        help="folder of the baseline (default: the one compared with, or reports/baselines/TITLE)",
    )


def run(args: argparse.Namespace) -> int:
    """Carry out `inim baseline accept`; the exit code."""
    from inim.pipeline.baseline import accept

    print(f"baseline: {accept(args.out, args.reason, args.to)}")
    return EXIT_PASSED
