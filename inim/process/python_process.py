"""How a child process is started and ended; Python imports nothing that lies in the current folder.

`python -m` and `python -c` put the current folder before the standard library, and there lies
whatever a user keeps beside a scene: a `numpy.py` would be executed. What `PYTHONPATH` names is the
user's own choice, and stays.
"""

from __future__ import annotations

import math
import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.machinery import PathFinder
from pathlib import Path
from typing import TYPE_CHECKING, Any

import inim
from inim.process import interruption

if TYPE_CHECKING:
    import subprocess

_HAS_SAFE_PATH = sys.version_info >= (3, 11)


def python_code(code: str, *arguments: str) -> list[str]:
    """The command that runs some code; `arguments` are its ``sys.argv[1:]``."""
    if _HAS_SAFE_PATH:
        return [sys.executable, "-P", "-c", code, *arguments]
    return [sys.executable, "-c", f"import sys; del sys.path[0]\n{code}", *arguments]


def python_module(module: str, *arguments: str) -> list[str]:
    """The command that runs a module as a program."""
    if _HAS_SAFE_PATH:
        return [sys.executable, "-P", "-m", module, *arguments]
    run = f"import runpy; runpy.run_module({module!r}, run_name='__main__', alter_sys=True)"
    return python_code(run, *arguments)


def child_environment() -> dict[str, str]:
    """Variables for a child; with the package's own place, where it would be found by no other."""
    home = Path(inim.__file__).resolve().parents[1]
    try:
        here = Path.cwd()
    except OSError:  # it was deleted
        here = None
    elsewhere = [place for place in sys.path if place and Path(place).resolve() != here]
    found = PathFinder.find_spec("inim", elsewhere)
    if found is not None and found.origin and Path(found.origin).resolve().parents[1] == home:
        return dict(os.environ)
    places = [str(home), *filter(None, [os.environ.get("PYTHONPATH")])]
    return os.environ | {"PYTHONPATH": os.pathsep.join(places)}


@contextmanager
def started(words: Sequence[str], **options: Any) -> Iterator[subprocess.Popen[Any]]:
    """A child process, ended with the block if it still runs, and with the program.

    It never hears of SIGINT, which a terminal sends to all: Python's own start would answer with a
    traceback.

    Parameters
    ----------
    words : sequence of str
    **options
        Of `subprocess.Popen`.
    """
    with interruption.undone_afterwards(lambda: _deaf(words, options), end_process) as process:
        yield process


def _deaf(words: Sequence[str], options: dict[str, Any]) -> subprocess.Popen[Any]:
    """Start it with SIGINT blocked: a child has its parent's mask from its first instruction on."""
    import subprocess

    if not hasattr(signal, "pthread_sigmask"):
        return subprocess.Popen(words, **options)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return subprocess.Popen(words, **options)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def wait_for_parent() -> None:
    """Wait until the parent's end of this process's stdin closes: it has ended."""
    while os.read(0, 1):
        pass


def end_process(process: subprocess.Popen[Any]) -> None:
    """End a child that still runs, and wait for it; by force where it takes too long.

    Its `wait` would take a lock that the thread which a signal has interrupted may hold.
    """
    if not hasattr(os, "WNOHANG"):  # where no signal's handler could need it either
        process.kill()
        process.wait()
        return
    by_force = getattr(signal, "SIGKILL", signal.SIGTERM)
    for number, seconds in ((signal.SIGTERM, interruption.WAIT_S), (by_force, math.inf)):
        patience = time.monotonic() + seconds
        if process.returncode is None:
            with suppress(ProcessLookupError):
                os.kill(process.pid, number)
        while process.returncode is None and time.monotonic() < patience:
            try:
                found, status = os.waitpid(process.pid, os.WNOHANG)
            except ChildProcessError:  # another thread has waited for it just now
                return
            if found:
                process.returncode = os.waitstatus_to_exitcode(status)
            else:
                time.sleep(0.002)
