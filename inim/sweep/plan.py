"""What a sweep will do: its units, and what is left of them to compute."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from inim.sweep.results import Results
from inim.sweep.study import Study, read_study
from inim.sweep.task import Task, make_task, report_folder
from inim.sweep.unit import Unit, expand, making_of

__all__ = ["SweepPlan", "SweepRequest", "default_out", "plan_sweep"]


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


def default_out(study: Path) -> Path:
    """Where a sweep goes when nobody says: beside where the command is typed."""
    return Path(f"{study.stem}-sweep")


@dataclass(frozen=True)
class SweepPlan:
    """A study's units, and what is left to do.

    Attributes
    ----------
    study : Study
    results : Results
        Where results lie.
    units : list of Unit
        In the study's order.
    tasks : list of Task
        One for each unit that lacks a result.
    """

    study: Study
    results: Results
    units: list[Unit]
    tasks: list[Task]

    def lines(self) -> list[str]:
        """What there is, what will be run, and what cannot be."""
        algorithms = len(self.study.algorithms)
        wanted = len({u.hash for u in self.units if u.plan is not None}) * algorithms
        left = sum(len(task.algorithms) for task in self.tasks)
        return [
            f"{self.study.title}: {len(self.units)} validations of {algorithms} algorithms; "
            f"{wanted - left} of {wanted} results are there, {len(self.tasks)} validations to run",
            *(f"cannot be run: {u.label}: {u.error}" for u in self.units if u.error),
        ]


def plan_sweep(request: SweepRequest, threads: int | None = None) -> SweepPlan:
    """Read the study, plan all its units, and look for their results; nothing is written.

    Raises
    ------
    InimError
        What is wrong with the study.
    """
    study = read_study(request.study)
    # A cluster's workers stand elsewhere.
    scenes = {name: path.absolute() for name, path in study.scenes.items()}
    results = Results(request.out.absolute())
    units = expand(replace(study, scenes=scenes), results.out)
    return SweepPlan(study, results, units, _tasks(study, units, results, threads))


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
        if study.keep_reports:  # a report shows all algorithms beside one another
            whole = (report_folder(results.out, unit.hash) / "report.json").is_file()
            missing = [] if whole and not missing else list(study.algorithms)
        if missing:
            tasks[unit.hash] = make_task(
                unit, missing, keep_report=study.keep_reports, threads=threads
            )
    return list(tasks.values())
