"""Run time against error: the time and the errors of each algorithm on a scene.

All methods and a reference kernel run alternately in one loop (`inim.pipeline.timing`), on
display-ready pictures. Times are given in milliseconds and in kernel times: multiples of the
reference kernel's time, one 4-byte gather per display pixel. `run_bench` is `inim bench SCENE`: it
checks the request, measures in a worker process, and writes the results. Further studies use the
functions of `inim.apps.bench.evaluate`, and `record` and `inim.apps.bench.page.write_bench` for
their results.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from msgspec.structs import replace as replaced

from inim.apps.bench.document import BenchAlgorithm, BenchDocument, BenchRounds, Load
from inim.apps.bench.evaluate import DISTURBED, bench_scene, choose_algorithms
from inim.apps.bench.page import write_bench
from inim.pipeline.plan import Plan, make_plan
from inim.pipeline.request import Request
from inim.pipeline.stages.scene import Renderer
from inim.pipeline.timing import Rounds, thread_count
from inim.scores.document_parts import BackendRecord, origin
from inim.system.process.observer import Observer
from inim.system.worker.output import staging_folder
from inim.system.worker.supervisor import run_in_worker

_FILES = ("bench.json", "bench.html", "bench.md")


@dataclass(frozen=True)
class BenchRequest:
    """Request for a bench run.

    The validation's algorithms are timed; its display and sampling apply. `command` is the command
    line, for the record.
    """

    validation: Request
    rounds: Rounds = field(default_factory=Rounds)
    command: str = ""

    def plan(self) -> Plan:
        """Plan the validation, and check the algorithms and the number of threads."""
        thread_count(self.rounds.threads)
        # Timed algorithms may have options that are not allowed in file names.
        plan = make_plan(replace(self.validation, algorithms=("template",)), of_scene=True)
        if self.validation.algorithms is not None:
            choose_algorithms(self.validation.algorithms)
        return plan


def run_bench(request: BenchRequest, *, quiet: bool = True, debug: bool = False) -> None:
    """Measure in a worker process, and write `bench.json` and its pages.

    Raises the `InimError` of the request, before anything is rendered, or of the worker.
    """
    load = load_average()  # of the other processes, before the worker starts
    run_in_worker(
        "inim.apps.bench.run:run_job",
        lambda: (request, request.plan(), load),
        staging_folder(request.validation.out, _FILES),
        quiet=quiet,
        debug=debug,
    )


def run_job(
    job: tuple[BenchRequest, Plan, float | None], staging: Path, observer: Observer
) -> bool:
    """Entry point in the worker: measure and write."""
    request, plan, load = job
    observer.stage("start")
    renderer = Renderer("llvm", observer)
    title = f"Bench: {plan.request.scene.stem}"
    document = record(title, request.command, renderer.backend, request.rounds, load)
    names, notes = choose_algorithms(request.validation.algorithms)
    scene, others = bench_scene(plan, names, request.rounds, renderer)
    _print_algorithms(observer, scene.algorithms)
    warnings = document.warnings if others is None else warn_of_others(others)
    for warning in warnings:
        observer.line(f"warning: {warning}")
    final_load = replaced(document.load, end=load_average(), others=others)
    observer.stage("write")
    results = {"warnings": warnings, "notes": notes, "scene": scene, "load": final_load}
    write_bench(replaced(document, **results), staging)
    return True


def _print_algorithms(observer: Observer, algorithms: Sequence[BenchAlgorithm]) -> None:
    width = max(len(algorithm.name) for algorithm in algorithms)
    for a in algorithms:
        wrong = "   –   " if a.wrong_source is None else f"{a.wrong_source:7.2%}"
        observer.line(
            f"{a.name:{width}}  {a.median_ms:9.2f} ms  {a.ratio:8.2f} kernel times  wrong "
            f"source {wrong}  EIA PSNR {a.scores['eia_psnr_db']:.2f} dB  view SSIM to reference "
            f"{a.scores['view_ssim_to_reference']:.4f}{'  *' if a.pareto else ''}"
        )


_VERSIONS = ("drjit", "matplotlib", "mitsuba", "numba", "numpy")
# Times are doubtful if other processes used more than this share of the cores before the start.
_BUSY = 0.25


def record(
    title: str, command: str, backend: Any, rounds: Rounds, load: float | None
) -> BenchDocument:
    """Create a document without results, final load and list of files.

    `command` is the command line that repeats it, `backend` is an
    `inim.system.backend.Backend`, and `load` is the `load_average` before anything was loaded.
    """
    return BenchDocument(
        title=title,
        **origin(command, _VERSIONS),
        backend=BackendRecord.of(backend),
        threads=thread_count(rounds.threads),
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


def warn_of_others(share: float) -> list[str]:
    """Warn if other processes used a share of the processors during the timed rounds."""
    if share <= DISTURBED:
        return []
    return [
        f"other programs used {share:.0%} of the processors during the measurement; the times are "
        "not comparable with others, and their ratios are less reliable; close them and repeat"
    ]


def warn_of_load(before: float | None) -> list[str]:
    """Warn if other processes were busy when the measurement began."""
    cores = os.cpu_count() or 1
    if before is None:
        return ["the load of this machine is unknown; the times may be those of a busy machine"]
    if before <= _BUSY * cores:
        return []
    return [
        f"the machine was busy: load average {before:.2f} on {cores} cores at the start; "
        "medians are less reliable than ratios and fastest runs; repeat it on an idle machine"
    ]
