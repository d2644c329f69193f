"""Plugins: what other packages announce through entry points, and errors that name them.

Generators, metrics and lens models of other packages are entry points of the groups
``inim.generators``, ``inim.metrics`` and ``inim.lens_models``.
"""

from __future__ import annotations

import hashlib
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import metadata, util
from pathlib import Path
from threading import Lock
from typing import Any, TextIO

from inim.errors import InimError, OutOfMemoryError, UsageError

# Threads in which plugins run now, and what stdout is when there is none.
_LOCK = Lock()
_running = 0
_stdout: TextIO | None = None


def announced(group: str) -> list[str]:
    """Names that other packages announce in an entry-point group, sorted, each once."""
    return sorted({point.name for point in metadata.entry_points(group=group)})


def load(group: str, name: str, kind: str, make: Callable[[Any], Any] = lambda found: found) -> Any:
    """What an announced name stands for.

    Parameters
    ----------
    group, name : str
        Of the entry point; the name must be announced.
    kind : str
        For errors: "metric".
    make : callable, optional
        Makes the result of what is announced; what it raises counts as a failure to load.

    Raises
    ------
    UsageError
        Announced by several packages, or it cannot be imported.
    """
    points = list(metadata.entry_points(group=group, name=name))
    values = sorted({point.value for point in points})
    if len(values) > 1:
        raise UsageError(
            f"{kind} {name!r} is announced by several packages ({', '.join(values)}); "
            "uninstall all but one"
        )
    try:
        return make(points[0].load())
    except (Exception, SystemExit) as error:
        raise UsageError(
            f"{kind} {name!r} ({values[0]}) cannot be loaded: {type(error).__name__}: "
            f"{' '.join(str(error).split())[:400]}"
        ) from error


def identity(group: str, name: str) -> dict[str, str]:
    """What tells one state of a plugin from another: entry point, version, SHA-256 of its module.

    Who writes a plugin edits its file long before its version.
    """
    point = next(iter(metadata.entry_points(group=group, name=name)))
    found = {"entry_point": point.value}
    if point.dist is not None:
        found["version"] = point.dist.version
    spec = util.find_spec(point.module)
    if spec is not None and spec.origin is not None:
        found["sha256"] = hashlib.sha256(Path(spec.origin).read_bytes()).hexdigest()
    return found


@contextmanager
def stdout_to_stderr() -> Iterator[None]:
    """While a plugin runs, in one thread or several, what it prints goes to stderr.

    The program's own stdout is for results. `contextlib.redirect_stdout` in two threads at once
    would leave it redirected.
    """
    global _running, _stdout
    with _LOCK:
        if not _running:
            _stdout, sys.stdout = sys.stdout, sys.stderr
        _running += 1
    try:
        yield
    finally:
        with _LOCK:
            _running -= 1
            if not _running and _stdout is not None:
                sys.stdout = _stdout


@contextmanager
def blame(what: str, doing: str, also: tuple[str, ...] = ()) -> Iterator[None]:
    """Turn what a plugin raises into one line that names it; what it prints goes to stderr.

    Parameters
    ----------
    what : str
        The plugin: "metric 'mine'".
    doing : str
        What it was called for.
    also : tuple of str
        Other beginnings of errors that name it already.

    Raises
    ------
    UsageError
        In place of any exception but want of memory.
    """
    try:
        with stdout_to_stderr():
            yield
    except (MemoryError, OutOfMemoryError):
        raise
    except InimError as error:
        if str(error).startswith((what, *also)):
            raise
        raise UsageError(f"{what}: {error}") from error
    except (Exception, SystemExit) as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        raise UsageError(
            f"{what} failed in {doing}: {type(error).__name__}: "
            f"{' '.join(str(error).split())[:400]} ({last.filename}, line {last.lineno}); "
            "--debug shows the traceback"
        ) from error
