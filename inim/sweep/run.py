"""A whole sweep: compute what a study lacks, write the table and its page."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from inim import backend as backends
from inim.backend.machine import cpu_count
from inim.errors import FileError
from inim.report.sweep.page import PAGE, write_page
from inim.sweep.cluster import check_answers, check_dask, run_cluster
from inim.sweep.plan import SweepPlan, SweepRequest, plan_sweep
from inim.sweep.pool import choose_slots, run_pool
from inim.sweep.progress import Board
from inim.sweep.results import FOLDER
from inim.sweep.rows import failed_rows, finished_rows
from inim.sweep.table import TABLE, check_pyarrow, write_table
from inim.sweep.unit import making_of
from inim.version import __version__

__all__ = ["Outcome", "run_sweep"]

_NOT_THERE = "its worker put no result into {}: choose a folder with -o that all machines share"


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


def run_sweep(request: SweepRequest, *, quiet: bool = True, debug: bool = False) -> Outcome:
    """Compute what a study lacks; table and page are in `request.out` afterwards.

    Parameters
    ----------
    request : SweepRequest
    quiet : bool
        No lines and no live table.
    debug : bool
        Let workers print the traceback of an internal error.

    Raises
    ------
    InimError
        What is wrong with the study, or no backend, table or cluster to work with. A unit that
        fails is no exception but an error in its rows.
    """
    check_pyarrow()
    workers, threads = choose_slots(request.workers, request.threads, cpu_count())
    if request.scheduler is not None:
        check_dask()
        check_answers(request.scheduler)
    # How many cores another machine has is its own affair.
    plan = plan_sweep(request, threads if request.scheduler is None else request.threads)
    plan = replace(plan, tasks=[replace(task, debug=debug) for task in plan.tasks])
    _make_folder(plan.results.out, request.out)
    errors = _computed(plan, request.scheduler, workers, Board(len(plan.tasks), quiet=quiet))
    rows, failed = _assembled(plan, errors)
    about = {
        "title": plan.study.title,
        "command": request.command(),
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "inim_version": __version__,
    }
    write_table(plan.results.out / TABLE, rows, about)
    write_page(plan.results.out / PAGE, rows, about)
    return Outcome(rows, len(plan.units), len(plan.tasks), failed)


def _make_folder(out: Path, shown: Path) -> None:
    try:
        (out / FOLDER).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(
            f"{shown}: cannot be written ({error.strerror}); choose another folder with -o"
        ) from None


def _computed(plan: SweepPlan, scheduler: str | None, workers: int, board: Board) -> dict[str, str]:
    """Carry out the tasks, here or elsewhere; by unit, the error of each that failed."""
    for line in plan.lines():
        board.say(line)
    if not plan.tasks:
        return {}
    try:
        if scheduler is not None:
            return run_cluster(plan.tasks, scheduler, board)
        backends.choose_backend(plan.study.backend)  # once, and before anything is started
        return run_pool(plan.tasks, workers, board)
    finally:
        board.close()


def _assembled(
    plan: SweepPlan, errors: dict[str, str]
) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """All rows in the study's order, and what failed."""
    rows: list[dict[str, Any]] = []
    failed: dict[str, str] = {}
    for unit in plan.units:
        for name in plan.study.algorithms:
            found = None
            if unit.plan is not None:
                found = plan.results.read(unit.hash, name, making_of(unit.plan, name))
            if found is not None:
                rows += finished_rows(unit, name, found)
                continue
            error = unit.error or errors.get(unit.hash) or _NOT_THERE.format(plan.results.out)
            failed[unit.label] = error
            rows += failed_rows(unit, name, error)
    return rows, failed
