"""A sweep: scenes, displays, algorithms, viewpoints and settings, multiplied into one table.

`run_sweep` is `inim sweep`: it computes the missing results, then writes the table and its page.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from inim.apps.sweep.document import SweepTable
from inim.apps.sweep.page import PAGE, write_page
from inim.apps.sweep.study import Study, read_study, study_of
from inim.apps.sweep.table import TABLE, check_pyarrow, failed_rows, finished_rows, write_table
from inim.apps.sweep.unit import (
    FOLDER,
    Results,
    SweepTask,
    Unit,
    algorithm_inputs,
    expand,
    key_of,
    report_folder,
)
from inim.apps.sweep.workers import Progress, check_answers, check_dask, choose_slots, run_tasks
from inim.display import Display
from inim.display.settings import plain_parameters
from inim.pipeline.plan import LEAST_BYTES
from inim.scores.document_parts import origin
from inim.system import backend as backends
from inim.system.process.atomic_file import file_errors
from inim.system.process.machine import cpu_count


@dataclass(frozen=True)
class SweepPlace:
    """Workers of a sweep, and the folder of its results.

    `scheduler` is the address of a dask scheduler; without one, the sweep runs on this machine,
    with at most `workers` simultaneous tasks. `threads` are those of each worker. `allow_folders`
    are additional folders for the files of all scenes.
    """

    out: Path
    scheduler: str | None = None
    workers: int | None = None
    threads: int | None = None
    allow_folders: tuple[Path, ...] = ()


@dataclass(frozen=True)
class SweepPlan:
    """Units of a study in its order, and a task for each unit without all its results."""

    study: Study
    results: Results
    units: list[Unit]
    tasks: list[SweepTask]

    def lines(self) -> list[str]:
        """Lines with the finished, remaining and impossible validations."""
        algorithms = len(self.study.algorithms)
        total = len({u.hash for u in self.units if u.plan is not None}) * algorithms
        left = sum(len(task.algorithms) for task in self.tasks)
        return [
            f"{self.study.title}: {len(self.units)} validations of {algorithms} algorithms; "
            f"{total - left} of {total} results exist, {len(self.tasks)} validations to run",
            *(f"cannot be run: {u.label}: {u.error}" for u in self.units if u.error),
        ]


def plan_study(study: Study, place: SweepPlace, threads: int | None = None) -> SweepPlan:
    """Plan all units of a study and look up their results, without writing files."""
    # The workers of a cluster have other current folders.
    scenes = {name: path.absolute() for name, path in study.scenes.items()}
    results = Results(place.out.absolute())
    allowed = tuple(folder.absolute() for folder in place.allow_folders)
    units = expand(replace(study, scenes=scenes), results.out, allowed)
    return SweepPlan(study, results, units, _tasks(study, units, results, threads))


def _tasks(
    study: Study, units: Sequence[Unit], results: Results, threads: int | None
) -> list[SweepTask]:
    """Remaining tasks, each unit once even if the study lists it twice."""
    tasks: dict[str, SweepTask] = {}
    for unit in units:
        if unit.plan is None or unit.hash in tasks:
            continue
        missing = [
            name
            for name in study.algorithms
            if results.read(unit.hash, name, algorithm_inputs(unit.plan, name)) is None
        ]
        if study.keep_reports:  # a report shows all algorithms
            whole = (report_folder(results.out, unit.hash) / "report.json").is_file()
            missing = [] if whole and not missing else list(study.algorithms)
        if missing:
            tasks[unit.hash] = SweepTask(
                unit.hash,
                unit.label,
                unit.with_algorithms(missing),
                key_of(unit.plan),
                tuple(missing),
                keep_report=study.keep_reports,
                threads=threads,
                memory_bytes=LEAST_BYTES + unit.plan.images_bytes,
            )
    return list(tasks.values())


_MISSING = "its worker wrote no result into {}: choose a folder with -o that all machines share"


def sweep(
    out: Path | str,
    scenes: Sequence[Path | str],
    algorithms: Sequence[str],
    *,
    displays: Sequence[Display | str] = (),
    settings: Mapping[str, Any] | None = None,
    workers: int | None = None,
    threads: int | None = None,
    scheduler: str | None = None,
    quiet: bool = True,
    **options: Any,
) -> Any:
    """Validate all combinations of scenes, displays, settings and algorithms.

    Results in `out` are reused, so the same call again, or a larger one, computes the rest only.
    The folder also gets the page ``sweep.html``.

    Parameters
    ----------
    out : path
        Folder of the results.
    scenes : sequence of paths
    algorithms : sequence of str
        ``"template"``, ``"gu2020:step_mm=1"``, ...
    displays : sequence of Display or str
        Displays, or names of presets; without any, each scene's own display.
    settings : mapping, optional
        `inim.*` settings and display parameters without the prefix. A list, a range or an array of
        values multiplies the combinations: ``{"gap_mm": [3.3, 3.5], "eia_spp": 64}``.
    workers, threads, scheduler :
        As `SweepPlace`.
    quiet : bool
        Print no lines and no progress.
    **options
        Further keys of a study's ``[study]``: ``viewpoints``, ``lens_model``, ``title``,
        ``backend``, ``time``, ``keep_reports``.

    Returns
    -------
    pyarrow.Table
        A row for each scene, display, algorithm, viewpoint and setting
        (docs/reference/sweep-table.md); its method ``to_pandas()`` makes a DataFrame.

    Raises
    ------
    UsageError
        An unknown key or an invalid value.
    """
    from pyarrow import parquet

    study = study_of(
        {
            "study": {
                "title": "sweep",
                "scenes": [str(scene) for scene in scenes],
                "algorithms": list(algorithms),
                **({"displays": [_display_name(d) for d in displays]} if displays else {}),
                **options,
            },
            "settings": {key: _as_values(value) for key, value in (settings or {}).items()},
            "display": [
                {"name": d.name} | plain_parameters(d) for d in displays if isinstance(d, Display)
            ],
        },
        "inim.sweep",
    )
    place = SweepPlace(Path(out), scheduler, workers, threads)
    run_sweep(study, place, quiet=quiet)
    return parquet.read_table(place.out / TABLE)


def _display_name(display: Display | str) -> str:
    return display.name if isinstance(display, Display) else display


def _as_values(value: Any) -> Any:
    """A list of several values; a single value as it is."""
    if isinstance(value, str | Mapping) or not isinstance(value, Iterable):
        return value
    return [getattr(item, "item", lambda item=item: item)() for item in value]


@dataclass(frozen=True)
class SweepResult:
    """Result of a sweep: the rows of the table.

    `units` is the number of validations of the study, `computed` the number that this run computed,
    and `failed` the error message of each failed unit, by label.
    """

    rows: list[dict[str, Any]]
    units: int
    computed: int
    failed: dict[str, str]

    @property
    def passed(self) -> bool:
        """True if every row exists and passed its validation's checks."""
        return not self.failed and all(row["passed"] for row in self.rows)


def run_sweep(
    study: Study | Path,
    place: SweepPlace,
    command: str = "",
    *,
    quiet: bool = True,
    debug: bool = False,
) -> SweepResult:
    """Compute the missing results of a study, and write its table and page.

    `command` is the command line, for the record. `quiet` suppresses lines and progress bar;
    `debug` lets workers print the traceback of an internal error. Raises an `InimError` for an
    error in the study, or without a backend or a cluster. A failed unit raises nothing; its rows
    contain the error.
    """
    study = read_study(study) if isinstance(study, Path) else study
    check_pyarrow()
    workers, threads = choose_slots(place.workers, place.threads, cpu_count())
    check_dask()
    if place.scheduler is not None:
        check_answers(place.scheduler)
    # The number of threads on a cluster is the choice of its workers.
    plan = plan_study(study, place, threads if place.scheduler is None else place.threads)
    plan = replace(plan, tasks=[replace(task, debug=debug) for task in plan.tasks])
    with file_errors(place.out):
        (plan.results.out / FOLDER).mkdir(parents=True, exist_ok=True)
    errors: dict[str, str] = {}
    with closing(Progress(len(plan.tasks), quiet=quiet)) as progress:
        for line in plan.lines():
            progress.say(line)
        if plan.tasks and place.scheduler is None:
            backends.choose_backend(study.backend)  # raises before any task starts
        if plan.tasks:
            errors = run_tasks(plan.tasks, place.scheduler, workers, progress)
    rows, failed = _collect_rows(plan, errors)
    about = SweepTable(title=study.title, **origin(command))
    write_table(place.out / TABLE, rows, about)
    write_page(place.out / PAGE, rows, about)
    return SweepResult(rows, len(plan.units), len(plan.tasks), failed)


def _collect_rows(
    plan: SweepPlan, errors: dict[str, str]
) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """Collect all rows in the study's order, and the failures."""
    rows: list[dict[str, Any]] = []
    failed: dict[str, str] = {}
    for unit in plan.units:
        for name in plan.study.algorithms:
            result = None
            if unit.plan is not None:
                result = plan.results.read(unit.hash, name, algorithm_inputs(unit.plan, name))
            if result is not None:
                rows += finished_rows(unit, name, result)
                continue
            error = unit.error or errors.get(unit.hash) or _MISSING.format(plan.results.out)
            failed[unit.label] = error
            rows += failed_rows(unit, name, error)
    return rows, failed
