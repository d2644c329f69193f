"""Start and end of Python processes, and protection from files in the current folder.

`python -m` and `python -c` put the current folder before the standard library, so a
`numpy.py` next to a scene would be executed. `PYTHONPATH` is
the user's choice and remains in effect. numba, matplotlib and dask read configuration files there.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.machinery import PathFinder
from pathlib import Path
from typing import TYPE_CHECKING, Any

import inim

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


def child_environment() -> dict[str, str]:
    """Environment variables for a child, with the package's folder if it is not found otherwise."""
    home = Path(inim.__file__).resolve().parents[1]
    try:
        here = Path.cwd()
    except OSError:  # the current folder was deleted
        here = None
    elsewhere = [place for place in sys.path if place and Path(place).resolve() != here]
    spec = PathFinder.find_spec("inim", elsewhere)
    if spec is not None and spec.origin and Path(spec.origin).resolve().parents[1] == home:
        return dict(os.environ)
    places = [str(home), *filter(None, [os.environ.get("PYTHONPATH")])]
    return os.environ | {"PYTHONPATH": os.pathsep.join(places)}


def exit_with_parent() -> None:
    """End this process as soon as its parent has ended and thereby closed its stdin."""
    threading.Thread(target=_wait_for_parent, daemon=True).start()


def _wait_for_parent() -> None:
    while os.read(0, 1):
        pass
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
