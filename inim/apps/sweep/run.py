"""A sweep: scenes, displays, algorithms, viewpoints and settings, multiplied into one table.

`run_sweep` is `inim sweep`: it computes the missing results, then writes the table and its page.
"""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from inim.apps.sweep.document import SweepDocument
from inim.apps.sweep.page import FILES, write_page
from inim.apps.sweep.study import Study, read_study, study_of
from inim.apps.sweep.table import TABLE, check_pyarrow, failed_rows, finished_rows, write_table
from inim.apps.sweep.unit import Results, SweepTask, Unit, expand, report_folder
from inim.apps.sweep.workers import (
    Outcome,
    Progress,
    check_answers,
    check_dask,
    choose_slots,
    run_tasks,
)
from inim.display import Display
from inim.display.settings import plain_parameters
from inim.pipeline.plan import LEAST_BYTES
from inim.pipeline.stages.scene import Renderer
from inim.report.document import ReportDocument
from inim.scores.document_parts import origin
from inim.system.backend import choose_backend
from inim.system.document import decode
from inim.system.process.atomic_file import file_errors
from inim.system.process.machine import cpu_count
from inim.system.process.observer import Observer
from inim.system.worker.output import output_files


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
    """Units of a study in its order, and their results that exist, by hash."""

    study: Study
    out: Path
    units: list[Unit]
    results: Results
    finished: dict[str, ReportDocument]

    @cached_property
    def missing(self) -> dict[str, Unit]:
        """Units to compute by hash, each once even if the study lists it twice."""
        units = {unit.hash: unit for unit in self.units if unit.plan is not None}
        return {name: unit for name, unit in units.items() if name not in self.finished}

    def lines(self) -> list[str]:
        """Lines with the finished, remaining and impossible validations."""
        missing, finished = len(self.missing), len(self.finished)
        return [
            f"{self.study.title}: {len(self.units)} validations of {len(self.study.algorithms)} "
            f"algorithms; {finished} of {finished + missing} results exist, {missing} validations "
            "to run",
            *(f"cannot be run: {u.label}: {u.error}" for u in self.units if u.error),
        ]

    def tasks(self, threads: int | None, debug: bool) -> list[SweepTask]:
        """A task for each missing result, with threads for its worker."""
        return [
            SweepTask(
                name,
                unit.label,
                unit.request,
                unit.inputs,
                keep_report=self.study.keep_reports,
                threads=threads,
                memory_bytes=LEAST_BYTES + (unit.plan.images_bytes if unit.plan else 0),
                debug=debug,
            )
            for name, unit in self.missing.items()
        ]


def plan_study(study: Study, place: SweepPlace) -> SweepPlan:
    """Plan all units of a study and look up their results, without writing files."""
    # The workers of a cluster have other current folders.
    scenes = {name: path.absolute() for name, path in study.scenes.items()}
    out = place.out.absolute()
    allowed = tuple(folder.absolute() for folder in place.allow_folders)
    units = expand(replace(study, scenes=scenes), out, allowed)
    renderer = Renderer(study.backend, Observer()) if place.scheduler is None else None
    results = Results.of(renderer)
    texts = {unit.hash: results.find(unit) for unit in units if unit.plan is not None}
    finished = {
        name: decode(text, ReportDocument)
        for name, text in texts.items()
        if text is not None
        and (not study.keep_reports or (report_folder(out, name) / "report.json").is_file())
    }
    return SweepPlan(study, out, units, results, finished)


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

    Results in the result cache are reused, so the same call again, or one with more combinations,
    computes the rest only. The folder also gets the page ``sweep.html``.

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


def run_sweep(
    study: Study | Path,
    place: SweepPlace,
    command: str = "",
    *,
    quiet: bool = True,
    debug: bool = False,
) -> SweepDocument:
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
    plan = plan_study(study, place)
    # The number of threads on a cluster is the choice of its workers.
    tasks = plan.tasks(threads if place.scheduler is None else place.threads, debug)
    with output_files(place.out, FILES) as staging:
        if study.keep_reports:
            with file_errors(place.out):
                report_folder(plan.out, "").mkdir(parents=True, exist_ok=True)
        errors: dict[str, str] = {}
        with closing(Progress(len(tasks), quiet=quiet)) as progress:
            for line in plan.lines():
                progress.say(line)

            def on_end(task: SweepTask, outcome: Outcome) -> None:
                if outcome.error:
                    errors[task.hash] = outcome.error
                else:
                    plan.results.keep(plan.missing[task.hash], outcome.report)
                    plan.finished[task.hash] = decode(outcome.report, ReportDocument)
                progress.report_end(task.label, outcome.seconds, outcome.error)

            if tasks and place.scheduler is None:
                choose_backend(study.backend)  # raises before any task starts
            if tasks:
                run_tasks(tasks, place.scheduler, workers, on_end, progress.say)
        rows, failed = _collect_rows(plan, errors)
        data = SweepDocument(
            title=study.title,
            validations=len(plan.units),
            computed=len(tasks),
            rows=len(rows),
            passed=not failed and all(row["passed"] for row in rows),
            failed=failed,
            **origin(command),
        )
        write_table(staging / TABLE, rows, data)
        return write_page(data, rows, staging)


def _collect_rows(
    plan: SweepPlan, errors: dict[str, str]
) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """Collect all rows in the study's order, and the failures."""
    rows: list[dict[str, Any]] = []
    failed: dict[str, str] = {}
    for unit in plan.units:
        for name in plan.study.algorithms:
            if unit.hash in plan.finished:
                rows += finished_rows(unit, name, plan.finished[unit.hash])
            else:
                failed[unit.label] = unit.error or errors[unit.hash]
                rows += failed_rows(unit, name, failed[unit.label])
    return rows, failed
