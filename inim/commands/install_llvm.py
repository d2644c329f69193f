"""`inim install-llvm`: the library that the renderer compiles with on a CPU."""

from __future__ import annotations

import argparse

from inim.errors import EXIT_PASSED

__all__ = ["SUMMARY", "add_arguments", "run"]

SUMMARY = "get a usable libLLVM, as root or not"


def add_arguments(_: argparse.ArgumentParser) -> None:
    """It has none."""


def run(_: argparse.Namespace) -> int:
    """Install it; the exit code."""
    from inim.backend.install_llvm import install_llvm

    install_llvm()
    return EXIT_PASSED
