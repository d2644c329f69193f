"""Stress run: relations that hold for every correct result, over the whole chain.

`relation` has their form, `relations` the declarations by topic, `oracles` definitions in other
arithmetic, `jitter` the effect of small depth errors, which is measured only. `run_stress` is
`inim stress`.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from inim.apps.stress.document import Jitter, JitteredPicture, RelationResult, StressDocument
from inim.apps.stress.page import share_text, write_stress
from inim.display.lens import check_lens_model, lens_models
from inim.generators import algorithm_names, is_own, parse_algorithm
from inim.image.rgbd import RGBD
from inim.pipeline.plan import Plan, make_plan
from inim.pipeline.request import Request
from inim.pipeline.stages.capture import capture_nonempty
from inim.pipeline.stages.scene import Renderer
from inim.pipeline.stages.stage import Run
from inim.scores.document_parts import BackendRecord, origin
from inim.system.cache import computation_digests
from inim.system.errors import UsageError, suggest_words
from inim.system.process.observer import Observer
from inim.system.process.user_paths import user_text
from inim.system.worker.output import staging_folder
from inim.system.worker.supervisor import run_in_worker

if TYPE_CHECKING:
    from inim.apps.stress.relation import Relation

_FILES = ("stress.json", "stress.html", "stress.md", "growth.svg", "growth.png")
# Code that decides the results.
_CODE = (
    "inim/apps/stress", "inim/display", "inim/generators", "inim/image", "inim/render",
    "inim/scores",
)  # fmt: skip
_VERSIONS = ("drjit", "matplotlib", "mitsuba", "numba", "numpy")
# Default algorithms, in addition to those of other packages.
_DEFAULT = ("template", "template:columns=solid", "layered", "gu2020", "wang2024",
            "wang2024:matching=ray", "li2012")  # fmt: skip
# Lenses along each side of the display for jitter, by the quick mode.
_LENSES = {False: 64, True: 16}


@dataclass(frozen=True)
class StressRequest:
    """Request for a stress run.

    * `algorithms`, `lens_models`: subjects; if only one of them is given, nothing else is tested.
      By default, the whole chain is, with all algorithms and lens models.
    * `relations`: names of relations or topics; default: all.
    * `quick`: run fewer and smaller cases.
    * `validation`: its scene's depth is jittered; without one, that of two synthetic spheres.
    * `command`: the command line, for the record.
    """

    out: Path
    algorithms: tuple[str, ...] | None = None
    lens_models: tuple[str, ...] | None = None
    relations: tuple[str, ...] = ()
    quick: bool = False
    validation: Request | None = None
    command: str = ""

    def chosen_algorithms(self) -> list[str]:
        """Algorithms to run; raises `UsageError` for unknown or repeated ones."""
        if self.algorithms is None:
            if self.lens_models is not None:
                return []
            return [*_DEFAULT, *(n for n in algorithm_names() if not is_own(n))]
        for name in self.algorithms:
            parse_algorithm(name)
            if self.algorithms.count(name) > 1:
                raise UsageError(f"algorithm {name!r} is given twice; remove one")
        if not self.algorithms:
            raise UsageError("--algorithms: none given; name at least one, such as 'template'")
        return list(self.algorithms)

    def chosen_lens_models(self) -> list[str]:
        """Lens models to run; raises `UsageError` for unknown ones."""
        if self.lens_models is None:
            return [] if self.algorithms is not None else lens_models()
        from inim.display import DISPLAYS

        for name in self.lens_models:
            check_lens_model(name, DISPLAYS["nominal"])
        return list(self.lens_models)

    def chosen_relations(self) -> list[tuple[Relation, str]]:
        """Relations to check with their subjects; raises `UsageError` for unknown names."""
        from inim.apps.stress.relation import CHAIN, TOPICS, all_relations

        declared = all_relations()
        valid_names = [*TOPICS, *(relation.name for relation in declared)]
        for name in self.relations:
            if name not in valid_names:
                raise UsageError(f"--relations {name!r}: {suggest_words(name, valid_names)}")
        subjects = self.chosen_algorithms(), self.chosen_lens_models()
        of_chain = self.algorithms is None and self.lens_models is None
        return [
            (relation, subject)
            for relation in declared
            if not self.relations or {relation.name, relation.topic} & set(self.relations)
            if of_chain or relation.subjects != CHAIN
            for subject in relation.subjects_of(*subjects)
        ]

    def plan(self) -> Plan | None:
        """Check the request and plan its validation; None without a scene."""
        self.chosen_relations()
        if self.validation is None:
            return None
        return make_plan(replace(self.validation, algorithms=("template",)), of_scene=True)


def run_stress(request: StressRequest, *, quiet: bool = True, debug: bool = False) -> bool:
    """Measure in a worker process, and write `stress.json` and its pages to `request.out`.

    Returns True if every relation passed. Raises the `InimError` of the request or the worker.
    """
    return run_in_worker(
        "inim.apps.stress.run:run_job",
        lambda: (request, request.plan()),
        staging_folder(request.out, _FILES),
        quiet=quiet,
        debug=debug,
    )


def run_job(job: tuple[StressRequest, Plan | None], staging: Path, observer: Observer) -> bool:
    """Entry point in the worker: measure and write; True if every relation passed."""
    request, plan = job
    document = _measure(request, plan, observer)
    observer.stage("write")
    write_stress(document, staging)
    for line in verdict_lines(document.relations):
        observer.line(line)
    return document.passed


def verdict_lines(results: Sequence[RelationResult]) -> Iterator[str]:
    """One line per topic, and for each algorithm and lens model."""
    groups: dict[str, list[RelationResult]] = {}
    for result in results:
        groups.setdefault(result.subject or result.topic, []).append(result)
    for name, members in groups.items():
        binding = [m for m in members if not m.explained]
        broken = [m for m in binding if not m.passed]
        line = f"{len(binding)} relations, {len(broken)} broken"
        hits = next((m for m in members if m.relation == "first hits" and m.compared), None)
        if hits is not None:
            line += f"; {share_text(hits)}"
        yield f"{'FAILED' if broken else 'ok    '}  {name}: {line}"
        for member in broken:
            yield f"        {member.relation}: {member.message or _beyond(member)}"


def _beyond(result: RelationResult) -> str:
    worst = "infinite" if result.worst is None else f"{result.worst:.3g}"
    return f"{worst} {result.unit}, limit {result.limit:g}; {result.worst_case}"


def _measure(request: StressRequest, plan: Plan | None, observer: Observer) -> StressDocument:
    from inim.apps.stress.relation import FULL, QUICK, run_relation

    started, renderer = time.perf_counter(), Renderer("llvm", observer)
    observer.stage("start")
    chosen, names = request.chosen_relations(), request.chosen_algorithms()
    if any(relation.topic in ("rays", "views") for relation, _ in chosen):
        renderer.load()
    topics = list(dict.fromkeys(relation.topic for relation, _ in chosen))
    observer.begin([*topics, "jitter", "write"])
    results = []
    for topic in topics:
        observer.stage(topic)
        for relation, subject in chosen:
            if relation.topic == topic:
                results.append(run_relation(relation, subject, QUICK if request.quick else FULL))
    observer.stage("jitter")
    jitter: list[Jitter] = []
    picture: JitteredPicture | None = None
    if names and (plan is not None or not request.relations):
        jitter, picture = _jitter(request, plan, names, renderer, observer)
    return StressDocument(
        title="Stress" if plan is None else f"Stress: {plan.request.scene.stem}",
        **origin(request.command, _VERSIONS),
        code=computation_digests(_CODE),
        mode="quick" if request.quick else "full",
        backend=BackendRecord.of(renderer.backend),
        algorithms=names,
        lens_models=request.chosen_lens_models(),
        relations=results,
        jitter=jitter,
        picture=picture,
        passed=bool(results) and all(result.passed for result in results),
        seconds=time.perf_counter() - started,
        files=[],
    )


def _jitter(
    request: StressRequest,
    plan: Plan | None,
    names: Sequence[str],
    renderer: Renderer,
    observer: Observer,
) -> tuple[list[Jitter], JitteredPicture]:
    from inim.apps.stress.jitter import measure_jitter

    if plan is None:
        picture, display = spheres(_LENSES[request.quick])
        source = "two spheres"
    else:
        run, camera = Run(observer=observer), plan.camera(renderer)
        picture = capture_nonempty(camera, {RGBD}, run=run).rgbd
        display, source = plan.display, user_text(plan.request.scene)
    rows, columns = picture.shape
    return (
        measure_jitter(picture, display, names),
        JitteredPicture(name=source, rows=rows, columns=columns),
    )


def spheres(lenses: int) -> tuple[RGBD, Any]:
    """Two spheres in closed form, and the nominal display with `lenses` lenses along each side."""
    import numpy as np

    from inim.display import DISPLAYS
    from inim.image.color import linear_from_srgb
    from inim.render.scene_files.two_spheres import two_spheres

    display = DISPLAYS["nominal"].replace(lens_columns=lenses, lens_rows=lenses)
    ready = two_spheres(display, display.capture_shape(5), display.pitch_mm / 5)
    linear = linear_from_srgb(ready.color[..., :3] / np.float32(255))
    return replace(ready, color=linear), display
