"""A whole bench: everything asked for is measured, then written as data, table, page and plots."""

from __future__ import annotations

import os
import shlex
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from inim.bench.commands import bench_commands
from inim.bench.layers import bench_layers
from inim.bench.machine import load_average, warn_of_load
from inim.bench.paper import bench_paper
from inim.bench.request import BenchRequest, check_request, scene_plan
from inim.bench.scaling import bench_scaling
from inim.bench.scene import bench_scene, choose_algorithms
from inim.bench.views import bench_views
from inim.observer import Observer
from inim.pipeline.timing import most_threads
from inim.provenance import backend_data, versions
from inim.report.bench import SCHEMA, write_bench
from inim.version import __version__
from inim.worker.output import open_staging, publish
from inim.worker.supervisor import run_in_worker

__all__ = ["run_bench", "work"]

_MARKER = "bench.json"
_VERSIONS = ("drjit", "matplotlib", "mitsuba", "numba", "numpy", "scikit-image")


def run_bench(request: BenchRequest, *, quiet: bool = True, debug: bool = False) -> None:
    """Measure in a worker process; `bench.json` and its kin are in `request.out` afterwards.

    Raises
    ------
    InimError
        What the worker raised, or `WorkerError` / `OutOfMemoryError` where it could not say.
    """
    # Before the worker starts to load: what others do. Commands run with the user's environment.
    job = BenchJob(request, load_average(), dict(os.environ))
    run_in_worker(
        "inim.bench.job:work",
        job,
        lambda: open_staging(request.out),
        check=lambda: check_request(request),
        backend="llvm",
        quiet=quiet,
        debug=debug,
    )


@dataclass(frozen=True)
class BenchJob:
    """What the worker is given: the request, the load before it and the user's environment."""

    request: BenchRequest
    load: float | None
    environment: dict[str, str]


def work(job: BenchJob, staging: Path, observer: Observer) -> bool:
    """The worker's side: measure, write, publish."""
    data = _measured(job, staging, observer)
    observer.stage("write")
    write_bench(data, staging)
    publish(staging, job.request.out, _MARKER)
    return True


def _measured(job: BenchJob, staging: Path, listener: Any) -> dict[str, Any]:
    """The content of bench.json."""
    request, load = job.request, job.load
    listener.stage("start")
    from inim.render import variant

    backend = variant.use("llvm")
    thread_count = request.threads or most_threads()
    data = _record(request, backend, thread_count)
    data["warnings"] = warn_of_load(load)
    data["load"] = {"start": load, "cores": os.cpu_count()}
    data |= dict.fromkeys(("scaling", "paper", "views", "layers", "commands"))
    data |= {"contenders": [], "notes": []}
    if request.scene is not None:
        names, data["notes"] = choose_algorithms(request.algorithms)
        plan = scene_plan(request, request.scene)
        data |= bench_scene(plan, names, request.rounds, listener)
        _print_contenders(listener, data)
    if request.scaling:
        data["scaling"] = bench_scaling(request.rounds, listener)
    if request.paper:
        data["paper"] = bench_paper(request.rounds, listener)
        for claim in data["paper"]["claims"]:
            listener.line(f"{'yes' if claim['holds'] else 'NO '}  {claim['claim']}")
    if request.views:
        data["views"] = bench_views(request.rounds, listener)
    if request.layers:
        plans = [scene_plan(request, scene) for scene in request.layers]
        data["layers"] = bench_layers(plans, request.rounds, listener)
    if request.commands is not None:
        data["commands"] = bench_commands(
            scene_plan(request, request.commands),
            request.rounds,
            listener,
            folder=staging / "commands",
            variables=job.environment,
        )
    data["load"]["end"] = load_average()
    return data


def _record(request: BenchRequest, backend: Any, thread_count: int) -> dict[str, Any]:
    """What made it and how to make it again."""
    named = "layers" if request.layers else "synthetic pictures"
    named = f"commands on {request.commands.stem}" if request.commands else named
    named = request.scene.stem if request.scene else named
    return {
        "schema": SCHEMA,
        "title": f"Bench: {named}",
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "inim_version": __version__,
        "versions": versions(_VERSIONS),
        "command": shlex.join(["python", "-m", "inim.bench", *request.command()]),
        "backend": backend_data(backend),
        "threads": thread_count,
        "threading_layer": os.environ.get("NUMBA_THREADING_LAYER", "default"),
        "rounds": {"runs": request.runs, "warmups": request.warmups},
    }


def _print_contenders(listener: Any, data: dict[str, Any]) -> None:
    width = max(len(c["name"]) for c in data["contenders"])
    for c in data["contenders"]:
        wrong = "   –   " if c["wrong_source"] is None else f"{c['wrong_source']:7.2%}"
        listener.line(
            f"{c['name']:{width}}  {c['median_ms']:9.2f} ms  {c['ratio']:8.2f} yardsticks  wrong "
            f"source {wrong}  EIA PSNR {c['eia_psnr_db']:.2f} dB  view SSIM to ceiling "
            f"{c['view_ssim_to_ceiling']:.4f}{'  *' if c['pareto'] else ''}"
        )
