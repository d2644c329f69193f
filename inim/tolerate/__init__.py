"""Tolerances of a display: random misalignments and their effect on the score.

`run_tolerance` is `inim tolerate`: it draws displays at random, validates them with a sweep, and
computes tolerances.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from inim.display.misalignment import misalignment_text
from inim.documents.display import FailedDisplay, ToleranceDocument
from inim.documents.parts import DisplayRecord, SceneFileRecord, origin
from inim.errors import SceneError, UsageError
from inim.generators import PICKUP
from inim.metrics import HEADLINE
from inim.pipeline.plan import Plan, make_plan
from inim.pipeline.request import Request
from inim.report.sweep import mean
from inim.report.tolerate import write_tolerance
from inim.settings import PREFIX
from inim.sweeps import SweepPlace, SweepPlan, compute_results, plan_study
from inim.sweeps.study import AS_SCENE, NamedDisplay, Study
from inim.tolerate.findings import aligned_score, parameter_tolerances
from inim.tolerate.study import ToleranceStudy, read_standard_errors, read_tolerance_study

# Settings that this command sets.
_OWN = ("misalign", "min_ssim_to_reference")
# Label of the display without misalignment.
_ALIGNED = "aligned"


@dataclass(frozen=True)
class ToleranceRequest:
    """Request for a tolerance run.

    The validation is that of the scene on the nominal display. Its single algorithm provides the
    EIA; the default is the ray-traced EIA, so that the misalignment alone causes the loss. `study`
    contains the distributions of the errors, and `criterion` is the largest tolerated loss of score
    relative to the aligned display. The accuracy of `calibration` is compared with the tolerances,
    and `command` is the command line, for the record.
    """

    validation: Request
    place: SweepPlace
    study: Path | None = None
    criterion: float = 0.01
    calibration: Path | None = None
    command: str = ""


def plan_tolerance(request: ToleranceRequest) -> SweepPlan:
    """Plan the sweep: finished and remaining validations. Writes no files."""
    plan = _design(request)
    study = read_tolerance_study(request.study, plan.display)
    return plan_study(_sweep(request, plan, _displays(study)), request.place)


def run_tolerance(
    request: ToleranceRequest, *, quiet: bool = True, debug: bool = False
) -> ToleranceDocument:
    """Draw displays, validate the missing ones with a sweep, and write the tolerances.

    The returned document is also written to the folder, with its page. It lists displays that
    failed; but if the aligned display fails, a `SceneError` is raised.
    """
    if not 0 < request.criterion < 1:
        raise UsageError(f"--criterion {request.criterion:g}: must be between 0 and 1")
    plan = _design(request)
    study = read_tolerance_study(request.study, plan.display)
    reached = {} if request.calibration is None else read_standard_errors(request.calibration)
    swept = _sweep(request, plan, _displays(study))
    # Run the aligned display first, alone: the others reuse its cached results.
    first = {_ALIGNED: swept.variations[_ALIGNED]}
    options = {"quiet": quiet, "debug": debug}
    aligned = compute_results(replace(swept, variations=first), request.place, **options)
    for why in aligned.failed.values():
        raise SceneError(f"{plan.request.scene}: as designed, it cannot be validated: {why}")
    outcome = compute_results(swept, request.place, **options)
    scores = _scores(outcome.rows)
    parameters, together = parameter_tolerances(study, scores, request.criterion, reached)
    document = ToleranceDocument(
        title=f"Tolerances: {plan.settings.title or plan.request.scene.stem}",
        **origin(request.command),
        scene=SceneFileRecord(path=str(plan.request.scene), sha256=plan.file.sha256),
        display=DisplayRecord.of(plan.display),
        viewpoints=[viewpoint.name for viewpoint in plan.viewpoints],
        algorithm=plan.methods[0].name,
        criterion=request.criterion,
        reach=study.reach,
        seed=study.seed,
        aligned=aligned_score(scores),
        parameters=parameters,
        together=together,
        failed=[FailedDisplay(display=name, error=why) for name, why in outcome.failed.items()],
    )
    write_tolerance(document, request.place.out)
    return document


def _design(request: ToleranceRequest) -> Plan:
    """Plan the validation of the display as designed."""
    validation = request.validation
    plan = make_plan(
        replace(
            validation,
            definitions={**_definitions(validation), f"{PREFIX}misalign": ""},
            algorithms=validation.algorithms or (PICKUP,),
        )
    )
    if len(plan.methods) != 1:
        names = ",".join(validation.algorithms or ())
        raise UsageError(f"--algorithms {names}: give a single algorithm")
    return plan


def _definitions(validation: Request) -> dict[str, str]:
    for key in _OWN:
        if f"{PREFIX}{key}" in validation.definitions:
            raise UsageError(f"-D {PREFIX}{key}: `inim tolerate` gives {key} itself; leave it out")
    return {**validation.definitions, f"{PREFIX}min_ssim_to_reference": ""}


def _displays(study: ToleranceStudy) -> list[str]:
    """Misalignments of the displays: none, then single parameters, then all together."""
    alone = [{name: error} for name in study.spreads for error in study.draw_alone(name)]
    return [
        misalignment_text(misalignment) for misalignment in ({}, *alone, *study.draw_together())
    ]


def _sweep(request: ToleranceRequest, plan: Plan, displays: Sequence[str]) -> Study:
    validation = request.validation
    definitions = _definitions(validation)
    return Study(
        validation.scene,
        plan.settings.title or validation.scene.stem,
        {validation.scene.stem: validation.scene},
        (NamedDisplay(AS_SCENE, validation.display),),
        tuple(method.name for method in plan.methods),
        {off or _ALIGNED: {**definitions, f"{PREFIX}misalign": off} for off in displays},
        validation.viewpoints,
        backend="auto",
        time=False,
        keep_reports=False,
        lazy=True,
    )


def _scores(rows: Sequence[Mapping[str, Any]]) -> dict[str, float | None]:
    """Mean score over the viewpoints by misalignment; None for a display that failed."""
    views: dict[str, list[Any]] = {}
    for row in rows:
        views.setdefault(row["misalign"], []).append(row.get(HEADLINE))
    return {off: mean(values) for off, values in views.items()}
