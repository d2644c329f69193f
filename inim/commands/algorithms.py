"""`inim algorithms`: the algorithms and their options."""

from __future__ import annotations

import argparse

from inim.errors import EXIT_PASSED

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "list the algorithms and their options"


def add_arguments(_: argparse.ArgumentParser) -> None:
    """It has none."""


def run(_: argparse.Namespace) -> int:
    """Print them; the exit code."""
    from inim.pipeline.method import algorithm_table

    print(algorithm_table())
    return EXIT_PASSED
