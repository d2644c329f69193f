"""Units: the validations of a study, each identified by its inputs.

A unit is one scene on one display with one set of settings; its algorithms and viewpoints share
the ground truth. Its key contains all inputs of the scores, and no path, name or time: equal keys
give equal results on every machine.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import inim
from inim.backend.choice import versions
from inim.errors import InimError
from inim.generators import PICKUP, is_own, parse_algorithm
from inim.metrics import foreign_identities
from inim.pipeline.plan import Plan, make_plan
from inim.pipeline.request import Request
from inim.plugins import identity
from inim.settings import PREFIX
from inim.sweep.study import Study
from inim.version import __version__

_VERSIONS = ("drjit", "flip-evaluator", "mitsuba", "numba", "numpy", "scikit-image")
# Settings that do not affect a score, or are in the key under another name.
_NOT_DECIDING = ("title", "algorithms", "viewpoints", "min_ssim_to_reference")
# Code that does not affect scores.
_NOT_SCORING = (
    "cli.py",
    "commands/",
    "report/",
    "bench/",
    "stress/",
    "sweep/",
    "tolerate/",
    "documents/",
    "views/",
)
_HASH_DIGITS = 16


@dataclass(frozen=True)
class Unit:
    """One validation of a study.

    `scene` and `display` are names in the table; `variation` contains the values of the settings
    that vary. The request has all algorithms of the study; its `out` is unused. A unit that cannot
    be validated has a one-line `error`, no plan, and an empty `hash` of its key.
    """

    scene: str
    display: str
    variation: str
    request: Request
    plan: Plan | None = None
    hash: str = ""
    error: str = ""

    @property
    def label(self) -> str:
        """Label on the screen."""
        return " · ".join(filter(None, (self.scene, self.display, self.variation)))

    def only(self, algorithms: Sequence[str]) -> Request:
        """Request for some of the algorithms, without the criteria of the others."""
        assert self.plan is not None
        limits = [f"{n}:{v!r}" for n, v in self.plan.ssim_limits.items() if n in algorithms]
        key = f"{PREFIX}min_ssim_to_reference"
        return replace(
            self.request,
            algorithms=tuple(algorithms),
            definitions={**self.request.definitions, key: ",".join(limits)},
        )


def expand(study: Study, out: Path, allow_folders: tuple[Path, ...] = ()) -> list[Unit]:
    """Expand a study to its units: scene by scene, display by display.

    `out` is the sweep's folder. If no unit can be validated, raises the error of the first one.
    """
    units = []
    for scene, path in study.scenes.items():
        for display in study.displays:
            for variation, definitions in study.variations.items():
                request = Request(
                    path,
                    out,
                    definitions=definitions,
                    display=display.display,
                    algorithms=study.algorithms,
                    viewpoints=study.viewpoints,
                    backend=study.backend,
                    time=study.time,
                    lazy=study.lazy,
                    allow_folders=allow_folders,
                )
                units.append(_unit(scene, display.name, variation, request))
    if all(unit.plan is None for unit in units):
        make_plan(units[0].request)
    return units


def _unit(scene: str, display: str, variation: str, request: Request) -> Unit:
    try:
        plan = make_plan(request)
    except InimError as error:
        return Unit(scene, display, variation, request, error=str(error))
    return Unit(scene, display, variation, request, plan, unit_hash(key_of(plan)))


def key_of(plan: Plan) -> dict[str, Any]:
    """Inputs of a validation's scores, except the algorithm, as JSON values."""
    settings = {k: v for k, v in asdict(plan.settings).items() if k not in _NOT_DECIDING}
    key = {
        "scene": plan.file.sha256,
        "parameters": plan.file.parameters,
        "settings": settings,
        "display": _nameless(plan.display.parameters()),
        "mounted": _nameless(plan.misaligned_display.parameters()),
        "viewpoints": [asdict(viewpoint) for viewpoint in plan.viewpoints],
        "backend": plan.request.backend,
        "time": plan.request.time,
        "versions": {"inim": __version__, **_versions()},
        "code": _own_code(),
    }
    if plan.request.lazy:
        key["lazy"] = True
    others = foreign_identities()
    if others:
        key["metrics"] = others
    record: dict[str, Any] = json.loads(json.dumps(key))
    return record


def _nameless(display: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in display.items() if key != "name"}


def unit_hash(key: Mapping[str, Any]) -> str:
    """Hash of a key: the first digits of its SHA-256."""
    text = json.dumps(key, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:_HASH_DIGITS]


def making_of(plan: Plan, algorithm: str) -> dict[str, Any]:
    """Further inputs of an algorithm's result: its criterion, and another package's code."""
    inputs: dict[str, Any] = {"min_ssim_to_reference": plan.ssim_limits.get(algorithm)}
    name = parse_algorithm(algorithm)[0]
    if is_own(name) or name == PICKUP:
        return inputs
    return inputs | identity("inim.generators", name)


@cache
def _versions() -> dict[str, str]:
    """Versions, cached because each lookup reads files of the packages."""
    return versions(_VERSIONS)


@cache
def _own_code() -> str:
    """SHA-256 of the code that affects scores, which may change without a new version."""
    root = Path(inim.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        name = path.relative_to(root).as_posix()
        if not name.startswith(_NOT_SCORING):
            digest.update(name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
