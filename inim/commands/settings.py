"""`inim settings`: the `inim.*` settings of scene files."""

from __future__ import annotations

import argparse

from inim.errors import EXIT_PASSED

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "list the inim.* settings of scene files"


def add_arguments(_: argparse.ArgumentParser) -> None:
    """It has none."""


def run(_: argparse.Namespace) -> int:
    """Print them; the exit code."""
    from inim.settings import setting_table

    print(setting_table())
    return EXIT_PASSED
