"""The worker process, which the supervisor starts: it runs one job under an observer.

It prints results on stdout and a progress bar on stderr, and silences libraries.
"""

from __future__ import annotations

import contextlib
import fcntl
import io
import json
import os
import pickle
import sys
import threading
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from inim.system.errors import InimError, unexpected_error
from inim.system.process import machine
from inim.system.process.locked_folder import lock_folder
from inim.system.process.observer import Observer, OnStage
from inim.system.process.printing import printable, quiet_libraries
from inim.system.process.python_process import exit_as_orphan, exit_with_parent
from inim.system.process.user_paths import AbsolutePathPickler, remember_user_paths, user_text

# Without the remaining time: the scores decide how many rounds of samples follow.
_BAR = "{desc} |{bar}| {elapsed}"
_REDRAW_S = 1.0


class ConsoleObserver(Observer):
    """Prints result lines and draws a bar that counts stages; the bar only on a terminal.

    With `quiet`, there are neither lines nor a bar. `on_stage` receives each stage's name, and the
    share of the stages before it.
    """

    def __init__(self, quiet: bool, on_stage: OnStage) -> None:
        super().__init__()
        self._quiet = quiet
        self._on_stage = on_stage
        self._bar: Any = None
        self._coming: list[str] = []
        self._finished = self._total = 0
        self._over = threading.Event()

    def __enter__(self) -> ConsoleObserver:
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        if self._bar is not None:
            self._thread.join()
            self._bar.close()

    def begin(self, stages: Sequence[str]) -> None:
        """See `Observer`."""
        self._coming = list(stages)
        self._total = (self._finished + 1 if self._total else 0) + len(stages)
        if self._bar is not None:
            self._bar.total = self._total
        elif not self._quiet and sys.stderr.isatty():
            from tqdm import tqdm

            self._bar = tqdm(
                total=len(stages),
                leave=False,
                dynamic_ncols=True,
                bar_format=_BAR,
                file=sys.stderr,
            )
            self._thread = threading.Thread(target=self._redraw, daemon=True)
            self._thread.start()

    def stage(self, name: str) -> None:
        """See `Observer`."""
        if name in self._coming:
            del self._coming[: self._coming.index(name) + 1]
            self._finished = self._total - len(self._coming) - 1
        self._on_stage(name, self._finished / self._total if self._total else 0.0)
        if self._bar is not None:
            self._bar.n = self._finished
            self._bar.set_description_str(f"{name}, step {self._finished + 1} of {self._total}")

    def line(self, text: str) -> None:
        """See `Observer`."""
        if self._quiet:
            return
        if self._bar is not None:
            self._bar.clear()
        print(printable(user_text(text)), flush=True)

    def _redraw(self) -> None:
        """Update the elapsed time during stages of many seconds."""
        while not self._over.wait(_REDRAW_S):
            self._bar.refresh()


#: Entry point of a worker: writes the result of a request into a staging folder; returns True if
#: every check passed.
RunJob = Callable[[Any, Path, Observer], bool]


@dataclass(frozen=True)
class Job:
    """Job of a worker.

    The request is any object that can be pickled; the result is built in the folder `staging`.
    `quiet` suppresses result lines and the progress bar, `debug` prints the traceback of an
    internal error.
    """

    request: Any
    staging: Path
    quiet: bool = True
    debug: bool = False


def answer(job: Job, channel: Any, run_job: RunJob) -> None:
    """Run a job and send its stages and its outcome through the channel."""

    def send(message: dict[str, Any]) -> None:
        with contextlib.suppress(OSError):  # the supervisor has ended
            channel.write(json.dumps(message) + "\n")
            channel.flush()

    try:
        with ConsoleObserver(
            job.quiet, lambda stage, share: send({"stage": stage, "share": share})
        ) as observer:
            passed = _run_with_retry(job, observer, run_job)
        send({"passed": passed})
    except InimError as error:
        if job.debug and error.__cause__:
            traceback.print_exception(error.__cause__)
        declared = next(c for c in type(error).__mro__ if c.__module__ == InimError.__module__)
        send({"error": declared.__name__, "message": user_text(error)})
    except MemoryError:
        message = (
            f"out of memory with {machine.peak_bytes() / 2**30:.1f} GiB in use of "
            f"{machine.memory_limit_bytes() / 2**30:.1f} GiB; use a display with fewer pixels"
        )
        send({"error": "OutOfMemoryError", "message": message})
    except Exception as error:
        if job.debug:
            raise
        unexpected = unexpected_error(error)
        send({"error": type(unexpected).__name__, "message": user_text(unexpected)})


def _run_with_retry(job: Job, observer: Observer, run_job: RunJob) -> bool:
    """Run a job; repeat it if only numba's kernel cache failed."""
    try:
        return run_job(job.request, job.staging, observer)
    except InimError:
        raise
    except Exception as error:
        if "numba" not in sys.modules:
            raise
        from inim.system.backend.kernels import disable_cache, is_cache_fault

        if not is_cache_fault(error):
            raise
        disable_cache()
    return run_job(job.request, job.staging, observer)


class _TolerantOutput(io.StringIO):
    """Standard output that ignores a closed reader or a full disk."""

    def __init__(self, stream: Any) -> None:
        super().__init__()
        self._stream = stream
        if isinstance(stream, io.TextIOWrapper):  # a file name may be impossible to encode
            stream.reconfigure(errors="backslashreplace")

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError):
            self._stream.write(text)
            self._stream.flush()
        return len(text)


class _FilteredErrors:
    """Standard error without messages of Dr.Jit, such as that of a missing home folder."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        self._dropping = False

    def write(self, text: str) -> int:
        # The end of the line may be written separately.
        self._dropping = text.startswith("jit_") or (self._dropping and text == "\n")
        return len(text) if self._dropping else int(self._stream.write(text))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def serve(job: Job, channel: int, run_job: RunJob) -> None:
    """Entry point of the worker: run the job under an observer, printing results only."""
    exit_with_parent()
    sys.stdout = _TolerantOutput(sys.stdout)
    ended = contextlib.ExitStack()
    if not job.debug:
        # Libraries must not write to stderr, where an error is a single line.
        ended.enter_context(quiet_libraries())
        own = os.fdopen(os.dup(2), "w", errors="backslashreplace", buffering=1)
        sys.stderr = _FilteredErrors(own)
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 2)
        os.close(silence)
    # Closing the channel of a supervisor that ended writes unread messages again.
    with (
        ended,
        contextlib.suppress(BrokenPipeError),
        os.fdopen(channel, "w", encoding="utf-8") as outcome_channel,
        # If the supervisor is killed, the next run must not remove the folder meanwhile.
        lock_folder(job.staging, fcntl.LOCK_SH),
    ):
        answer(job, outcome_channel, run_job)


def write_job(job: Job, stream: IO[bytes]) -> None:
    """Write a job to a worker's stdin, with absolute paths."""
    pickler = AbsolutePathPickler(stream)
    pickler.dump(job)
    pickle.dump(pickler.user_paths, stream)


def read_job() -> Job:
    """Read the worker's job from its stdin; exit if the supervisor has ended without sending it."""
    try:
        job: Job = pickle.load(sys.stdin.buffer)
        remember_user_paths(pickle.load(sys.stdin.buffer))
    except (EOFError, pickle.UnpicklingError):
        exit_as_orphan()
    return job
