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
from inim.pipeline.baseline import FOLDER as STATISTICS
from inim.pipeline.plan import LEAST_BYTES, Plan, make_plan
from inim.pipeline.request import Request
from inim.process.interrupts import delayed_interrupts
from inim.process.observer import Observer
from inim.regression.run_statistics import CANDIDATE, read_statistics
from inim.report import Report
from inim.sweep.table import unit_document
from inim.sweep.unit import Unit, key_of, making_of
from inim.worker.output import publish, staging_folder
from inim.worker.supervisor import OnStart, run_in_worker

FOLDER = "units"


@dataclass(frozen=True)
class Results:
    """The results in the folder of a sweep; on a cluster, all machines share this folder."""

    out: Path

    def path(self, unit: str, algorithm: str) -> Path:
        """Path of a result."""
        return self.out / FOLDER / unit / f"{algorithm}.json"

    def read(self, unit: str, algorithm: str, making: Mapping[str, Any]) -> UnitDocument | None:
        """Read a result; None if it is missing or has other inputs."""
        try:
            document = read_document(self.path(unit, algorithm), "", UnitDocument)
        except FileError:
            return None
        own = (document.unit, document.algorithm, document.making)
        return document if own == (unit, algorithm, making) else None

    def write(self, document: UnitDocument) -> None:
        """Write a result atomically; raises `FileError` if the folder cannot be written."""
        path = self.path(document.unit, document.algorithm)
        # Process numbers are not unique in a folder that several machines share.
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
# With one thread the renderer's file readers hang; see `inim.render.variant`.
_FEWEST_RENDER_THREADS = 2
# The memory use of other processes may kill a worker once.
_ATTEMPTS = 2


@dataclass(frozen=True)
class SweepTask:
    """Remaining work of a unit; sent between processes and machines.

    `unit` is the hash of the unit, `label` its label on the screen, and `key` its key, which the
    worker's key must equal. The request is for the remaining algorithms; its `out` is the sweep's
    folder, and all paths are absolute. Without `threads`, the worker uses all. `memory_bytes` is
    the planned memory of its images and the renderer.
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
    """Create the task of computing some algorithms of a unit."""
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
    """Run a task, again if its worker died; return the error, or None if its results exist.

    `on_start` receives the worker's process.
    """
    error: InimError | None = None
    for _ in range(_ATTEMPTS):
        try:
            _carry_out(task, on_start)
        except (WorkerError, OutOfMemoryError) as death:
            error = death
        except InimError as task_error:
            return task_error
        else:
            return None
    return error


def _carry_out(task: SweepTask, on_start: OnStart | None) -> None:
    if not (task.request.out / FOLDER).is_dir():
        raise FileError(
            f"{task.request.out}: missing on {socket.gethostname()}; choose a folder with -o that "
            "all machines share"
        )
    run_in_worker(
        "inim.sweep.task:run_job",
        lambda: task,
        _staging(task),
        backend=task.request.backend,
        about=str(task.request.out),
        # numba reads it when it is imported.
        variables={} if task.threads is None else {"NUMBA_NUM_THREADS": str(task.threads)},
        debug=task.debug,
        on_start=on_start,
    )


def _staging(task: SweepTask) -> AbstractContextManager[Path]:
    """Temporary folder for the report: on the local disk unless the report is kept.

    All units use one folder, so that each removes the remains of killed units.
    """
    if task.keep_report:
        return staging_folder(report_folder(task.request.out, task.unit))
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


def report_folder(out: Path, unit: str) -> Path:
    """Folder of a unit's report, if it is kept."""
    return out / _REPORTS / unit


def run_job(task: SweepTask, staging: Path, observer: Observer) -> bool:
    """Entry point in the worker: validate, and write the results into the sweep's folder."""
    plan = make_plan(task.request)
    _check_same(task, plan)
    report = _validate(task, plan, staging, observer)
    times = read_statistics(staging / STATISTICS, CANDIDATE).times
    results = Results(task.request.out)
    with delayed_interrupts():
        if task.keep_report:  # before the results, which mark the unit as finished
            publish(staging, report_folder(task.request.out, task.unit))
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
    """Raise `UsageError` if the scene or the code differs from that of the sweep's start."""
    key = key_of(plan)
    changed = [name for name in task.key if key.get(name) != task.key[name]]
    if changed:
        raise UsageError(
            f"{task.request.scene}: on {socket.gethostname()}, {' and '.join(changed)} "
            f"{'differs' if len(changed) == 1 else 'differ'} from what the sweep started with; run "
            "it again, with the same files and versions on all machines"
        )


def _validate(task: SweepTask, plan: Plan, staging: Path, observer: Observer) -> Report:
    from inim.pipeline.job import run
    from inim.render import variant

    variant.use(task.request.backend)
    if task.threads is None:
        return run(plan, staging, observer)
    from inim.render.reference_kernel import drjit_threads

    with drjit_threads(max(_FEWEST_RENDER_THREADS, task.threads)):
        return run(plan, staging, observer)
