"""Units: the validations of a study, each in a worker process.

A unit is one scene on one display with one set of settings; its algorithms and viewpoints share
the ground truth. Its result is the text of its `report.json`, which the result cache holds under
all inputs that decide it (`Plan.cache_key`): an unchanged unit is not computed again.
"""

from __future__ import annotations

import os
import socket
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from inim.apps.sweep.study import Study
from inim.pipeline.plan import Plan, make_plan
from inim.pipeline.request import Request
from inim.pipeline.stages.scene import Renderer
from inim.system.cache import Record, Store, cache_address, input_digests, open_store
from inim.system.errors import (
    FileError,
    InimError,
    OutOfMemoryError,
    UsageError,
    ViewpointError,
    WorkerError,
)
from inim.system.process.atomic_file import file_errors
from inim.system.process.machine import THREADS_VARIABLE
from inim.system.worker.output import hidden_folder, staging_folder
from inim.system.worker.supervisor import OnStart, run_in_worker

_HASH_DIGITS = 16
_REPORTS = "reports"


@dataclass(frozen=True)
class Unit:
    """One validation of a study.

    `scene` and `display` are names in the table; `variation` contains the values of the settings
    that vary. A unit that cannot be validated has a one-line `error` and no plan.
    """

    scene: str
    display: str
    variation: str
    request: Request
    plan: Plan | None = None
    error: str = ""

    @property
    def label(self) -> str:
        """Label on the screen."""
        return " · ".join(filter(None, (self.scene, self.display, self.variation)))

    @cached_property
    def inputs(self) -> dict[str, str]:
        """Digests of all inputs that decide the result, on any machine; empty without a plan."""
        return {} if self.plan is None else input_digests(self.plan.cache_key())

    @cached_property
    def hash(self) -> str:
        """Name of the result, from its inputs: equal for units with equal results."""
        return cache_address("validation", self.inputs)[:_HASH_DIGITS] if self.inputs else ""


def expand(study: Study, out: Path, allow_folders: tuple[Path, ...] = ()) -> list[Unit]:
    """Expand a study to its units: scene by scene, display by display.

    `out` is the sweep's folder. If no unit can be validated, raises the error of the first one.
    """
    units: list[Unit] = []
    errors: list[InimError] = []
    for scene, path in study.scenes.items():
        for display in study.displays:
            for variation, definitions in study.variations.items():
                label = ", ".join(filter(None, (display.variation, variation)))
                request = Request(
                    path,
                    out,
                    definitions=definitions,
                    algorithms=study.algorithms,
                    viewpoints=study.viewpoints,
                    backend=study.backend,
                    time=study.time,
                    allow_folders=allow_folders,
                )
                unit = Unit(scene, display.name, label, request)
                try:
                    chosen, own = display.with_settings(definitions, str(study.path))
                    request = replace(request, display=chosen, definitions=own)
                    unit = replace(unit, request=request, plan=make_plan(request, of_scene=True))
                except ViewpointError as error:
                    place = "" if study.viewpoints is None else "study.viewpoints: "
                    errors.append(UsageError(f"{study.path}: {place}{error}"))
                    unit = replace(unit, error=str(errors[-1]))
                except InimError as error:
                    unit = replace(unit, error=str(error))
                    errors.append(error)
                units.append(unit)
    if len(errors) == len(units):
        raise errors[0]
    return units


@dataclass(frozen=True)
class Results:
    """Results of units in the result cache, under the backend of this machine.

    Without a `renderer`, they are those of a cluster, whose workers choose their backends. Without
    a store, none is found or kept.
    """

    renderer: Renderer | None
    store: Store | None

    @classmethod
    def of(cls, renderer: Renderer | None) -> Results:
        """Results in this user's result cache."""
        return cls(renderer, open_store())

    def find(self, unit: Unit) -> str | None:
        """The text of a unit's `report.json`; None if it is missing."""
        record = None if self.store is None else self.store.load(self._address(unit))
        return None if record is None else bytes(record.arrays[_REPORTS]).decode()

    def keep(self, unit: Unit, text: str) -> None:
        """Store the text of a unit's `report.json`."""
        if self.store is not None:
            record = Record({_REPORTS: np.frombuffer(text.encode(), np.uint8)})
            self.store.keep(self._address(unit), record)

    def _address(self, unit: Unit) -> str:
        backend = {} if self.renderer is None else self.renderer.cache_key()
        return cache_address("validation", unit.inputs | input_digests(backend))


# The memory use of other processes may kill a worker once.
_ATTEMPTS = 2


@dataclass(frozen=True)
class SweepTask:
    """Validation of a unit; sent between processes and machines.

    `hash`, `label` and `inputs` are those of the unit; the inputs of the worker's plan must be
    equal. The request's `out` is the sweep's folder, and all paths are absolute. Without `threads`,
    the worker uses all. `memory_bytes` is the planned memory of its images and the renderer.
    """

    hash: str
    label: str
    request: Request
    inputs: dict[str, str]
    keep_report: bool = False
    threads: int | None = None
    memory_bytes: int = 0
    debug: bool = False


def attempt(task: SweepTask, on_start: OnStart | None = None) -> str:
    """Run a task, again if its worker died, and return the text of its `report.json`.

    `on_start` receives the worker's process. Raises an `InimError` if the validation fails.
    """
    for _ in range(_ATTEMPTS - 1):
        try:
            return _carry_out(task, on_start)
        except (WorkerError, OutOfMemoryError):
            pass
    return _carry_out(task, on_start)


def _carry_out(task: SweepTask, on_start: OnStart | None) -> str:
    with _report_folder(task) as out:
        run_in_worker(
            f"inim.pipeline.job:{'run_job' if task.keep_report else 'run_data_job'}",
            lambda: _same_plan(task, out),
            staging_folder(out),
            about=str(task.request.out),
            # numba reads it when it is imported.
            variables={} if task.threads is None else {THREADS_VARIABLE: str(task.threads)},
            debug=task.debug,
            on_start=on_start,
        )
        return (out / "report.json").read_text("utf-8")


@contextmanager
def _report_folder(task: SweepTask) -> Iterator[Path]:
    """Yield the folder for the report: on the local disk unless the report is kept.

    All units use one local folder, so that each removes the remains of killed units.
    """
    if task.keep_report:
        out = report_folder(task.request.out, task.hash)
        if not out.parent.is_dir():
            raise FileError(
                f"{out.parent}: missing on {socket.gethostname()}; to keep reports, choose a "
                "folder with -o that all machines share"
            )
        yield out
        return
    folder = Path(tempfile.gettempdir()) / f"inim-sweep-{os.getuid()}"
    with file_errors(folder, "set TMPDIR to a folder with room"):
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    if status.st_uid != os.getuid() or stat.S_IMODE(status.st_mode) != 0o700:
        raise FileError(
            f"{folder}: belongs to another user or is open to others; set TMPDIR to a folder of "
            "your own"
        )
    with hidden_folder(folder / "unit") as hidden:
        yield hidden / "unit" / "report"  # not in the hidden folder itself, which is locked


def report_folder(out: Path, unit: str) -> Path:
    """Folder of a unit's report, if it is kept."""
    return out / _REPORTS / unit


def _same_plan(task: SweepTask, out: Path) -> Plan:
    """Plan of a task; raises `UsageError` if the scene or the code has changed since its start."""
    plan = make_plan(replace(task.request, out=out), of_scene=True)
    inputs = input_digests(plan.cache_key())
    changed = sorted(name for name, digest in task.inputs.items() if inputs.get(name) != digest)
    if changed:
        raise UsageError(
            f"{task.request.scene}: on {socket.gethostname()}, {' and '.join(changed)} "
            f"{'differs' if len(changed) == 1 else 'differ'} from what the sweep started with; run "
            "it again, with the same files and versions on all machines"
        )
    return plan
