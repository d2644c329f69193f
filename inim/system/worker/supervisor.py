"""Supervisor of workers: native code may crash, but the caller must survive.

A damaged mesh, a kernel that does not compile or lack of memory kill the process without an
exception. The heavy part therefore runs in one worker process. Its supervisor turns a crash into an
exit code and a sentence, and removes its staging folder.

A job is pickled to the worker's stdin. The worker reports through a separate pipe, with one line of
JSON per message: its stages, and finally its result. It ends when its stdin closes, and therefore
with its supervisor.
"""

import contextlib
import json
import os
import signal
import subprocess
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import IO, Any

from inim.system import errors
from inim.system.errors import InimError, OutOfMemoryError, WorkerError
from inim.system.process import machine
from inim.system.process.interrupts import cleaned_up
from inim.system.process.observer import OnStage
from inim.system.process.python_process import end_process, python_module, rendering_process
from inim.system.worker.serve import Job, write_job

OnStart = Callable[["subprocess.Popen[bytes]"], object]

# A crash with this share of the memory in use is attributed to lack of memory.
_MEMORY_SHARE = 0.8
_ERRORS = {
    cls.__name__: cls
    for cls in vars(errors).values()
    if isinstance(cls, type) and issubclass(cls, InimError)
}


def run_in_worker(
    target: str,
    make_request: Callable[[], object],
    staging: AbstractContextManager[Path],
    *,
    fill: Callable[[Path], object] | None = None,
    about: str = "",
    variables: Mapping[str, str] | None = None,
    quiet: bool = True,
    debug: bool = False,
    on_start: OnStart | None = None,
    on_stage: OnStage | None = None,
) -> bool:
    """Run a request in a worker process; True if every check passed.

    `target` is the function that runs the request, ``module:function``; see
    `inim.system.worker.serve.RunJob`. The worker runs in an empty folder, and all paths in its
    request are absolute. `make_request` returns the request, which must be picklable, or raises an
    error; it is called while the worker loads. `staging` yields the folder for the result, such as
    `inim.system.worker.output.staging_folder`, and `fill` writes the worker's input files into it.
    `about` is a label for `ps`; `variables` are additional environment variables. `quiet`
    suppresses result lines and the progress bar, `debug` lets the worker print the traceback of an
    internal error, `on_start` receives the process, which it may end, and `on_stage` the progress.

    Raises the `InimError` of `make_request` or of the worker, and `WorkerError` or
    `OutOfMemoryError` if the worker died.
    """
    with contextlib.ExitStack() as stack:
        process, messages = stack.enter_context(_worker(target, variables or {}, about))
        request = make_request()
        folder = stack.enter_context(staging)
        # Before the folder to which it writes is removed.
        stack.enter_context(cleaned_up(partial(end_process, process)))
        if fill is not None:
            fill(folder)
        if on_start is not None:
            on_start(process)
        job = Job(request, folder, quiet, debug)
        return outcome_of(_carry_out(process, messages, job, on_stage))


def outcome_of(message: dict[str, Any]) -> bool:
    """Return whether the worker reports success; raise the error that it reports."""
    if "error" in message:
        raise _ERRORS.get(message["error"], InimError)(message["message"])
    return bool(message["passed"])


@contextmanager
def _worker(
    target: str, variables: Mapping[str, str], about: str
) -> Iterator[tuple[subprocess.Popen[bytes], IO[str]]]:
    """Start a worker; yield the process and its stream of messages."""
    read_end, write_end = os.pipe()
    with os.fdopen(read_end, encoding="utf-8") as messages, os.fdopen(write_end, "w") as channel:
        command = python_module("inim.system.worker", target, str(write_end), about)
        with rendering_process(
            command, variables, stdin=subprocess.PIPE, pass_fds=(write_end,)
        ) as process:
            channel.close()  # the worker's end is the only one left
            yield process, messages


def _stdin(process: subprocess.Popen[bytes]) -> IO[bytes]:
    assert process.stdin is not None
    return process.stdin


def _carry_out(
    process: subprocess.Popen[bytes], messages: IO[str], job: Job, on_stage: OnStage | None
) -> dict[str, Any]:
    """Send a worker its job and wait for its last message; raises an `InimError` if it crashed."""
    message: dict[str, Any] = {"stage": "start"}
    with contextlib.suppress(OSError):  # it has already ended
        write_job(job, _stdin(process))
        _stdin(process).flush()
    for line in messages:
        if line.endswith("\n"):
            message = json.loads(line)
            if on_stage is not None and "stage" in message:
                on_stage(message["stage"], message["share"])
    code = process.wait()
    if "stage" in message:
        raise _death(code, message["stage"], machine.memory_limit_bytes())
    return message


def _death(code: int, stage: str, memory_limit: int) -> InimError:
    """Error for a worker that ended without a result."""
    peak = machine.peak_bytes(of_children=True)
    if memory_limit and peak > _MEMORY_SHARE * memory_limit:
        return OutOfMemoryError(
            f"the worker was killed during '{stage}' with {peak / 2**30:.1f} GiB in use of "
            f"{memory_limit / 2**30:.1f} GiB; lower inim.eia_spp or use a display with fewer pixels"
        )
    cause = signal.Signals(-code).name if code < 0 else f"exit code {code}"
    if code == -signal.SIGKILL:  # sent by the system when memory is short
        return OutOfMemoryError(
            f"the worker was killed during '{stage}' with {peak / 2**30:.1f} GiB in use, by hand "
            "or for lack of memory; free some, or use a display with fewer pixels"
        )
    if code == -signal.SIGTERM:
        return WorkerError(
            f"the worker was terminated by another process during '{stage}'; run it again"
        )
    return WorkerError(
        f"the worker died during '{stage}' ({cause}): a crash in native code; check the scene's "
        "meshes, and run `inim info system` to check the backend"
    )
