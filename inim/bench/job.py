"""The bench of a scene as a command: checked, measured in a worker process, written whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from msgspec.structs import replace

from inim.bench.record import load_average, record
from inim.bench.scene import bench_scene, choose_algorithms, scene_plan
from inim.documents.bench import BenchAlgorithm
from inim.errors import UsageError
from inim.pipeline.plan import Plan
from inim.pipeline.request import repeated
from inim.pipeline.stages.scene import Renderer
from inim.pipeline.timing import Rounds, most_threads
from inim.process.observer import Observer
from inim.report.bench import write_bench
from inim.worker.output import publish, staging_folder
from inim.worker.supervisor import run_in_worker

_MARKER = "bench.json"
_FILES = (_MARKER, "bench.html", "bench.md")


@dataclass(frozen=True)
class BenchRequest:
    """What the user asked for; None and empty mean "as the scene says".

    Attributes
    ----------
    scene, out : Path
    definitions : tuple of str
        `key=value` overrides, as after -D.
    display, algorithms : str, optional
    runs, warmups : int
    threads : int, optional
        All there are if None.
    allow_folders : tuple of Path
        As of a validation.
    """

    scene: Path
    out: Path
    definitions: tuple[str, ...] = ()
    display: str | None = None
    algorithms: str | None = None
    runs: int = Rounds.runs
    warmups: int = Rounds.warmups
    threads: int | None = None
    allow_folders: tuple[Path, ...] = ()

    @property
    def rounds(self) -> Rounds:
        """How often everything runs, and on how many threads."""
        return Rounds(self.runs, self.warmups, self.threads)

    def plan(self) -> Plan:
        """The plan of a validation of the scene: its display, viewpoints and sampling."""
        return scene_plan(self.scene, self.out, self.definitions, self.display, self.allow_folders)

    def command(self) -> list[str]:
        """The command line that repeats this request."""
        words = ["python", "-m", "inim.bench", str(self.scene), "-o", str(self.out)]
        words += repeated("-D", self.definitions)
        words += repeated("--allow-folder", self.allow_folders)
        for name in ("display", "algorithms", "threads"):
            if getattr(self, name) is not None:
                words += [f"--{name}", str(getattr(self, name))]
        for name in ("runs", "warmups"):
            if getattr(self, name) != getattr(Rounds, name):
                words += [f"--{name}", str(getattr(self, name))]
        return words


def run_bench(request: BenchRequest, *, quiet: bool = True, debug: bool = False) -> None:
    """Measure in a worker process; `bench.json` and its kin are in `request.out` afterwards.

    Raises
    ------
    InimError
        What the worker raised, or `WorkerError` / `OutOfMemoryError` where it could not say.
        Mistakes in the request are found before anything is rendered.
    """
    run_in_worker(
        "inim.bench.job:work",
        (request, load_average()),  # before the worker starts to load: what others do
        staging_folder(request.out, _FILES),
        check=lambda: _check(request),
        backend="llvm",
        quiet=quiet,
        debug=debug,
    )


def _check(request: BenchRequest) -> None:
    """Raise the `InimError` that fits where a request cannot be carried out."""
    most = most_threads()
    if request.rounds.threads is not None and not 1 <= request.rounds.threads <= most:
        raise UsageError(f"--threads {request.threads}: this machine has 1 to {most}")
    request.plan()
    if request.algorithms is not None:
        choose_algorithms(request.algorithms)


def work(requested: tuple[BenchRequest, float | None], staging: Path, observer: Observer) -> bool:
    """The worker's side: measure, write, publish."""
    request, load = requested
    observer.stage("start")
    renderer = Renderer("llvm", observer)
    title = f"Bench: {request.scene.stem}"
    document = record(title, request.command(), renderer.backend, request.rounds, load)
    names, notes = choose_algorithms(request.algorithms)
    scene = bench_scene(request.plan(), names, request.rounds, renderer)
    _print_algorithms(observer, scene.algorithms)
    busy = replace(document.load, end=load_average())
    observer.stage("write")
    write_bench(replace(document, notes=notes, scene=scene, load=busy), staging)
    publish(staging, request.out, _MARKER)
    return True


def _print_algorithms(observer: Observer, algorithms: Sequence[BenchAlgorithm]) -> None:
    width = max(len(algorithm.name) for algorithm in algorithms)
    for a in algorithms:
        wrong = "   –   " if a.wrong_source is None else f"{a.wrong_source:7.2%}"
        observer.line(
            f"{a.name:{width}}  {a.median_ms:9.2f} ms  {a.ratio:8.2f} yardsticks  wrong "
            f"source {wrong}  EIA PSNR {a.scores['eia_psnr_db']:.2f} dB  view SSIM to ceiling "
            f"{a.scores['view_ssim_to_ceiling']:.4f}{'  *' if a.pareto else ''}"
        )
