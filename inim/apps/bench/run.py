"""Run time against error: the time and the errors of each algorithm on scenes.

All methods and a reference kernel run alternately in one loop (`inim.pipeline.timing`), on
display-ready pictures. Times are given in milliseconds and in kernel times: multiples of the
reference kernel's time, one 4-byte gather per display pixel. `run_bench` is `inim bench SCENE ...`:
it checks the request, measures in a worker process, and writes the results.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from inim.apps.bench.document import BenchDocument
from inim.apps.bench.evaluate import bench_errors, bench_scene
from inim.apps.bench.page import FILES, scene_lines, write_bench
from inim.display.settings import PREFIX
from inim.generators import parse_algorithm
from inim.pipeline.plan import Plan, make_plan
from inim.pipeline.request import Request
from inim.pipeline.timing import Rounds, thread_count
from inim.scores.document_parts import BackendRecord, origin
from inim.system.backend import choose_backend
from inim.system.cache import computation_digests
from inim.system.errors import UsageError
from inim.system.process.observer import Observer
from inim.system.worker.output import staging_folder
from inim.system.worker.supervisor import run_in_worker

# Code that decides the results.
_CODE = (
    "inim/apps/bench/evaluate.py", "inim/apps/bench/front.py", "inim/apps/bench/memory.py",
    "inim/display", "inim/generators", "inim/image", "inim/pipeline", "inim/render",
    "inim/scores/metrics", "inim/scores/regression/noise_free.py",
    "inim/scores/regression/scores.py",
)  # fmt: skip
_VERSIONS = ("drjit", "matplotlib", "mitsuba", "numba", "numpy")
#: Algorithms to time by default. The first seven are on equal terms.
DEFAULT = (
    "template:samples=1:colour=nearest",
    "template:samples=1:colour=nearest:columns=solid",
    "wang2024",
    "wang2024:matching=ray",
    "gu2020",
    "gu2020:step_mm=0.2",
    "li2012",
    "template:samples=1",
    "template:samples=2:colour=nearest",
    "template:samples=4:colour=nearest",
    "template",
)


@dataclass(frozen=True)
class BenchRequest:
    """Request for a bench run of one or several scenes.

    The algorithms of the validations, equal for all, are timed; their displays and sampling apply.
    `sizes` are settings, ``KEY=VALUE,...``; without any, each scene has its own size. `command` is
    the command line, for the record.
    """

    validations: tuple[Request, ...]
    sizes: tuple[str, ...] = ()
    rounds: Rounds = field(default_factory=Rounds)
    command: str = ""

    def plans(self) -> list[tuple[str, Plan]]:
        """Plan each scene at each size, and check the algorithms and the number of threads."""
        thread_count(self.rounds.threads)
        plans = []
        for validation in self.validations:
            algorithms = DEFAULT if validation.algorithms is None else validation.algorithms
            for name in algorithms:
                parse_algorithm(name)  # raises for those that need the scene
            for size in self.sizes or ("",):
                request = replace(
                    validation,
                    backend="llvm",
                    algorithms=algorithms,
                    definitions={**validation.definitions, **_settings_of(size)},
                )
                plans.append((size, make_plan(request, of_scene=True)))
        return plans


def _settings_of(size: str) -> Mapping[str, str]:
    """Definitions of a size, from ``KEY=VALUE,...``."""
    pairs = [item.partition("=") for item in size.split(",") if size]
    if not all(key and value for key, _, value in pairs):
        raise UsageError(
            f"--size {size!r}: write KEY=VALUE,..., such as lens_columns=32,lens_rows=32"
        )
    return {PREFIX + key.strip().removeprefix(PREFIX): value.strip() for key, _, value in pairs}


def run_bench(request: BenchRequest, *, quiet: bool = True, debug: bool = False) -> None:
    """Measure in a worker process, and write `bench.json` and its other forms.

    Raises the `InimError` of the request, before anything is rendered, or of the worker.
    """
    run_in_worker(
        "inim.apps.bench.run:run_job",
        lambda: (request, request.plans()),
        staging_folder(request.validations[0].out, FILES),
        quiet=quiet,
        debug=debug,
    )


def run_job(
    job: tuple[BenchRequest, list[tuple[str, Plan]]], staging: Path, observer: Observer
) -> bool:
    """Entry point in the worker: measure and write."""
    request, plans = job
    observer.stage("start")
    errors, scenes = bench_errors(), []
    for size, plan in plans:
        scenes.append(bench_scene(plan, size, request.rounds, observer))
        for line in scene_lines(errors, scenes[-1]):
            observer.line(line)
    observer.stage("write")
    names = dict.fromkeys(validation.scene.stem for validation in request.validations)
    document = BenchDocument(
        title=f"Bench: {', '.join(names)}",
        **origin(request.command, _VERSIONS),
        code=computation_digests(_CODE),
        backend=BackendRecord.of(choose_backend("llvm")),
        cores=os.cpu_count(),
        threads=thread_count(request.rounds.threads),
        threading_layer=os.environ.get("NUMBA_THREADING_LAYER", "default"),
        runs=request.rounds.runs,
        warmups=request.rounds.warmups,
        errors=errors,
        scenes=scenes,
        files=[],
    )
    write_bench(document, staging)
    return True
