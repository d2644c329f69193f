"""A task: the algorithms of one unit that are not there yet, carried out by a supervised worker.

Whoever hands out tasks, a pool or a cluster, gets back nothing but an error: what was found lies in
the sweep's folder by then, put there by the worker itself.
"""

from __future__ import annotations

import os
import shutil
import socket
import stat
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from inim import backend as backends
from inim.errors import FileError, InimError, OutOfMemoryError, UsageError, WorkerError
from inim.pipeline.memory import LEAST_BYTES
from inim.pipeline.plan import Plan, make_plan
from inim.pipeline.request import Request
from inim.sweep.results import FOLDER, Results
from inim.sweep.rows import result_of
from inim.sweep.unit import Unit, key_of, making_of
from inim.worker.output import open_staging, publish
from inim.worker.supervisor import Watcher, outcome_of, supervise

__all__ = ["Task", "attempt", "make_task", "report_folder", "work"]

_REPORTS = "reports"
# With one thread the renderer's own file readers hang; see `inim.render.variant`.
_FEWEST_RENDER_THREADS = 2
# A worker that died may have been killed for what others did; twice is its own doing.
_ATTEMPTS = 2


@dataclass(frozen=True)
class Task:
    """What is left to do of a unit; travels between processes and machines.

    Attributes
    ----------
    unit : str
        The unit's hash.
    label : str
        What it is called on a screen.
    request : Request
        For the algorithms that are left. Its `out` is the sweep's folder, and all paths are
        absolute.
    key : dict
        The unit's key, which the worker must find, too.
    algorithms : tuple of str
    keep_report : bool
    threads : int, optional
        All there are if None.
    memory_bytes : int
        What its pictures and the renderer take, by plan.
    debug : bool
        Let the worker print the traceback of an internal error.
    """

    unit: str
    label: str
    request: Request
    key: dict[str, Any]
    algorithms: tuple[str, ...]
    keep_report: bool = False
    threads: int | None = None
    memory_bytes: int = 0
    debug: bool = False

    def as_json(self) -> dict[str, Any]:
        """For the worker; `from_json` reads it."""
        return {**asdict(self), "request": self.request.as_json()}

    @classmethod
    def from_json(cls, raw: Mapping[str, Any]) -> Task:
        """The task that `as_json` wrote."""
        request = Request.from_json(raw["request"])
        return cls(**{**raw, "request": request, "algorithms": tuple(raw["algorithms"])})


def make_task(
    unit: Unit, algorithms: Sequence[str], *, keep_report: bool, threads: int | None
) -> Task:
    """The task of computing some algorithms of a unit."""
    assert unit.plan is not None
    return Task(
        unit.hash,
        unit.label,
        unit.only(algorithms),
        key_of(unit.plan),
        tuple(algorithms),
        keep_report,
        threads,
        LEAST_BYTES + unit.plan.pictures_bytes,
    )


def attempt(task: Task, watcher: Watcher | None = None) -> InimError | None:
    """Carry out a task; the error that ended it, or None once its results are there."""
    error: InimError | None = None
    for _ in range(_ATTEMPTS):
        try:
            _carry_out(task, watcher)
        except (WorkerError, OutOfMemoryError) as death:
            error = death
        except InimError as its_own:
            return its_own
        else:
            return None
    return error


def _carry_out(task: Task, watcher: Watcher | None) -> None:
    if not (task.request.out / FOLDER).is_dir():
        raise FileError(
            f"{task.request.out}: is not there on {socket.gethostname()}; choose a folder with -o "
            "that all machines share"
        )
    backend = backends.choose_backend(task.request.backend)
    staging = _open_staging(task)
    job = {"task": task.as_json(), "staging": str(staging), "quiet": True, "debug": task.debug}
    try:
        about = str(task.request.out)
        outcome_of(
            supervise("inim.sweep.task:work", job, backend, watcher, about, _threads(task.threads))
        )
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _threads(count: int | None) -> dict[str, str]:
    """What numba reads when it is imported."""
    return {} if count is None else {"NUMBA_NUM_THREADS": str(count)}


def _open_staging(task: Task) -> Path:
    """Where the report is built: beside its place if it is kept, else on this machine's own disk.

    A report is some megabytes of pictures, thousands of times its rows: no load for a shared one.
    One folder for all units, so that each clears away what killed ones left of any.
    """
    if task.keep_report:
        return open_staging(_report_folder(task))
    folder = Path(tempfile.gettempdir()) / f"inim-sweep-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError as error:
        raise FileError(
            f"{folder}: cannot be written ({error.strerror}); set TMPDIR to a folder with room"
        ) from None
    if found.st_uid != os.getuid() or stat.S_IMODE(found.st_mode) != 0o700:
        raise FileError(
            f"{folder}: belongs to another user or is open to others; set TMPDIR to a folder of "
            "your own"
        )
    return open_staging(folder / "unit")


def _report_folder(task: Task) -> Path:
    return report_folder(task.request.out, task.unit)


def report_folder(out: Path, unit: str) -> Path:
    """Where the report of a unit stays, if it is kept."""
    return out / _REPORTS / unit


def work(job: dict[str, Any], listener: Any) -> bool:
    """The worker's side: validate, and put the results where the sweep looks for them."""
    task, staging = Task.from_json(job["task"]), Path(job["staging"])
    plan = make_plan(task.request)
    _check_same(task, plan)
    report = _validated(task, plan, staging, listener)
    times = _times(staging)
    if task.keep_report:  # before the results: they say that nothing is left to do
        publish(staging, _report_folder(task))
    results = Results(task.request.out)
    for name in task.algorithms:
        content = {"making": making_of(plan, name), "key": task.key}
        results.write(task.unit, name, content | result_of(report.data, times, name))
    return True


def _check_same(task: Task, plan: Plan) -> None:
    """A scene edited meanwhile, or another machine's code, would pass for what was asked for."""
    found = key_of(plan)
    changed = [name for name in task.key if found.get(name) != task.key[name]]
    if changed:
        raise UsageError(
            f"{task.request.scene}: on {socket.gethostname()}, {' and '.join(changed)} "
            f"{'differs' if len(changed) == 1 else 'differ'} from what the sweep started with; run "
            "it again, with the same files and versions on all machines"
        )


def _validated(task: Task, plan: Plan, staging: Path, listener: Any) -> Any:
    from inim.pipeline.work import run
    from inim.render import variant

    variant.use(task.request.backend)
    if task.threads is None:
        return run(plan, staging, listener)
    from inim.render.reference_kernel import drjit_threads

    with drjit_threads(max(_FEWEST_RENDER_THREADS, task.threads)):
        return run(plan, staging, listener)


def _times(staging: Path) -> Mapping[str, Sequence[float]]:
    from inim.pipeline.baseline import FOLDER as STATISTICS
    from inim.regression import CANDIDATE, read_statistics

    return read_statistics(staging / STATISTICS, CANDIDATE).times
