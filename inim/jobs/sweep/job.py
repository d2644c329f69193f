"""A whole sweep: plan all units, compute what is not there, write the table and its page."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from inim import backend as backends
from inim.backend.machine import cpu_count
from inim.errors import FileError
from inim.jobs.sweep.board import Board
from inim.jobs.sweep.cluster import check_answers, check_dask, run_cluster
from inim.jobs.sweep.pool import choose_slots, run_pool
from inim.jobs.sweep.results import FOLDER, Results
from inim.jobs.sweep.rows import failed_rows, finished_rows
from inim.jobs.sweep.study import Study, read_study
from inim.jobs.sweep.table import TABLE, check_pyarrow, write_table
from inim.jobs.sweep.task import Task, make_task
from inim.jobs.sweep.unit import Unit, expand, making_of
from inim.report.sweep import PAGE, write_page
from inim.version import __version__

__all__ = ["Outcome", "SweepRequest", "default_out", "run_sweep"]

_NOT_THERE = "its worker put no result into {}: choose a folder with -o that all machines share"


@dataclass(frozen=True)
class SweepRequest:
    """What the user asked for.

    Attributes
    ----------
    study, out : Path
    scheduler : str, optional
        Address of a dask scheduler; a pool on this machine without one.
    workers : int, optional
        Of the pool, at once.
    threads : int, optional
        Of each worker.
    """

    study: Path
    out: Path
    scheduler: str | None = None
    workers: int | None = None
    threads: int | None = None

    def command(self) -> str:
        """The command line that repeats this request."""
        words = ["inim", "sweep", str(self.study), "-o", str(self.out)]
        for name in ("scheduler", "workers", "threads"):
            if getattr(self, name) is not None:
                words += [f"--{name}", str(getattr(self, name))]
        return shlex.join(words)


@dataclass(frozen=True)
class Outcome:
    """How a sweep ended.

    Attributes
    ----------
    rows : list of dict
        The table.
    units, computed : int
        Validations of the study, and those of them that this run had to carry out.
    failed : dict of str to str
        By what it is called, the error of each unit that failed.
    """

    rows: list[dict[str, Any]]
    units: int
    computed: int
    failed: dict[str, str]

    @property
    def passed(self) -> bool:
        """Whether every row is there and passed its validation's checks."""
        return not self.failed and all(row["passed"] for row in self.rows)


def default_out(study: Path) -> Path:
    """Where a sweep goes when nobody says: beside where the command is typed."""
    return Path(f"{study.stem}-sweep")


def run_sweep(request: SweepRequest, *, quiet: bool = True, debug: bool = False) -> Outcome:
    """Compute what a study lacks; table and page are in `request.out` afterwards.

    Raises
    ------
    InimError
        What is wrong with the study, or no backend, table or cluster to work with. A unit that
        fails is no exception but an error in its rows.
    """
    check_pyarrow()
    workers, threads = _checked(request)
    study = read_study(request.study)
    out = request.out.absolute()  # a cluster's workers stand elsewhere
    units = expand(_absolute(study), out)
    _make_folder(out, request.out)
    tasks = _tasks(study, units, Results(out), threads)
    tasks = [replace(task, debug=debug) for task in tasks]
    board = Board(len(tasks), quiet=quiet)
    board.say(_plan_words(study, units, tasks))
    for unit in units:
        if unit.error:
            board.say(f"cannot be run: {unit.label}: {unit.error}")
    try:
        errors = {}
        if tasks and request.scheduler is not None:
            errors = run_cluster(tasks, request.scheduler, board)
        elif tasks:
            backends.choose_backend(study.backend)  # once, and before anything is started
            errors = run_pool(tasks, workers, board)
    finally:
        board.close()
    rows, failed = _assembled(study, units, Results(out), errors)
    about = {
        "title": study.title,
        "command": request.command(),
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "inim_version": __version__,
    }
    write_table(out / TABLE, rows, about)
    write_page(out / PAGE, rows, about)
    return Outcome(rows, len(units), len(tasks), failed)


def _checked(request: SweepRequest) -> tuple[int, int | None]:
    """Workers at once and their threads; a cluster's own affair unless said."""
    workers, threads = choose_slots(request.workers, request.threads, cpu_count())
    if request.scheduler is None:
        return workers, threads
    check_dask()
    check_answers(request.scheduler)
    return workers, request.threads


def _absolute(study: Study) -> Study:
    return replace(study, scenes={name: path.absolute() for name, path in study.scenes.items()})


def _make_folder(out: Path, shown: Path) -> None:
    try:
        (out / FOLDER).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(
            f"{shown}: cannot be written ({error.strerror}); choose another folder with -o"
        ) from None


def _tasks(
    study: Study, units: Sequence[Unit], results: Results, threads: int | None
) -> list[Task]:
    """What is left to do, each unit once, though a study may name it twice."""
    tasks: dict[str, Task] = {}
    for unit in units:
        if unit.plan is None or unit.hash in tasks:
            continue
        missing = [
            name
            for name in study.algorithms
            if results.read(unit.hash, name, making_of(unit.plan, name)) is None
        ]
        if missing:
            tasks[unit.hash] = make_task(
                unit, missing, keep_report=study.keep_reports, threads=threads
            )
    return list(tasks.values())


def _plan_words(study: Study, units: Sequence[Unit], tasks: Sequence[Task]) -> str:
    wanted = len({unit.hash for unit in units if unit.plan is not None}) * len(study.algorithms)
    left = sum(len(task.algorithms) for task in tasks)
    return (
        f"{study.title}: {len(units)} validations of {len(study.algorithms)} algorithms; "
        f"{wanted - left} of {wanted} results are there, {len(tasks)} validations to run"
    )


def _assembled(
    study: Study, units: Sequence[Unit], results: Results, errors: dict[str, str]
) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """All rows in the study's order, and what failed."""
    rows: list[dict[str, Any]] = []
    failed: dict[str, str] = {}
    for unit in units:
        for name in study.algorithms:
            found = None
            if unit.plan is not None:
                found = results.read(unit.hash, name, making_of(unit.plan, name))
            if found is not None:
                rows += finished_rows(unit, name, found)
                continue
            error = unit.error or errors.get(unit.hash) or _NOT_THERE.format(results.out)
            failed[unit.label] = error
            rows += failed_rows(unit, name, error)
    return rows, failed
