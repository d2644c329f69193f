"""The bench of a scene as a command: checked, measured in a worker process, written whole."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from msgspec.structs import replace as replaced

from inim.backend.choice import backend_data, versions
from inim.bench.evaluate import bench_scene, choose_algorithms
from inim.documents.bench import BenchAlgorithm, BenchDocument, BenchRounds, Load
from inim.documents.parts import Backend
from inim.errors import UsageError
from inim.pipeline.plan import Plan, make_plan
from inim.pipeline.request import Request, option_words
from inim.pipeline.stages.scene import Renderer
from inim.process.observer import Observer
from inim.report.bench import write_bench
from inim.timing import Rounds, max_threads
from inim.version import __version__
from inim.worker.output import publish, staging_folder
from inim.worker.supervisor import run_in_worker

_MARKER = "bench.json"
_FILES = (_MARKER, "bench.html", "bench.md")


@dataclass(frozen=True)
class BenchRequest:
    """Request for a bench run.

    Attributes
    ----------
    validation : Request
        A validation of the scene, with the algorithms to time: its display and sampling hold.
    rounds : Rounds
        How often everything runs, and on how many threads.
    """

    validation: Request
    rounds: Rounds = field(default_factory=Rounds)

    @property
    def out(self) -> Path:
        """Folder of the results."""
        return self.validation.out

    def plan(self) -> Plan:
        """The plan of the validation: display, viewpoints and sampling.

        Algorithms are chosen apart: their options are not settings.
        """
        return make_plan(replace(self.validation, algorithms=("template",)))

    def command(self, plan: Plan) -> list[str]:
        """The command line that repeats this request."""
        names = ("runs", "warmups", "threads")
        values = {name: getattr(self.rounds, name) for name in names}
        return [
            *("inim", "bench"),
            *self.validation.command(plan.settings, plan.file.settings),
            *option_words({f"--{k}": v for k, v in values.items() if v != getattr(Rounds(), k)}),
        ]


def run_bench(request: BenchRequest, *, quiet: bool = True, debug: bool = False) -> None:
    """Measure in a worker process, and write `bench.json` and its pages to `request.out`.

    Raises
    ------
    InimError
        Errors from the worker, or `WorkerError` / `OutOfMemoryError` if it died.
        Errors in the request are detected before rendering.
    """
    load = load_average()  # before the worker starts to load: what others do
    run_in_worker(
        "inim.bench.job:work",
        lambda: (request, _plan(request), load),
        staging_folder(request.out, _FILES),
        backend="llvm",
        quiet=quiet,
        debug=debug,
    )


def _plan(request: BenchRequest) -> Plan:
    """The request's plan; raises the `InimError` that fits where it cannot be carried out."""
    most, threads = max_threads(), request.rounds.threads
    if threads is not None and not 1 <= threads <= most:
        raise UsageError(f"--threads {threads}: this machine has 1 to {most}")
    plan = request.plan()
    if request.validation.algorithms is not None:
        choose_algorithms(request.validation.algorithms)
    return plan


def work(job: tuple[BenchRequest, Plan, float | None], staging: Path, observer: Observer) -> bool:
    """The worker's side: measure, write, publish."""
    request, plan, load = job
    observer.stage("start")
    renderer = Renderer("llvm", observer)
    title = f"Bench: {plan.request.scene.stem}"
    document = record(title, request.command(plan), renderer.backend, request.rounds, load)
    names, notes = choose_algorithms(request.validation.algorithms)
    scene = bench_scene(plan, names, request.rounds, renderer)
    _print_algorithms(observer, scene.algorithms)
    busy = replaced(document.load, end=load_average())
    observer.stage("write")
    write_bench(replaced(document, notes=notes, scene=scene, load=busy), staging)
    publish(staging, request.out, _MARKER)
    return True


def _print_algorithms(observer: Observer, algorithms: Sequence[BenchAlgorithm]) -> None:
    width = max(len(algorithm.name) for algorithm in algorithms)
    for a in algorithms:
        wrong = "   –   " if a.wrong_source is None else f"{a.wrong_source:7.2%}"
        observer.line(
            f"{a.name:{width}}  {a.median_ms:9.2f} ms  {a.ratio:8.2f} yardsticks  wrong "
            f"source {wrong}  EIA PSNR {a.scores['eia_psnr_db']:.2f} dB  view SSIM to reference "
            f"{a.scores['view_ssim_to_reference']:.4f}{'  *' if a.pareto else ''}"
        )


_VERSIONS = ("drjit", "matplotlib", "mitsuba", "numba", "numpy", "scikit-image")
# Share of the cores that others may keep busy before times are in doubt.
_BUSY = 0.25


def record(
    title: str, command: Sequence[str], backend: Any, rounds: Rounds, load: float | None
) -> BenchDocument:
    """A document without results, load at the end and list of files.

    Parameters
    ----------
    command : sequence of str
        The words that repeat it.
    backend : inim.backend.Backend
    load : float or None
        `load_average` before anything was loaded.
    """
    return BenchDocument(
        title=title,
        created=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        inim_version=__version__,
        versions=versions(_VERSIONS),
        command=shlex.join(command),
        backend=Backend(**backend_data(backend)),
        threads=rounds.threads or max_threads(),
        threading_layer=os.environ.get("NUMBA_THREADING_LAYER", "default"),
        rounds=BenchRounds(runs=rounds.runs, warmups=rounds.warmups),
        warnings=warn_of_load(load),
        load=Load(start=load, cores=os.cpu_count(), end=None),
        notes=[],
        scene=None,
        files=[],
    )


def load_average() -> float | None:
    """Number of running and waiting processes, averaged over one minute; None if unavailable."""
    try:
        return os.getloadavg()[0]
    except OSError:
        return None


def warn_of_load(before: float | None) -> list[str]:
    """A warning where others were at work when the measurement began."""
    cores = os.cpu_count() or 1
    if before is None:
        return ["the load of this machine is not known: times may be those of a busy one"]
    if before <= _BUSY * cores:
        return []
    return [
        f"the machine was busy: load average {before:.2f} on {cores} cores at the start; "
        "trust ratios and fastest runs more than medians, and run it again alone"
    ]
