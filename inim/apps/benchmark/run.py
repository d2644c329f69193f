"""Submissions of algorithms of this project, or of another package, from the suite's inputs."""

import shutil
import time
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np

from inim.apps.benchmark.definition import TIERS
from inim.apps.benchmark.make import OPTIMAL, TRACED
from inim.apps.benchmark.submission import DESCRIPTION, OWN_AUTHORS, write_submission
from inim.apps.benchmark.suite import MadeCase, made_cases
from inim.generators import merge_cameras, parse_algorithm, prepare
from inim.image.files.eia_file import write_codes
from inim.image.rgbd import RGBD
from inim.pipeline.timing import to_srgb_rgba
from inim.system.backend import choose_backend
from inim.system.errors import UsageError
from inim.system.process.observer import Observer
from inim.system.worker.output import output_files
from inim.system.worker.supervisor import run_in_worker

#: The picture on the array's plane: every lens shows the same point, without parallax.
COPY = "copy"
#: The optimal EIA of the track `blind`, which knows the deviations.
OPTIMAL_BLIND = f"{OPTIMAL}-blind"
#: EIAs that `make` renders with the truth, by name: their files.
OF_TRUTH = {
    OPTIMAL: f"{OPTIMAL}-eia.png", OPTIMAL_BLIND: f"{OPTIMAL_BLIND}.png", TRACED: f"{TRACED}.png",
}  # fmt: skip
#: Algorithms of the board: as they come, with one ray and the nearest colour or four smooth ones,
#: the readings of the paper, and bounds.
BUILT_IN = (
    "template",
    "template:samples=1:colour=nearest",
    "gu2020",
    "gu2020:samples=4:colour=smooth",
    "li2012",
    "li2012:samples=4:colour=smooth",
    "wang2024",
    "wang2024:samples=4:colour=smooth",
    "wang2024:cells=consecutive",
    "wang2024:matching=ray",
    "wang2024:matching=ray:samples=4:colour=smooth",
    COPY,
    "cameras",
    TRACED,
    OPTIMAL,
    OPTIMAL_BLIND,
)
_FLAT = "template:samples=1"
_ROUNDS = 5


class RunJob(NamedTuple):
    """An algorithm to run on the cases of a suite."""

    algorithm: str
    cases: list[MadeCase]


def tracks_of(algorithm: str) -> tuple[str, ...]:
    """Tracks of an algorithm, by its input; raises `UsageError` for an input of no track."""
    if algorithm in OF_TRUTH:
        return ("blind",) if algorithm == OPTIMAL_BLIND else ("mesh",)
    if algorithm == COPY:
        return ("rgbd", "blind")
    reads = parse_algorithm(algorithm).input
    if reads is RGBD:
        return ("rgbd", "blind")
    if isinstance(reads, str):
        if reads != "5":
            raise UsageError(
                f"algorithm {algorithm!r}: reads {reads} pictures, and the track cameras has 5; "
                "use cameras:views=5"
            )
        return ("cameras",)
    raise UsageError(
        f"algorithm {algorithm!r}: reads {reads.__name__}, which is the input of no track; choose "
        "one that reads RGBD"
    )


def plan_run(algorithm: str, suite: Path) -> RunJob:
    """Check the algorithm and read the suite; raises an `InimError`."""
    tracks_of(algorithm)
    return RunJob(algorithm, made_cases(suite))


def run_algorithm(algorithm: str, suite: Path, out: Path, *, quiet: bool, debug: bool) -> None:
    """Run an algorithm on the inputs of a suite in a worker process, and write a submission."""
    names = [f"{name}.png" for name in TIERS["full"]]
    run_in_worker(
        f"{__name__}:run_job",
        lambda: plan_run(algorithm, suite),
        output_files(out, (DESCRIPTION, *names)),
        quiet=quiet,
        debug=debug,
    )


def run_job(job: RunJob, staging: Path, observer: Observer) -> bool:
    """Entry point in the worker: generate the EIAs, and write them with their description."""
    observer.begin([case.case.name for case in job.cases])
    seconds = {}
    for case in job.cases:
        name = case.case.name
        observer.stage(name)
        target = staging / f"{name}.png"
        if job.algorithm in OF_TRUTH:
            case.check("truth/")
            shutil.copyfile(case.folder / "truth" / OF_TRUTH[job.algorithm], target)
            continue
        codes, seconds[name] = _generate(job.algorithm, case)
        write_codes(target, codes, case.case.display.pixel_pitch_mm)
    write_submission(
        staging,
        name=job.algorithm,
        authors=OWN_AUTHORS,
        licence="BSD-3-Clause",
        tracks=list(tracks_of(job.algorithm)),
        seconds=seconds,
        hardware=choose_backend("llvm").device if seconds else "",
    )
    return True


def _generate(algorithm: str, case: MadeCase) -> tuple[np.ndarray, float]:
    """EIA of a case as sRGB codes, (rows, columns, 3) uint8, and the median of its run times."""
    display = case.case.display
    rgbd, cameras = case.pictures()
    if algorithm == COPY:
        depth = np.full(rgbd.shape, sum(display.depth_range_mm) / 2, np.float32)
        rgbd, algorithm = replace(rgbd, depth_mm=depth), _FLAT
    elif isinstance(parse_algorithm(algorithm).input, str):
        per_pitch = case.case.conditions["capture_pixels_per_pitch"]
        rgbd = merge_cameras(cameras, display, per_pitch)
    ready = to_srgb_rgba(rgbd)
    generator = prepare(display, algorithm, shape=ready.shape, pixel_mm=ready.pixel_mm)
    times = []
    for _ in range(_ROUNDS + 1):
        start = time.perf_counter()
        eia = generator.generate(ready)
        times.append(time.perf_counter() - start)
    codes = np.where(eia[..., 3:] > 0, eia[..., :3], np.uint8(0))
    return np.ascontiguousarray(codes), median(times[1:])
