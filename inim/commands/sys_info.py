"""`inim sys-info`: what the renderer can run on here."""

from __future__ import annotations

import argparse
import json

from inim.errors import EXIT_PASSED

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "what the renderer can run on here"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `inim sys-info`."""
    parser.add_argument("--json", action="store_true", help="as JSON")


def run(args: argparse.Namespace) -> int:
    """Print it; the exit code."""
    from inim import backend

    print(json.dumps(backend.describe(), indent=1) if args.json else backend.sys_info())
    return EXIT_PASSED
