"""Marks of algorithms whose kernels are compiled, and of those that a process is compiling."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from inim import generators
from inim.backend.numba_cache import kernel_folder
from inim.backend.provenance import versions
from inim.cache.digest import code_digest, value_digest
from inim.display import Display
from inim.process.machine import cpu_model

# Longer than all kernels take where four processes share a processor.
_MOST_WAIT_S = 60.0
_POLL_S = 0.02
_DONE = b"compiled\n"


def is_compiled(algorithm: str, display: Display) -> bool:
    """Whether a process has compiled all kernels of an algorithm, and said so."""
    try:
        return _mark(algorithm, display).read_bytes() == _DONE
    except OSError:
        return False


@contextmanager
def compiling(algorithm: str, display: Display) -> Iterator[bool]:
    """Let others know that an algorithm's kernels are being compiled, and have been afterwards.

    Yields
    ------
    bool
        False where another process is at it.
    """
    path = _mark(algorithm, display)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("ab") as mark:
        mine = _locked(mark, alone=True)
        yield mine
        if mine:
            mark.truncate(0)
            mark.write(_DONE)


def wait_until_compiled(algorithm: str, display: Display) -> None:
    """Wait while another process compiles an algorithm's kernels: to do it again takes longer."""
    patience = time.monotonic() + _MOST_WAIT_S
    with suppress(OSError), _mark(algorithm, display).open("rb") as mark:
        while not _locked(mark, alone=False) and time.monotonic() < patience:
            time.sleep(_POLL_S)


def _mark(algorithm: str, display: Display) -> Path:
    """A file beside the kernels, locked while they are compiled; other forms take others."""
    form = [display.is_separable, display.has_integer_ratio]
    decided_by = [algorithm, form, sys.version, cpu_model(), code_digest("generators")]
    found = value_digest([*decided_by, versions(("llvmlite", "numba", "numpy"))])
    return kernel_folder(Path(generators.__file__).parent) / f"inim-{found}.compiled"


def _locked(mark: BinaryIO, *, alone: bool) -> bool:
    """Whether a lock was to be had now; only workers and their helpers ask."""
    import fcntl

    try:
        fcntl.flock(mark, (fcntl.LOCK_EX if alone else fcntl.LOCK_SH) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
