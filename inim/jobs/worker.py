"""One supervised worker per job: native code can die, the job's owner must not.

A damaged mesh, a kernel that will not compile or memory running out kill the process without an
exception. So the heavy part runs in one spawned worker, and the parent turns any death into an
exit code and a sentence, and clears away what was half written.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from inim import backend as backends
from inim import errors
from inim.errors import InimError, OutOfMemoryError, WorkerError
from inim.jobs.output import open_staging
from inim.jobs.plan import Request, make_plan

__all__ = ["run_in_worker", "work"]

# A worker that was killed while holding this share of the memory was killed for it.
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
    try:
        outcome = _spawn(request, staging, backend, quiet=quiet, debug=debug)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    if "error" in outcome:
        raise _ERRORS.get(outcome["error"], InimError)(outcome["message"])
    return bool(outcome["passed"])


def _spawn(
    request: Request, staging: Path, backend: Any, *, quiet: bool, debug: bool
) -> dict[str, Any]:
    """Run the worker to its end; what it said last, or an error made from how it died."""
    job = {
        "request": {k: str(v) if isinstance(v, Path) else v for k, v in asdict(request).items()},
        "staging": str(staging),
        "quiet": quiet,
        "debug": debug,
    }
    read_end, write_end = os.pipe()
    process = subprocess.Popen(
        [sys.executable, "-m", "inim.jobs.worker", json.dumps(job), str(write_end)],
        env={**os.environ, **backends.environment(backend)},
        stdin=subprocess.DEVNULL,
        pass_fds=(write_end,),
    )
    os.close(write_end)
    try:
        with os.fdopen(read_end, encoding="utf-8") as messages:
            said = [json.loads(line) for line in messages if line.endswith("\n")]
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
    if code == -signal.SIGKILL or (memory_limit and peak > _MEMORY_SHARE * memory_limit):
        return OutOfMemoryError(
            f"the worker was killed during '{stage}' with {peak / 2**30:.1f} GiB in use of "
            f"{memory_limit / 2**30:.1f} GiB; lower inim.eia_spp or use a display with fewer pixels"
        )
    how = signal.Signals(-code).name if code < 0 else f"exit code {code}"
    return WorkerError(
        f"the worker died during '{stage}' ({how}): a crash in native code; check the scene's "
        "meshes, and run `inim sys-info` to check the backend"
    )


def work(job: dict[str, Any], channel: Any) -> None:
    """The worker's side: carry out the request, saying stages and the outcome on the channel."""
    from inim.jobs.output import publish
    from inim.jobs.progress import ConsoleListener
    from inim.jobs.validate import run

    def say(message: dict[str, Any]) -> None:
        channel.write(json.dumps(message) + "\n")
        channel.flush()

    raw = job["request"]
    request = Request(
        **{
            **raw,
            "scene": Path(raw["scene"]),
            "out": Path(raw["out"]),
            "definitions": tuple(raw["definitions"]),
        }
    )
    try:
        with ConsoleListener(job["quiet"], lambda stage: say({"stage": stage})) as listener:
            report = run(make_plan(request), Path(job["staging"]), listener)
        publish(Path(job["staging"]), request.out)
        say({"passed": report.passed})
    except InimError as error:
        say({"error": type(error).__name__, "message": str(error)})
    except MemoryError:
        say({"error": "OutOfMemoryError", "message": "out of memory; use fewer pixels or samples"})
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


if __name__ == "__main__":
    with os.fdopen(int(sys.argv[2]), "w", encoding="utf-8") as outcome_channel:
        work(json.loads(sys.argv[1]), outcome_channel)
