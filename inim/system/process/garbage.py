"""Pausing Python's garbage collector while it would do harm."""

import gc
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_LOCK = threading.Lock()
_pauses = 0


@contextmanager
def no_garbage_collection() -> Iterator[None]:
    """Pause the garbage collector, in all threads, until the last of overlapping pauses ends."""
    global _pauses
    with _LOCK:
        counted = _pauses > 0 or gc.isenabled()  # else the program does without it
        _pauses += counted
        gc.disable()
    try:
        yield
    finally:
        with _LOCK:
            _pauses -= counted
            if counted and _pauses == 0:
                gc.enable()
