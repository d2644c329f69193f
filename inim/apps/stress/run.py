"""Stress: where an algorithm's numbers are worst, for anybody's algorithm.

Each is compared with the exact first hits of displays and pictures that are hard on arithmetic, and
with itself when its depth is off by a little (`checks`), and checked by relations that need no
oracle (`relations`). The project's own study of its generators and lens models, from which the
limits of `inim.generators.accuracy_limits` are taken, is `reports/stress/study`. `run_stress` is
`inim stress`.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from inim.apps.stress.document import (
    Claim,
    FirstHitsResult,
    JitteredPicture,
    RelationResult,
    StressDocument,
)
from inim.apps.stress.page import write_stress
from inim.generators import algorithm_names, is_own, parse_algorithm
from inim.image.rgbd import RGBD
from inim.pipeline.plan import Plan, make_plan
from inim.pipeline.request import Request
from inim.pipeline.stages.capture import capture_nonempty
from inim.pipeline.stages.scene import Renderer
from inim.pipeline.stages.stage import Run
from inim.scores.document_parts import BackendRecord, origin
from inim.system.errors import UsageError
from inim.system.process.observer import Observer
from inim.system.process.user_paths import user_text
from inim.system.worker.output import staging_folder
from inim.system.worker.supervisor import run_in_worker

_FILES = ("stress.json", "stress.html", "stress.md")
_VERSIONS = ("drjit", "matplotlib", "mitsuba", "numba", "numpy")
# Default algorithms, in addition to those of other packages.
_DEFAULT = ("template", "layered", "gu2020", "wang2024", "wang2024:matching=ray", "li2012")
# Lenses along each side of the display for jitter, by the quick mode.
_LENSES = {False: 32, True: 16}


@dataclass(frozen=True)
class StressRequest:
    """Request for a stress run; `quick` runs fewer and smaller cases.

    By default, all algorithms are tested. The depth of the validation's scene is jittered; without
    one, that of two synthetic spheres. `command` is the command line, for the record.
    """

    out: Path
    algorithms: tuple[str, ...] | None = None
    quick: bool = False
    validation: Request | None = None
    command: str = ""

    def chosen_algorithms(self) -> list[str]:
        """Algorithms to run; raises `UsageError` for unknown or repeated ones."""
        if self.algorithms is None:
            return [*_DEFAULT, *(n for n in algorithm_names() if not is_own(n))]
        for name in self.algorithms:
            parse_algorithm(name)
            if self.algorithms.count(name) > 1:
                raise UsageError(f"algorithm {name!r} is given twice; remove one")
        if not self.algorithms:
            raise UsageError("--algorithms: none given; name at least one, such as 'template'")
        return list(self.algorithms)

    def plan(self) -> Plan | None:
        """Check the request and plan its validation; None without a scene."""
        self.chosen_algorithms()
        if self.validation is None:
            return None
        return make_plan(replace(self.validation, algorithms=("template",)), of_scene=True)


def run_stress(request: StressRequest, *, quiet: bool = True, debug: bool = False) -> bool:
    """Measure in a worker process, and write `stress.json` and its pages to `request.out`.

    Returns True if every check passed. Raises the `InimError` of the request or the worker.
    """
    return run_in_worker(
        "inim.apps.stress.run:run_job",
        lambda: (request, request.plan()),
        staging_folder(request.out, _FILES),
        quiet=quiet,
        debug=debug,
    )


def run_job(job: tuple[StressRequest, Plan | None], staging: Path, observer: Observer) -> bool:
    """Entry point in the worker: measure and write; True if every check passed."""
    request, plan = job
    document = _measure(request, plan, observer)
    observer.stage("write")
    write_stress(document, staging)
    for check in document.checks:
        word = "ok    " if check.passed else "FAILED"
        observer.line(f"{word}  {check.name}: {check.cases} cases, {check.broken} broken")
    return document.passed


def _measure(request: StressRequest, plan: Plan | None, observer: Observer) -> StressDocument:
    from inim.apps.stress.checks import cases, check_first_hits, measure_jitter
    from inim.apps.stress.relations import run_relations

    started, renderer = time.perf_counter(), Renderer("llvm", observer)
    observer.stage("start")
    names = request.chosen_algorithms()
    parts = [f"{name}: {part}" for name in names for part in ("first hits", "relations")]
    observer.begin([*parts, "jitter", "write"])
    first_hits: list[FirstHitsResult] = []
    relations: list[RelationResult] = []
    for name in names:
        observer.stage(f"{name}: first hits")
        first_hits += [check_first_hits(name, case) for case in cases(request.quick)]
        observer.stage(f"{name}: relations")
        relations += run_relations([name])
    observer.stage("jitter")
    if plan is None:
        picture, display = spheres(_LENSES[request.quick])
        source = "two spheres"
    else:
        run, camera = Run(observer=observer), plan.camera(renderer)
        picture = capture_nonempty(camera, {RGBD}, run=run).rgbd
        display, source = plan.display, user_text(plan.request.scene)
    jitter = measure_jitter(picture, display, names)
    checks = _checks(names, first_hits, relations)
    return StressDocument(
        title="Stress" if plan is None else f"Stress: {plan.request.scene.stem}",
        **origin(request.command, _VERSIONS),
        mode="quick" if request.quick else "full",
        backend=BackendRecord.of(renderer.backend),
        algorithms=names,
        first_hits=first_hits,
        relations=relations,
        jitter=jitter,
        picture=JitteredPicture(name=source, rows=picture.shape[0], columns=picture.shape[1]),
        checks=checks,
        passed=all(check.passed for check in checks),
        seconds=time.perf_counter() - started,
        files=[],
    )


def _checks(
    names: Sequence[str], first_hits: Sequence[FirstHitsResult], relations: Sequence[RelationResult]
) -> list[Claim]:
    """The claims of the verdict, two for each algorithm."""
    claims = []
    for name in names:
        hits = [row for row in first_hits if row.algorithm == name]
        unexplained = [row for row in relations if row.algorithm == name and not row.explained]
        exact = any(row.exact for row in hits)
        shows = "every pixel shows the exact first hit" if exact else "nothing crashes"
        for label, passed in (
            (shows, [row.passed for row in hits]),
            ("relations hold but for rounding", [row.passed for row in unexplained]),
        ):
            claims.append(
                Claim(
                    name=f"{name}: {label}",
                    cases=len(passed),
                    broken=passed.count(False),
                    passed=bool(passed) and all(passed),
                )
            )
    return claims


def spheres(lenses: int) -> tuple[RGBD, Any]:
    """Two spheres in closed form, and the nominal display with `lenses` lenses along each side."""
    from inim.display import DISPLAYS
    from inim.image.color import linear_from_srgb
    from inim.render.scene_files.two_spheres import two_spheres

    display = DISPLAYS["nominal"].replace(lens_columns=lenses, lens_rows=lenses)
    ready = two_spheres(display, display.capture_shape(5), display.pitch_mm / 5)
    linear = linear_from_srgb(ready.color[..., :3] / np.float32(255))
    return replace(ready, color=linear), display
