"""`inim tolerate`: displays drawn at random, validated by the sweep, and what they say."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from inim.documents.parts import DisplayRecord
from inim.documents.record import SceneFile
from inim.documents.tolerate import FailedDisplay, ToleranceDocument
from inim.errors import SceneError, UsageError
from inim.metrics.headline import HEADLINE
from inim.pipeline.plan import Plan, make_plan
from inim.pipeline.request import Request, repeated
from inim.report.sweep.results import mean
from inim.report.tolerate import write_tolerance
from inim.settings import PREFIX
from inim.sweep.run import Place, SweepPlan, carry_out, plan_study
from inim.sweep.study import AS_SCENE, NamedDisplay, Study
from inim.tolerate.calibration import read_standard_errors
from inim.tolerate.findings import aligned_score, misalignment, parameter_tolerances
from inim.tolerate.study import ToleranceStudy, read_tolerance_study
from inim.version import __version__

# What this command itself gives: the error that is drawn, and a criterion of its own.
_OWN = ("misalign", "min_ssim_to_ceiling")
# On a screen, the display that is off by nothing.
_ALIGNED = "aligned"


@dataclass(frozen=True)
class ToleranceRequest:
    """What the user asked for.

    Attributes
    ----------
    scene : Path
    place : Place
    study : Path, optional
        What is drawn; see `inim.tolerate.study`.
    definitions : tuple of str
    display, viewpoints : str, optional
        As of a validation.
    algorithm : str
        Whose EIA, made for the design, is shown. By default the traced one: what is lost is then
        lost to the error alone.
    criterion : float
        How much less than the aligned display one may score.
    calibration : Path, optional
        `calibration.json` of what a calibration reaches.
    """

    scene: Path
    place: Place
    study: Path | None = None
    definitions: tuple[str, ...] = ()
    display: str | None = None
    viewpoints: str | None = None
    algorithm: str = "pickup"
    criterion: float = 0.01
    calibration: Path | None = None

    def command(self) -> str:
        """The command line that repeats this request."""
        words = ["inim", "tolerate", str(self.scene), *self.place.words()]
        words += repeated("-D", self.definitions)
        for name in ("study", "display", "viewpoints", "algorithm", "criterion", "calibration"):
            value = getattr(self, name)
            if value is not None and value != type(self).__dataclass_fields__[name].default:
                words += [f"--{name}", str(value)]
        return shlex.join(words)


def plan_tolerance(request: ToleranceRequest) -> SweepPlan:
    """What is there already and what would be run; nothing is written."""
    plan = _design(request)
    study = read_tolerance_study(request.study, plan.display)
    return plan_study(_sweep(request, plan, _displays(study)), request.place)


def run_tolerance(
    request: ToleranceRequest, *, quiet: bool = True, debug: bool = False
) -> ToleranceDocument:
    """Draw displays, let the sweep compute what is missing of them, and write the tolerances.

    Returns
    -------
    ToleranceDocument
        Also in the folder, with its page.

    Raises
    ------
    InimError
        What is wrong with scene, study or calibration, or the display as designed cannot be
        validated. Any other that cannot is in the list of what failed.
    """
    if not 0 < request.criterion < 1:
        raise UsageError(f"--criterion {request.criterion:g}: must lie between 0 and 1")
    plan = _design(request)
    study = read_tolerance_study(request.study, plan.display)
    reached = {} if request.calibration is None else read_standard_errors(request.calibration)
    swept = _sweep(request, plan, _displays(study))
    # Alone and first: all others find in the cache what they share with it.
    first = {_ALIGNED: swept.variations[_ALIGNED]}
    how = {"quiet": quiet, "debug": debug}
    aligned = carry_out(replace(swept, variations=first), request.place, **how)
    for why in aligned.failed.values():
        raise SceneError(f"{request.scene}: as designed, it cannot be validated: {why}")
    outcome = carry_out(swept, request.place, **how)
    scores = _scores(outcome.rows)
    parameters, together = parameter_tolerances(study, scores, request.criterion, reached)
    document = ToleranceDocument(
        title=f"Tolerances: {plan.settings.title or request.scene.stem}",
        created=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        inim_version=__version__,
        command=request.command(),
        scene=SceneFile(path=str(request.scene), sha256=plan.file.sha256),
        display=DisplayRecord.of(plan.display),
        viewpoints=[viewpoint.name for viewpoint in plan.viewpoints],
        algorithm=request.algorithm,
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
    """The validation of the display as designed, planned."""
    plan = make_plan(
        Request(
            request.scene,
            request.place.out,
            (*_definitions(request), f"{PREFIX}misalign="),
            request.display,
            algorithms=request.algorithm,
            viewpoints=request.viewpoints,
            allow_folders=request.place.allow_folders,
        )
    )
    if len(plan.methods) != 1:
        raise UsageError(f"--algorithm {request.algorithm}: name one; of several, run each")
    return plan


def _definitions(request: ToleranceRequest) -> tuple[str, ...]:
    for item in request.definitions:
        key = item.partition("=")[0].strip().removeprefix(PREFIX)
        if key in _OWN:
            raise UsageError(f"-D {item}: `inim tolerate` gives {key} itself; leave it out")
    return (*request.definitions, f"{PREFIX}min_ssim_to_ceiling=")


def _displays(study: ToleranceStudy) -> list[str]:
    """What each display is off by: none first, then one parameter after another, then all."""
    alone = [{name: error} for name in study.spreads for error in study.draw_alone(name)]
    return [misalignment(one) for one in ({}, *alone, *study.draw_together())]


def _sweep(request: ToleranceRequest, plan: Plan, displays: Sequence[str]) -> Study:
    given = _definitions(request)
    return Study(
        request.scene,
        plan.settings.title or request.scene.stem,
        {request.scene.stem: request.scene},
        (NamedDisplay(AS_SCENE, given=request.display),),
        tuple(method.name for method in plan.methods),
        {off or _ALIGNED: (*given, f"{PREFIX}misalign={off}") for off in displays},
        request.viewpoints,
        backend="auto",
        time=False,
        keep_reports=False,
        lazy=True,
    )


def _scores(rows: Sequence[Mapping[str, Any]]) -> dict[str, float | None]:
    """By misalignment, the mean over the viewpoints; None of a display that failed."""
    views: dict[str, list[Any]] = {}
    for row in rows:
        views.setdefault(row["misalign"], []).append(row.get(HEADLINE))
    return {off: mean(values) for off, values in views.items()}
