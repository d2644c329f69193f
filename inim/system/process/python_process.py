"""Start and end of Python processes, and protection from files in the current folder.

`python -m` and `python -c` put the current folder before the standard library, so a
`numpy.py` next to a scene would be executed. `PYTHONPATH` is
the user's choice and remains in effect. numba, matplotlib and dask read configuration files there.
Mitsuba loads plugins and data from there, so every process that renders starts in an empty folder.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from importlib.machinery import PathFinder
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from inim.system.process.atomic_file import file_errors
from inim.system.process.interrupts import cleaned_up, delayed_interrupts

if TYPE_CHECKING:
    import subprocess


# Time for a worker to finish moving its results.
_PATIENCE_S = 10.0
_HAS_SAFE_PATH = sys.version_info >= (3, 11)


def python_code(code: str, *arguments: str) -> list[str]:
    """Command that runs Python code; `arguments` are its ``sys.argv[1:]``."""
    if _HAS_SAFE_PATH:
        return [sys.executable, "-P", "-c", code, *arguments]
    return [sys.executable, "-c", f"import sys; del sys.path[0]\n{code}", *arguments]


def python_module(module: str, *arguments: str) -> list[str]:
    """Command that runs a module as a program."""
    if _HAS_SAFE_PATH:
        return [sys.executable, "-P", "-m", module, *arguments]
    run = f"import runpy; runpy.run_module({module!r}, run_name='__main__', alter_sys=True)"
    return python_code(run, *arguments)


# Variables with a folder, which may be relative to the current one, or with a list of folders.
_FOLDER_VARIABLES = ("NUMBA_CACHE_DIR", "INIM_CACHE")
_NO_FOLDER = "off"  # of `INIM_CACHE`
_LIST_VARIABLES = ("PYTHONPATH", "LD_LIBRARY_PATH")


def child_environment() -> dict[str, str]:
    """Environment variables for a child, which may run in another folder.

    Paths are absolute. The package's folder is added if Python would not find it otherwise.
    """
    variables = dict(os.environ)
    for name in (*_FOLDER_VARIABLES, *_LIST_VARIABLES):
        value = variables.get(name, "")
        folders = value.split(os.pathsep) if name in _LIST_VARIABLES else [value]
        if value and value.lower() != _NO_FOLDER:
            with suppress(OSError):  # the current folder was deleted
                absolute = [str(Path(folder).absolute()) for folder in folders if folder]
                variables[name] = os.pathsep.join(absolute)
    home = Path(__file__).resolve().parents[3]
    try:
        here = Path.cwd()
    except OSError:  # the current folder was deleted
        here = None
    elsewhere = [place for place in sys.path if place and Path(place).resolve() != here]
    spec = PathFinder.find_spec("inim", elsewhere)
    if spec is not None and spec.origin and Path(spec.origin).resolve().parents[1] == home:
        return variables
    python_path = os.pathsep.join(filter(None, [str(home), variables.get("PYTHONPATH")]))
    return variables | {"PYTHONPATH": python_path}


@contextmanager
def rendering_process(
    command: Sequence[str], variables: Mapping[str, str], **options: Any
) -> Iterator[subprocess.Popen[Any]]:
    """Start a process that imports the renderer, in an empty folder of its own; end it afterwards.

    * `variables`: additional environment variables.
    * `options`: those of `subprocess.Popen`.

    Raises `FileError`: no temporary folder can be created.
    """
    import signal
    import subprocess
    import tempfile

    from inim.system.process.locked_folder import locked_folder

    with ExitStack() as stack:
        place = Path(tempfile.gettempdir())
        with file_errors(place, "set TMPDIR to a folder that can be written"):
            folder = stack.enter_context(locked_folder(place, "inim-run-"))
        with delayed_interrupts():
            # A terminal sends SIGINT to all processes, and Python would print a traceback while it
            # starts. A child inherits the mask of its parent.
            mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            try:
                process = subprocess.Popen(
                    command, cwd=folder, env={**child_environment(), **variables}, **options
                )
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            stack.enter_context(cleaned_up(partial(_end_and_close, process)))
        yield process


def _end_and_close(process: subprocess.Popen[Any]) -> None:
    end_process(process)
    for stream in filter(None, (process.stdin, process.stdout, process.stderr)):
        with suppress(OSError):  # not all input was read
            stream.close()


def exit_with_parent() -> None:
    """End this process as soon as its parent has ended and thereby closed its stdin."""
    threading.Thread(target=_wait_for_parent, daemon=True).start()


def _wait_for_parent() -> None:
    while os.read(0, 1):
        pass
    exit_as_orphan()


def exit_as_orphan() -> NoReturn:
    """End this process, and remove its empty folder, which a parent that was killed has left."""
    with suppress(OSError):
        os.rmdir(os.getcwd())  # noqa: PTH106, PTH109
    os._exit(1)


def end_process(process: subprocess.Popen[Any]) -> None:
    """End a child that still runs, and wait for it; kill it if that takes too long."""
    import subprocess

    process.terminate()
    try:
        process.wait(_PATIENCE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


# numba, matplotlib and dask look for these names with `os.path.exists`. numba's file can name a
# folder whose compiled kernels are executed, dask's a module; matplotlib's changes figures, and a
# FIFO would hang. dask's folder is in the current one for users without a home.
_NAMES = (".numba_config.yaml", "matplotlibrc", ".config/dask", "~/.config/dask")


@contextmanager
def configuration_hidden() -> Iterator[None]:
    """Hide configuration files of the current folder from all packages of this process."""
    exists = os.path.exists

    def exists_elsewhere(path: Any) -> bool:
        return path not in _NAMES and exists(path)

    os.path.exists = exists_elsewhere
    try:
        yield
    finally:
        os.path.exists = exists
