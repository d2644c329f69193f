"""SIGINT and SIGTERM end the program at once, with nothing half done left behind.

An exception would not do: raised in a `__del__`, a weak reference's callback or one that native
code calls, Python prints it and goes on; some libraries turn it into errors of their own; and where
no `try` stands yet, or any more, it is a traceback. So the handler itself undoes what is half done,
says its line and ends the process. It is `inim.program` that installs it, and nobody else: in a
notebook `KeyboardInterrupt` is raised as ever, and what is made here is undone on its way out.

The handler takes no lock that what it interrupted may hold, and neither may an undoing.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

# Every module that is loaded here is time in which signals are not yet heeded: `typing` is most.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from pathlib import Path
    from typing import NoReturn, TypeVar

    T = TypeVar("T")

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
# A worker that publishes is waited for as long, and so is a thread that is just making something.
WAIT_S = 10.0
_NOTHING = "; nothing was written"

_undo: dict[object, Callable[[], object]] = {}
# Threads that are inside a block which no end may cut in two.
_inside: list[int] = []
# The exit code that was asked for, 0 if none was, and the thread that is carrying it out.
_asked = 0
_ender: int | None = None
_words = _NOTHING
_is_worker = False


def install() -> None:
    """Let signals end this process, those that it was told to ignore aside."""
    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _handle)


def too_late() -> None:
    """Ignore signals from now on: the program is done and has said so."""
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def this_is_a_worker() -> None:
    """Leave signals to the supervisor: a terminal sends SIGINT to both."""
    global _is_worker
    _is_worker = True
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def say(words: str) -> None:
    """What the line says at Ctrl-C, after "interrupted"."""
    global _words
    _words = f"; {words}"


def written() -> None:
    """Something was written: the line must not deny it. Said before it is."""
    global _words
    if _words == _NOTHING:
        _words = ""


def remove_file(path: Path) -> None:
    """Undo a file, which may be gone."""
    with suppress(OSError):
        path.unlink()


@contextmanager
def undone_afterwards(make: Callable[[], T], undo: Callable[[T], object]) -> Iterator[T]:
    """Something temporary, undone when the block ends or a signal ends the program.

    Parameters
    ----------
    make : callable
        Makes it; no signal ends the program meanwhile.
    undo : callable
        Is given what was made. It may be called twice, and must take no lock.
    """
    key = object()
    with _whole():
        made = make()
        _undo[key] = lambda: undo(made)
    try:
        yield made
    finally:
        undo(made)
        del _undo[key]


@contextmanager
def publishing() -> Iterator[None]:
    """Let results reach their place as a whole, whatever signal comes.

    A worker ignores SIGTERM from here on: it is about to end by itself, and how it does tells its
    supervisor whether something was written.
    """
    if _is_worker:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    with _whole():
        written()
        yield


@contextmanager
def _whole() -> Iterator[None]:
    """Put an end off until the block has ended; begin none once an end has begun."""
    me = threading.get_ident()
    _inside.append(me)
    try:
        if _ender not in (None, me):
            _inside.remove(me)
            while True:  # the process ends meanwhile
                time.sleep(1)
        yield
    finally:
        if me in _inside:
            _inside.remove(me)
        if _asked and threading.current_thread() is threading.main_thread():
            _end_unless_inside()


def _handle(number: int, _: object) -> None:
    global _asked
    if not _asked:
        _asked = 128 + number
        if hasattr(signal, "SIGALRM"):  # a block may wait for somebody else, who has stopped
            signal.signal(signal.SIGALRM, lambda *_: end(_asked))
            signal.setitimer(signal.ITIMER_REAL, WAIT_S)
    _end_unless_inside()


def _end_unless_inside() -> None:
    if threading.get_ident() not in _inside:  # else at the end of the block
        end(_asked)


def end(code: int) -> NoReturn:
    """End this process: undo what is half done, newest first, and say the line if it was Ctrl-C."""
    global _ender
    _ender = threading.get_ident()
    if threading.current_thread() is threading.main_thread():
        too_late()
        if hasattr(signal, "SIGALRM"):
            signal.setitimer(signal.ITIMER_REAL, 0)
    patience = time.monotonic() + WAIT_S
    while {*_inside} - {_ender} and time.monotonic() < patience:
        time.sleep(0.001)
    for undo in reversed(list(_undo.values())):
        with suppress(BaseException):
            undo()
    if code == 128 + signal.SIGINT:
        with suppress(OSError):
            os.write(2, f"inim: interrupted{_words}\n".encode())
    os._exit(code)
