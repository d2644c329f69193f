"""Units: the validations of a study, with their keys, results and tasks.

A unit is one scene on one display with one set of settings; its algorithms and viewpoints share
the ground truth. Its key contains all inputs of the scores, and no path, name or time: equal keys
give equal results on every machine.

Results are stored as ``OUT/units/HASH/ALGORITHM.json``: one small file for each algorithm of each
unit, written atomically. The table is derived from these files alone. A killed process therefore
loses only its current task, and a repeated task writes the same file.
"""

from __future__ import annotations

import hashlib
import json
import os
import socket
import stat
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import inim
from inim.apps.sweep.document import UnitDocument
from inim.apps.sweep.study import Study
from inim.apps.sweep.table import unit_document
from inim.display import Display
from inim.display.lens import foreign_identity
from inim.display.settings import PREFIX
from inim.generators import SCENE_ALGORITHMS, is_own, parse_algorithm
from inim.pipeline.plan import Plan, make_plan
from inim.pipeline.request import Request
from inim.report import Report
from inim.scores.metrics import foreign_identities
from inim.system.cache import versions
from inim.system.document import encode, read_document
from inim.system.errors import (
    FileError,
    InimError,
    OutOfMemoryError,
    UsageError,
    ViewpointError,
    WorkerError,
)
from inim.system.plugins import identity
from inim.system.process.atomic_file import file_errors, write_atomically
from inim.system.process.interrupts import delayed_interrupts
from inim.system.process.observer import Observer
from inim.system.version import __version__
from inim.system.worker.output import hidden_folder, staging_folder
from inim.system.worker.supervisor import OnStart, run_in_worker

# Settings that do not affect a score, or are in the key under another name.
_NOT_DECIDING = ("title", "algorithms", "viewpoints", "min_ssim_to_reference")
# Code that does not affect scores.
_NOT_SCORING = (
    "cli.py",
    "commands/",
    "report/",
    "bench/",
    "stress/",
    "documents/",
    "views/",
)
_HASH_DIGITS = 16


@dataclass(frozen=True)
class Unit:
    """One validation of a study.

    `scene` and `display` are names in the table; `variation` contains the values of the settings
    that vary. The request has all algorithms of the study; its `out` is unused. A unit that cannot
    be validated has a one-line `error`, no plan, and an empty `hash` of its key.
    """

    scene: str
    display: str
    variation: str
    request: Request
    plan: Plan | None = None
    hash: str = ""
    error: str = ""

    @property
    def label(self) -> str:
        """Label on the screen."""
        return " · ".join(filter(None, (self.scene, self.display, self.variation)))

    def planned(self, display: Display | str | Path | None, definitions: Mapping[str, str]) -> Unit:
        """The unit on a display, with its plan and the hash of its key."""
        request = replace(self.request, display=display, definitions=definitions)
        plan = make_plan(request, of_scene=True)
        return replace(self, request=request, plan=plan, hash=unit_hash(key_of(plan)))

    def with_algorithms(self, algorithms: Sequence[str]) -> Request:
        """Request for some of the algorithms, without the criteria of the others."""
        assert self.plan is not None
        limits = [f"{n}:{v!r}" for n, v in self.plan.ssim_limits.items() if n in algorithms]
        key = f"{PREFIX}min_ssim_to_reference"
        return replace(
            self.request,
            algorithms=tuple(algorithms),
            definitions={**self.request.definitions, key: ",".join(limits)},
        )


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
                    unit = unit.planned(*display.with_settings(definitions, str(study.path)))
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


def key_of(plan: Plan) -> dict[str, Any]:
    """Inputs of a validation's scores, except the algorithm, as JSON values."""
    settings = {k: v for k, v in asdict(plan.settings).items() if k not in _NOT_DECIDING}
    key = {
        "scene": plan.scene_file.sha256,
        "parameters": plan.scene_file.parameters,
        "settings": settings,
        "display": _nameless(plan.display.parameters()),
        "mounted": _nameless(plan.misaligned_display.parameters()),
        "viewpoints": [asdict(viewpoint) for viewpoint in plan.viewpoints],
        "backend": plan.request.backend,
        "time": plan.request.time,
        "versions": {"inim": __version__, **versions()},
        "code": _own_code(),
    }
    lens_model = foreign_identity(plan.settings.lens_model)
    plugins = {"metrics": foreign_identities(), "lens_model": lens_model}
    key |= {name: identities for name, identities in plugins.items() if identities}
    record: dict[str, Any] = json.loads(json.dumps(key))
    return record


def _nameless(display: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in display.items() if key != "name"}


def unit_hash(key: Mapping[str, Any]) -> str:
    """Hash of a key: the first digits of its SHA-256."""
    text = json.dumps(key, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:_HASH_DIGITS]


def algorithm_inputs(plan: Plan, algorithm: str) -> dict[str, Any]:
    """Further inputs of an algorithm's result: its criterion, and another package's code."""
    inputs: dict[str, Any] = {"min_ssim_to_reference": plan.ssim_limits.get(algorithm)}
    name = parse_algorithm(algorithm)[0]
    if is_own(name) or name in SCENE_ALGORITHMS:
        return inputs
    return inputs | identity("inim.generators", name)


@cache
def _own_code() -> str:
    """SHA-256 of the code that affects scores, which may change without a new version."""
    root = Path(inim.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        name = path.relative_to(root).as_posix()
        if not name.startswith(_NOT_SCORING):
            digest.update(name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


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
        write_atomically(path, lambda p: p.write_text(encode(document), encoding="utf-8"))


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
        "inim.apps.sweep.unit:run_job",
        lambda: task,
        _staging(task),
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
    with file_errors(folder, "set TMPDIR to a folder with room"):
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    if status.st_uid != os.getuid() or stat.S_IMODE(status.st_mode) != 0o700:
        raise FileError(
            f"{folder}: belongs to another user or is open to others; set TMPDIR to a folder of "
            "your own"
        )
    return hidden_folder(folder / "unit")


def report_folder(out: Path, unit: str) -> Path:
    """Folder of a unit's report, if it is kept."""
    return out / _REPORTS / unit


def run_job(task: SweepTask, staging: Path, observer: Observer) -> bool:
    """Entry point in the worker: validate, and write the results into the sweep's folder."""
    plan = make_plan(task.request)
    _check_same(task, plan)
    report = _validate(task, plan, staging, observer)
    results = Results(task.request.out)
    with delayed_interrupts():
        for name in task.algorithms:
            results.write(
                unit_document(
                    report.data,
                    unit=task.unit,
                    algorithm=name,
                    making=algorithm_inputs(plan, name),
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
    carry_out = partial(run, plan, staging, observer, data_only=not task.keep_report)
    if task.threads is None:
        return carry_out()
    from inim.render.reference_kernel import drjit_threads

    with drjit_threads(max(_FEWEST_RENDER_THREADS, task.threads)):
        return carry_out()
