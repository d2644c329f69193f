"""One supervised worker per job: native code can die, the job's owner must not.

A damaged mesh, a kernel that will not compile or memory running out kill the process without an
exception. So the heavy part runs in one spawned worker, and the parent turns any death into an
exit code and a sentence, and clears away what was half written.
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
import subprocess
import sys
import threading
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from inim import backend as backends
from inim import errors
from inim.errors import InimError, OutOfMemoryError, WorkerError
from inim.jobs.output import open_staging
from inim.jobs.plan import Request, make_plan
from inim.numba_cache import go_without_cache, is_cache_fault

__all__ = ["Watcher", "outcome_of", "run_in_worker", "serve", "supervise", "work"]

#: What a worker does with its job and a listener: publish, and say whether every check passed.
CarryOut = Callable[[dict[str, Any], Any], bool]

# A worker that died while holding this share of the memory died of it.
_MEMORY_SHARE = 0.8
_ERRORS = {
    cls.__name__: cls
    for cls in vars(errors).values()
    if isinstance(cls, type) and issubclass(cls, InimError)
}


def run_in_worker(request: Request, *, quiet: bool = True, debug: bool = False) -> bool:
    """Validate in a worker process; the report is in `request.out` afterwards.

    Parameters
    ----------
    request : Request
    quiet : bool
        No result lines on stdout and no progress bar on stderr.
    debug : bool
        Let the worker print the traceback of an internal error.

    Returns
    -------
    bool
        Whether every check passed.

    Raises
    ------
    InimError
        What the worker raised, or `WorkerError` / `OutOfMemoryError` where it could not say.
    """
    make_plan(request)  # cheap; most mistakes end here, before a process is started
    backend = backends.choose_backend(request.backend)
    staging = open_staging(request.out)
    job = {
        "request": request.as_json(),
        "staging": str(staging),
        "quiet": quiet,
        "debug": debug,
    }
    try:
        return outcome_of(supervise("inim.jobs.worker", job, backend))
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def outcome_of(said: dict[str, Any]) -> bool:
    """Whether the worker's last words were that all is well; raises the error if they were one."""
    if "error" in said:
        raise _ERRORS.get(said["error"], InimError)(said["message"])
    return bool(said["passed"])


class Watcher:
    """Hears of a worker while it is at work; this one does not listen."""

    def started(self, process: subprocess.Popen[bytes]) -> None:
        """It has a process, which whoever waits for it may end."""

    def stage(self, name: str) -> None:
        """It begins with a stage of its job."""


def supervise(
    module: str, job: dict[str, Any], backend: Any, watcher: Watcher | None = None
) -> dict[str, Any]:
    """Run `python -m module` on a job, which it hands to `serve`; what it said last.

    Raises
    ------
    InimError
        Made from how it died, where it could not say.
    """
    read_end, write_end = os.pipe()
    process = subprocess.Popen(
        [sys.executable, "-m", module, json.dumps(job), str(write_end)],
        env={**os.environ, **backends.environment(backend)},
        stdin=subprocess.PIPE,  # nothing is sent: it closes when this process ends, however
        pass_fds=(write_end,),
    )
    os.close(write_end)
    watcher = watcher or Watcher()
    said: list[dict[str, Any]] = []
    try:
        watcher.started(process)
        with os.fdopen(read_end, encoding="utf-8") as messages:
            for line in messages:
                if line.endswith("\n"):
                    said.append(json.loads(line))
                    watcher.stage(said[-1].get("stage", ""))
        code = process.wait()
    except BaseException:  # an interrupt of the parent is one of the job
        process.terminate()
        process.wait()
        raise
    if said and ("error" in said[-1] or "passed" in said[-1]):
        outcome: dict[str, Any] = said[-1]
        return outcome
    stage = said[-1]["stage"] if said else "start"
    raise _death(code, stage, backends.memory_limit_bytes())


def _death(code: int, stage: str, memory_limit: int) -> InimError:
    """The error for a worker that ended without a word."""
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024
    if memory_limit and peak > _MEMORY_SHARE * memory_limit:
        return OutOfMemoryError(
            f"the worker was killed during '{stage}' with {peak / 2**30:.1f} GiB in use of "
            f"{memory_limit / 2**30:.1f} GiB; lower inim.eia_spp or use a display with fewer pixels"
        )
    how = signal.Signals(-code).name if code < 0 else f"exit code {code}"
    if code == -signal.SIGKILL:  # what the system does when memory is short, whoever took it
        return OutOfMemoryError(
            f"the worker was killed during '{stage}' with {peak / 2**30:.1f} GiB in use, by hand "
            "or for lack of memory; free some, or use a display with fewer pixels"
        )
    if code == -signal.SIGTERM:
        return WorkerError(f"the worker was ended from outside during '{stage}'; run it again")
    return WorkerError(
        f"the worker died during '{stage}' ({how}): a crash in native code; check the scene's "
        "meshes, and run `inim sys-info` to check the backend"
    )


def work(job: dict[str, Any], listener: Any) -> bool:
    """The worker's side: carry out the request and publish; whether every check passed."""
    from inim.jobs.output import publish
    from inim.jobs.validate import run

    request = Request.from_json(job["request"])
    report = run(make_plan(request), Path(job["staging"]), listener)
    publish(Path(job["staging"]), request.out)
    return report.passed


def answer(job: dict[str, Any], channel: Any, carry_out: CarryOut) -> None:
    """Carry out a job, saying stages and the outcome on the channel."""
    from inim.jobs.progress import ConsoleListener

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


if __name__ == "__main__":
    serve(json.loads(sys.argv[1]), int(sys.argv[2]), work)
