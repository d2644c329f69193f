"""A backend, and how a process or its children are made to use it."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from inim.backend.libllvm import LLVM_VARIABLE, PRIVATE_MARKER, is_libllvm, private_folders
from inim.errors import BackendError

__all__ = ["Backend", "activate", "environment", "variables_for"]


class Backend(NamedTuple):
    """A backend that was seen to work: what to load and how to call it in words.

    Attributes
    ----------
    name : {"cuda", "llvm"}
    variant : str
        Mitsuba's name for it.
    libllvm : Path or None
    libllvm_version : str or None
    device : str
        The processor or graphics card, for people.
    """

    name: str
    variant: str
    libllvm: Path | None
    libllvm_version: str | None
    device: str


def environment(backend: Backend) -> dict[str, str]:
    """The variables to set for a child process that will use `backend`."""
    return variables_for(backend.libllvm)


def activate(backend: Backend) -> None:
    """Make this process use `backend`. To be called before Mitsuba is first imported.

    Raises
    ------
    BackendError
        Dr.Jit is loaded already and was set up for another libLLVM.
    """
    variables = environment(backend)
    wanted = variables.get(LLVM_VARIABLE)
    if "drjit" in sys.modules and wanted and os.environ.get(LLVM_VARIABLE) != wanted:
        raise BackendError(
            f"{wanted} cannot be used: Dr.Jit is loaded already, with "
            f"{os.environ.get(LLVM_VARIABLE) or 'a libLLVM of its own choice'}; "
            f"call inim.backend.activate before importing mitsuba"
        )
    _preload(_companions(backend.libllvm))
    os.environ.update(variables)


def variables_for(library: Path | None) -> dict[str, str]:
    """The variables that make a child use a libLLVM, or CUDA where it is None."""
    variables = {LLVM_VARIABLE: str(library)} if library else {}
    folders = [str(folder) for folder in _companions(library)]
    if folders:
        before = os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)
        every = dict.fromkeys([*folders, *before])
        variables["LD_LIBRARY_PATH"] = os.pathsep.join(folder for folder in every if folder)
    return variables


def _companions(library: Path | None) -> list[Path]:
    """Private folders whose libraries the system lacks: LLVM's dependencies, libatomic."""
    folders = [*([library.parent] if library else []), *private_folders()]
    return [folder for folder in dict.fromkeys(folders) if (folder / PRIVATE_MARKER).is_file()]


def _preload(folders: Iterable[Path]) -> None:
    """Load the private libraries into this process, in whatever order they allow.

    LD_LIBRARY_PATH is read when a process starts, so it serves children only. What is
    loaded already satisfies, by its name, the later demands of libLLVM and Dr.Jit.
    """
    import ctypes

    waiting = [path for folder in folders for path in sorted(folder.glob("*.so*"))]
    waiting = [path for path in waiting if not is_libllvm(path.name)]
    progress = True
    while waiting and progress:
        left = []
        for path in waiting:
            try:
                ctypes.CDLL(str(path))
            except OSError:
                left.append(path)
        progress, waiting = len(left) < len(waiting), left
