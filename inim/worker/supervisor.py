"""One supervised worker per job: native code can die, the job's owner must not.

A damaged mesh, a kernel that will not compile or memory running out kill the process without an
exception. So the heavy part runs in one worker process, and its supervisor turns any death into an
exit code and a sentence, and clears away what was half written.

A job goes to the worker's stdin as one line of JSON; what it says goes through a pipe of its own, a
line each: its stages, and at last its outcome. It ends when its stdin does: with its supervisor.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Mapping
from typing import Any

from inim import backend as backends
from inim import errors
from inim.errors import InimError, OutOfMemoryError, WorkerError
from inim.pipeline.request import Request
from inim.worker.output import open_staging

__all__ = ["Watcher", "Worker", "outcome_of", "run_in_worker", "supervise"]

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
    # It loads while the plan is made here, too: most mistakes are found before it has a job.
    with Worker("inim.pipeline.work:work", about=str(request.scene)) as worker:
        from inim.pipeline.plan import make_plan

        make_plan(request)
        backend = backends.choose_backend(request.backend)
        staging = open_staging(request.out)
        job = {
            "request": request.as_json(),
            "variables": backends.environment(backend),
            "staging": str(staging),
            "quiet": quiet,
            "debug": debug,
        }
        try:
            return outcome_of(worker.carry_out(job))
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


class Worker:
    """A worker process, which loads what it needs from its start on.

    Parameters
    ----------
    target : str
        What carries out its job, as ``module:function``; see `inim.worker.serve`.
    variables : mapping, optional
        Of its environment, beside this process's own.
    about : str
        What `ps` shows of its job.
    """

    def __init__(
        self, target: str, variables: Mapping[str, str] | None = None, about: str = ""
    ) -> None:
        read_end, write_end = os.pipe()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "inim.worker", target, str(write_end), about],
            env={**os.environ, **(variables or {})},
            stdin=subprocess.PIPE,
            pass_fds=(write_end,),
        )
        os.close(write_end)
        self._messages = os.fdopen(read_end, encoding="utf-8")

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()
        with contextlib.suppress(OSError):  # of a job that was never read
            self._stdin.close()
        self._messages.close()

    def _end(self) -> None:
        if self._process.poll() is None:
            self._process.terminate()
        self._process.wait()

    @property
    def _stdin(self) -> Any:
        assert self._process.stdin is not None
        return self._process.stdin

    def carry_out(self, job: dict[str, Any], watcher: Watcher | None = None) -> dict[str, Any]:
        """Have it carry out the one job of its life; what it said last.

        Raises
        ------
        InimError
            Made from how it died, where it could not say.
        """
        watcher = watcher or Watcher()
        said: list[dict[str, Any]] = []
        try:
            watcher.started(self._process)
            with contextlib.suppress(OSError):  # it has died already
                self._stdin.write(json.dumps(job).encode() + b"\n")
                self._stdin.flush()
            for line in self._messages:
                if line.endswith("\n"):
                    said.append(json.loads(line))
                    watcher.stage(said[-1].get("stage", ""))
            code = self._process.wait()
        except BaseException:  # an interrupt here is one of the job, and what it wrote can go
            self._end()
            raise
        if said and ("error" in said[-1] or "passed" in said[-1]):
            outcome: dict[str, Any] = said[-1]
            return outcome
        stage = said[-1]["stage"] if said else "start"
        raise _death(code, stage, backends.memory_limit_bytes())


def supervise(
    target: str,
    job: dict[str, Any],
    backend: Any,
    watcher: Watcher | None = None,
    about: str = "",
    variables: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Have a new worker carry out a job with a backend; see `Worker`."""
    told = {**backends.environment(backend), **(variables or {})}
    with Worker(target, told, about) as worker:
        return worker.carry_out(job, watcher)


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
