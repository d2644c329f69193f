"""Tasks: the remaining work of a unit, and the location of its results.

Results are stored as ``OUT/units/HASH/ALGORITHM.json``: one small file for each algorithm of each
unit, written atomically. The table is derived from these files alone. A killed process therefore
loses only its current work, and repeated work writes the same file.
"""

from __future__ import annotations

import os
import socket
import stat
import tempfile
import uuid
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from inim.documents import read_document
from inim.documents.document import encode
from inim.documents.unit import UnitDocument
from inim.errors import FileError, InimError, OutOfMemoryError, UsageError, WorkerError
from inim.pipeline.plan import LEAST_BYTES, Plan, make_plan
from inim.pipeline.request import Request
from inim.process.interrupts import delayed_interrupts
from inim.process.observer import Observer
from inim.report import Report
from inim.sweep.table import unit_document
from inim.sweep.unit import Unit, key_of, making_of
from inim.worker.output import publish, staging_folder
from inim.worker.supervisor import OnStart, run_in_worker

FOLDER = "units"


@dataclass(frozen=True)
class Results:
    """The results in the folder of a sweep.

    Attributes
    ----------
    out : Path
        Of the sweep; on a cluster, a folder that all its machines share.
    """

    out: Path

    def path(self, unit: str, algorithm: str) -> Path:
        """Path of a result."""
        return self.out / FOLDER / unit / f"{algorithm}.json"

    def read(self, unit: str, algorithm: str, making: Mapping[str, Any]) -> UnitDocument | None:
        """A result; None if none of this making can be read."""
        try:
            document = read_document(self.path(unit, algorithm), "", UnitDocument)
        except FileError:
            return None
        own = (document.unit, document.algorithm, document.making)
        return document if own == (unit, algorithm, making) else None

    def write(self, document: UnitDocument) -> None:
        """Put a result there, whole: a reader sees it or does not.

        Raises
        ------
        FileError
            The folder cannot be written.
        """
        path = self.path(document.unit, document.algorithm)
        # A process's number is its own on one machine only, and the folder may be shared.
        temporary = path.with_name(f".{uuid.uuid4().hex}.tmp")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with temporary.open("w", encoding="utf-8") as file:
                file.write(encode(document))
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
        except OSError as error:
            raise FileError(
                f"{path}: cannot be written ({error.strerror}); free some space or choose another "
                "folder with -o"
            ) from None
        finally:
            temporary.unlink(missing_ok=True)


_REPORTS = "reports"
# With one thread the renderer's own file readers hang; see `inim.render.variant`.
_FEWEST_RENDER_THREADS = 2
# A worker that died may have been killed for what others did; twice is its own doing.
_ATTEMPTS = 2


@dataclass(frozen=True)
class SweepTask:
    """Remaining work of a unit; sent between processes and machines.

    Attributes
    ----------
    unit : str
        The unit's hash.
    label : str
        Label on the screen.
    request : Request
        Request for the remaining algorithms. Its `out` is the sweep's folder, and all paths are
        absolute.
    key : dict
        The unit's key; the worker's key must be equal.
    threads : int, optional
        None uses all threads.
    memory_bytes : int
        Planned memory of its images and the renderer.
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


def make_task(
    unit: Unit, algorithms: Sequence[str], *, keep_report: bool, threads: int | None
) -> SweepTask:
    """The task of computing some algorithms of a unit."""
    assert unit.plan is not None
    return SweepTask(
        unit.hash,
        unit.label,
        unit.only(algorithms),
        key_of(unit.plan),
        tuple(algorithms),
        keep_report,
        threads,
        LEAST_BYTES + unit.plan.images_bytes,
    )


def attempt(task: SweepTask, on_start: OnStart | None = None) -> InimError | None:
    """Carry out a task; the error that ended it, or None once its results are there.

    Parameters
    ----------
    on_start : callable, optional
        See `inim.worker.supervisor.run_in_worker`.
    """
    error: InimError | None = None
    for _ in range(_ATTEMPTS):
        try:
            _carry_out(task, on_start)
        except (WorkerError, OutOfMemoryError) as death:
            error = death
        except InimError as its_own:
            return its_own
        else:
            return None
    return error


def _carry_out(task: SweepTask, on_start: OnStart | None) -> None:
    if not (task.request.out / FOLDER).is_dir():
        raise FileError(
            f"{task.request.out}: is not there on {socket.gethostname()}; choose a folder with -o "
            "that all machines share"
        )
    run_in_worker(
        "inim.sweep.task:run_job",
        lambda: task,
        _staging(task),
        backend=task.request.backend,
        about=str(task.request.out),
        variables=_threads(task.threads),
        debug=task.debug,
        on_start=on_start,
    )


def _threads(count: int | None) -> dict[str, str]:
    """Environment variables that numba reads when it is imported."""
    return {} if count is None else {"NUMBA_NUM_THREADS": str(count)}


def _staging(task: SweepTask) -> AbstractContextManager[Path]:
    """Temporary folder for the report: next to its final place if it is kept, otherwise on the
    local disk.

    A report has some megabytes of images, thousands of times more than its rows, which would burden
    a shared disk. All units use one folder, so that each removes the remains of killed units.
    """
    if task.keep_report:
        return staging_folder(_report_folder(task))
    folder = Path(tempfile.gettempdir()) / f"inim-sweep-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    except OSError as error:
        raise FileError(
            f"{folder}: cannot be written ({error.strerror}); set TMPDIR to a folder with room"
        ) from None
    if status.st_uid != os.getuid() or stat.S_IMODE(status.st_mode) != 0o700:
        raise FileError(
            f"{folder}: belongs to another user or is open to others; set TMPDIR to a folder of "
            "your own"
        )
    return staging_folder(folder / "unit")


def _report_folder(task: SweepTask) -> Path:
    return report_folder(task.request.out, task.unit)


def report_folder(out: Path, unit: str) -> Path:
    """Folder of a unit's report, if it is kept."""
    return out / _REPORTS / unit


def run_job(task: SweepTask, staging: Path, observer: Observer) -> bool:
    """The worker's side: validate, and put the results where the sweep looks for them."""
    plan = make_plan(task.request)
    _check_same(task, plan)
    report = _validated(task, plan, staging, observer)
    times = _times(staging)
    results = Results(task.request.out)
    with delayed_interrupts():
        if task.keep_report:  # before the results: they say that nothing is left to do
            publish(staging, _report_folder(task))
        for name in task.algorithms:
            results.write(
                unit_document(
                    report.data,
                    times,
                    unit=task.unit,
                    algorithm=name,
                    making=making_of(plan, name),
                    key=task.key,
                )
            )
    return True


def _check_same(task: SweepTask, plan: Plan) -> None:
    """Raise unless the worker's key equals the unit's: the scene or the code differs otherwise."""
    key = key_of(plan)
    changed = [name for name in task.key if key.get(name) != task.key[name]]
    if changed:
        raise UsageError(
            f"{task.request.scene}: on {socket.gethostname()}, {' and '.join(changed)} "
            f"{'differs' if len(changed) == 1 else 'differ'} from what the sweep started with; run "
            "it again, with the same files and versions on all machines"
        )


def _validated(task: SweepTask, plan: Plan, staging: Path, observer: Observer) -> Report:
    from inim.pipeline.job import run
    from inim.render import variant

    variant.use(task.request.backend)
    if task.threads is None:
        return run(plan, staging, observer)
    from inim.render.reference_kernel import drjit_threads

    with drjit_threads(max(_FEWEST_RENDER_THREADS, task.threads)):
        return run(plan, staging, observer)


def _times(staging: Path) -> Mapping[str, Sequence[float]]:
    from inim.pipeline.output.baseline import FOLDER as STATISTICS
    from inim.regression import CANDIDATE, read_statistics

    return read_statistics(staging / STATISTICS, CANDIDATE).times
