"""A worker's side of its life: one job under a listener, in silence but for results.

See `inim.worker.supervisor`, whose process it is.
"""

from __future__ import annotations

import contextlib
import io
import json
import logging
import os
import resource
import shutil
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable
from typing import Any

from inim import backend as backends
from inim.backend.numba_cache import go_without_cache, is_cache_fault
from inim.errors import InimError

__all__ = ["answer", "read_job", "serve"]

#: What a worker does with its job and a listener: publish, and say whether every check passed.
CarryOut = Callable[[dict[str, Any], Any], bool]


def answer(job: dict[str, Any], channel: Any, carry_out: CarryOut) -> None:
    """Carry out a job, saying stages and the outcome on the channel."""
    from inim.worker.console import ConsoleListener

    def say(message: dict[str, Any]) -> None:
        channel.write(json.dumps(message) + "\n")
        channel.flush()

    try:
        with ConsoleListener(job["quiet"], lambda stage: say({"stage": stage})) as listener:
            passed = _carried_out(job, listener, carry_out)
        say({"passed": passed})
    except InimError as error:
        if job["debug"] and error.__cause__:
            traceback.print_exception(error.__cause__)
        say({"error": type(error).__name__, "message": str(error)})
    except MemoryError:
        say({"error": "OutOfMemoryError", "message": _out_of_memory()})
    except Exception as error:
        if job["debug"]:
            raise
        text = " ".join(str(error).split())[:400]
        say(
            {
                "error": "InimError",
                "message": f"internal error: {type(error).__name__}: {text}; "
                "run again with --debug for the traceback, and report it",
            }
        )


def _out_of_memory() -> str:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    limit = backends.memory_limit_bytes()
    return (
        f"out of memory with {peak / 2**30:.1f} GiB in use of {limit / 2**30:.1f} GiB; use a "
        "display with fewer pixels"
    )


def _carried_out(job: dict[str, Any], listener: Any, carry_out: CarryOut) -> bool:
    """Carry out a job; once more where nothing but numba's cache of kernels was at fault."""
    try:
        return carry_out(job, listener)
    except InimError:
        raise
    except Exception as error:
        if not is_cache_fault(error):
            raise
        go_without_cache(error)
    return carry_out(job, listener)


class _Patient(io.StringIO):
    """A stdout whose reader may leave and whose disk may fill: the report is what counts."""

    def __init__(self, stream: Any) -> None:
        super().__init__()
        self._stream = stream
        if isinstance(stream, io.TextIOWrapper):  # a name must not fail for its encoding
            stream.reconfigure(errors="backslashreplace")

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError):
            self._stream.write(text)
            self._stream.flush()
        return len(text)


class _OwnWords:
    """A stderr without Dr.Jit's remarks, such as one on a missing home folder."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        self._dropping = False

    def write(self, text: str) -> int:
        # The line's end may come by itself.
        self._dropping = text.startswith("jit_") or (self._dropping and text == "\n")
        return len(text) if self._dropping else int(self._stream.write(text))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _end_with_parent(staging: str) -> None:
    """Wait for the parent's end of stdin to close: it died, and nobody else would clear away."""
    while os.read(0, 1):
        pass
    shutil.rmtree(staging, ignore_errors=True)
    os._exit(1)


def serve(job: dict[str, Any], channel: int, carry_out: CarryOut) -> None:
    """A worker's whole life: `carry_out` the job under a listener, in silence but for results."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to both; the parent acts
    threading.Thread(target=_end_with_parent, args=(job["staging"],), daemon=True).start()
    sys.stdout = _Patient(sys.stdout)
    if not job["debug"]:
        # What libraries mutter would break the one-line promise; our own stderr stays.
        warnings.simplefilter("ignore")
        logging.getLogger().addHandler(logging.NullHandler())
        own = os.fdopen(os.dup(2), "w", errors="backslashreplace", buffering=1)
        sys.stderr = _OwnWords(own)
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 2)
        os.close(silence)
    with os.fdopen(channel, "w", encoding="utf-8") as outcome_channel:
        answer(job, outcome_channel, carry_out)


def read_job() -> dict[str, Any]:
    """The worker's job, from its stdin; without one it ends, as its supervisor has."""
    line = b""
    while not line.endswith(b"\n"):  # nothing follows it
        more = os.read(0, 2**16)
        if not more:
            os._exit(1)
        line += more
    job: dict[str, Any] = json.loads(line)
    return job
