"""SIGINT, SIGTERM and SIGHUP as exceptions, blocks that they do not interrupt, and cleaning up."""

from __future__ import annotations

import os
import signal
import sys
import threading
from contextlib import contextmanager

# Importing `typing` takes longer than all else here: signals are not yet handled meanwhile.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from typing import Any, NoReturn

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")  # the last when a terminal closes
_received: list[int] = []
# What an interrupted program must still end or remove.
_clean_ups: dict[tuple[int, object], Callable[[], object]] = {}
# Seconds after which an interrupt that Python ignored is sent again.
_AGAIN_S = 0.05
_SIGNALS = [getattr(signal, name) for name in _NAMES if hasattr(signal, name)]


def raise_interrupts() -> None:
    """Let these signals raise `KeyboardInterrupt` with their number; ignored ones stay ignored."""
    _set_handlers(_raise)
    sys.unraisablehook = _send_again


def ignore_interrupts() -> None:
    """Ignore these signals after the outcome was printed."""
    _set_handlers(signal.SIG_IGN)


def _set_handlers(handler: object) -> dict[int, Any]:
    """Set a handler for the signals that are not ignored, and return the earlier ones."""
    handled = [number for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
    return {number: signal.signal(number, handler) for number in handled}  # type: ignore[arg-type]


def _raise(number: int, _: object) -> NoReturn:
    _received.append(number)
    raise KeyboardInterrupt(number)


def _send_again(unraisable: Any) -> None:
    """Send an interrupt again that was raised where Python ignores exceptions: in a callback."""
    if unraisable.exc_type is KeyboardInterrupt and _received:
        timer = threading.Timer(_AGAIN_S, os.kill, (os.getpid(), _received[-1]))
        timer.daemon = True
        timer.start()
    else:
        sys.__unraisablehook__(unraisable)


def raise_again() -> None:
    """Raise the last interrupt again, which an interrupted import may have replaced."""
    if _received:
        raise KeyboardInterrupt(_received[-1])


@contextmanager
def delayed_interrupts() -> Iterator[None]:
    """Delay these signals until the block ends.

    Python handles signals in its main thread: blocks of other threads are never interrupted.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []
    handlers = _set_handlers(lambda number, _: received.append(number))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        if received:
            signal.raise_signal(received[0])


@contextmanager
def cleaned_up(clean_up: Callable[[], object]) -> Iterator[None]:
    """Call `clean_up` after the block, and again at the program's end if an interrupt prevents it.

    An interrupt may arrive between any two instructions, and skip the end of a block. So enter this
    block before the folder or process is created, or while interrupts are delayed; `clean_up`
    accepts that it does not exist.
    """
    key = (threading.get_ident(), object())
    _clean_ups[key] = clean_up
    try:
        yield
    finally:
        with delayed_interrupts():  # `rmtree` would turn an interrupt into an OSError
            own = [other for other in [*_clean_ups] if other[0] == key[0]]
            # Blocks inside come first: an interrupt may have skipped the end of one.
            while key in _clean_ups:
                inner = own.pop()
                _clean_ups[inner]()
                del _clean_ups[inner]


def clean_up_blocks() -> None:
    """Ignore further interrupts, and clean up the blocks of `cleaned_up`, the innermost first."""
    ignore_interrupts()
    for clean_up in reversed([*_clean_ups.values()]):
        clean_up()
