"""One supervised worker per job: native code can die, the job's owner must not.

A damaged mesh, a kernel that will not compile or memory running out kill the process without an
exception. So the heavy part runs in one worker process, and its supervisor turns any death into an
exit code and a sentence, and clears away what was half written.

A job goes to the worker's stdin, pickled; what the worker says goes through a pipe of its own, a
line of JSON each: its stages, and at last its outcome. It ends when its stdin does: with its
supervisor.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from inim import backend as backends
from inim import errors
from inim.cache.folder import clear_partials
from inim.errors import InimError, OutOfMemoryError, WorkerError
from inim.process import interruption
from inim.process.python_process import child_environment, end_process, python_module, started
from inim.worker.output import remove_folder
from inim.worker.serve import Job

OnStart = Callable[["subprocess.Popen[bytes]"], object]
OnStage = Callable[[str], object]

# A worker that died while holding this share of the memory died of it.
_MEMORY_SHARE = 0.8
_ERRORS = {
    cls.__name__: cls
    for cls in vars(errors).values()
    if isinstance(cls, type) and issubclass(cls, InimError)
}


def run_in_worker(
    target: str,
    request: object,
    open_folder: Callable[[], Path],
    *,
    check: Callable[[], object] | None = None,
    fill: Callable[[Path], object] | None = None,
    backend: str = "auto",
    about: str = "",
    variables: Mapping[str, str] | None = None,
    quiet: bool = True,
    debug: bool = False,
    on_start: OnStart | None = None,
    on_stage: OnStage | None = None,
) -> bool:
    """Carry out a request in a worker process.

    Parameters
    ----------
    target : str
        What carries it out, as ``module:function``; see `inim.worker.serve.Work`.
    request : object
        Anything that can be pickled.
    open_folder : callable
        Opens the folder to build the result in, such as `inim.worker.output.open_staging`; it is
        removed afterwards, whatever happens.
    check : callable, optional
        Raises what is wrong with the request; called while the worker loads.
    fill : callable, optional
        Puts into the folder what the worker reads there.
    backend : {"auto", "llvm", "cuda"}
    about : str
        What `ps` shows of the job.
    variables : mapping, optional
        Of the worker's environment from its start on, beside this process's own.
    quiet : bool
        No result lines on stdout and no progress bar on stderr.
    debug : bool
        Let the worker print the traceback of an internal error.
    on_start : callable, optional
        Is given the process, which it may end.
    on_stage : callable, optional
        Is given the name of each stage that the job comes to.

    Returns
    -------
    bool
        Whether every check passed.

    Raises
    ------
    InimError
        What `check` or the worker raised, or `WorkerError` / `OutOfMemoryError` where the worker
        could not say.
    """
    with _Worker(target, variables or {}, about) as worker:
        if check is not None:
            check()
        chosen = backends.environment(backends.choose_backend(backend))

        def remove(staging: Path) -> None:
            worker.end()  # before what it writes goes
            remove_folder(staging)

        with interruption.undone_afterwards(open_folder, remove) as staging:
            if fill is not None:
                fill(staging)
            if on_start is not None:
                on_start(worker.process)
            job = Job(request, staging, chosen, quiet, debug)
            return outcome_of(worker.carry_out(job, on_stage))


def outcome_of(said: dict[str, Any]) -> bool:
    """Whether the worker's last words were that all is well; raises the error if they were one."""
    if "error" in said:
        raise _ERRORS.get(said["error"], InimError)(said["message"])
    return bool(said["passed"])


class _Worker:
    """A worker process, which loads what it needs from its start on."""

    def __init__(self, target: str, variables: Mapping[str, str], about: str) -> None:
        read_end, write_end = os.pipe()
        self._messages = os.fdopen(read_end, encoding="utf-8")
        self._started = started(
            python_module("inim.worker", target, str(write_end), about),
            env={**child_environment(), **variables},
            stdin=subprocess.PIPE,
            pass_fds=(write_end,),
        )
        self.process = self._started.__enter__()
        os.close(write_end)

    def __enter__(self) -> _Worker:
        return self

    def __exit__(self, *error: Any) -> None:
        self._started.__exit__(*error)
        with contextlib.suppress(OSError):  # of a job that was never read
            self._stdin.close()
        self._messages.close()

    def end(self) -> None:
        """End the process where it still runs, and clear away what it was just keeping."""
        end_process(self.process)
        code = self.process.returncode
        if code is None or code >= 0:  # it ended by itself, perhaps with a result
            interruption.written()
        else:
            clear_partials(self.process.pid)

    @property
    def _stdin(self) -> Any:
        assert self.process.stdin is not None
        return self.process.stdin

    def carry_out(self, job: Job, on_stage: OnStage | None) -> dict[str, Any]:
        """Have it carry out the one job of its life; what it said last.

        Raises
        ------
        InimError
            Made from how it died, where it could not say.
        """
        said: list[dict[str, Any]] = []
        with contextlib.suppress(OSError):  # it has died already
            self._stdin.write(job.packed())
            self._stdin.flush()
        for line in self._messages:
            if line.endswith("\n"):
                said.append(json.loads(line))
                if on_stage is not None and "stage" in said[-1]:
                    on_stage(said[-1]["stage"])
        code = self.process.wait()
        if said and ("error" in said[-1] or "passed" in said[-1]):
            outcome: dict[str, Any] = said[-1]
            return outcome
        stage = said[-1]["stage"] if said else "start"
        raise _death(code, stage, backends.memory_limit_bytes())


def _death(code: int, stage: str, memory_limit: int) -> InimError:
    """The error for a worker that ended without a word."""
    peak = backends.peak_bytes(of_children=True)
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
