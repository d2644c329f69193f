"""Relations: declared claims that hold for every correct result, without stored numbers.

A relation is a function with `@relation(...)`. It yields the deviation of each of its cases, in
multiples of a unit, and holds if none exceeds the limit. Quick and full runs differ in one number,
the effort, that decides the number and the size of the cases.
"""

import importlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from msgspec.structs import replace

from inim.apps.stress.document import GrowthPoint, RelationResult
from inim.system.errors import InimError

#: Effort of a quick and of a full run.
QUICK, FULL = 1, 4
#: Topics in the order of the chain, a module of `inim.apps.stress.relations` each.
TOPICS = (
    "displays", "rays", "generators", "lenses", "colours", "pictures", "views", "scores",
    "statistics",
)  # fmt: skip
#: What a relation is about: the chain itself, or each algorithm or lens model.
CHAIN, ALGORITHMS, LENS_MODELS = "chain", "algorithms", "lens models"


@dataclass(frozen=True)
class Deviation:
    """Result of one case of a relation."""

    case: str
    worst: float  #: Largest deviation in the relation's unit; NaN and infinity never pass.
    compared: int = 1  #: Numbers, rays or pixels that were compared.
    broken: int = 0  #: Pixels or rays that differ, also where rounding decides.
    position: float | None = None  #: Value of the parameter along which errors grow.
    farthest: float = 0.0  #: Distance of the farthest wrong source, in picture pixels.
    warned: bool = False  #: A validation warns of this display: the limit does not apply.


#: Yields the deviations of a subject, an algorithm or a lens model, for an effort.
Check = Callable[[str, int], Iterator[Deviation]]


@dataclass(frozen=True)
class Relation:
    """A declared claim; `check` has the claim in the first line of its docstring.

    Attributes
    ----------
    covers : tuple of str
        Modules whose faults it can find; a package stands for all of its modules.
    limit, unit : float, str
        Largest deviation, and its unit.
    source : str
        Where the limit comes from.
    subjects : str or tuple of str
        `CHAIN`, `ALGORITHMS`, `LENS_MODELS`, or names of those.
    axis : str
        Parameter of `Deviation.position`: the run's page shows the growth of the error along it.
    explain : callable
        From a subject to the reason why the relation need not hold for it; empty if it must; None
        if the relation does not apply.
    """

    name: str
    topic: str
    check: Check
    covers: tuple[str, ...]
    limit: float
    unit: str
    source: str
    subjects: str | tuple[str, ...] = CHAIN
    axis: str = ""
    explain: Callable[[str], str | None] = lambda _: ""

    @property
    def claim(self) -> str:
        """The claim in words."""
        return (self.check.__doc__ or "").partition("\n")[0]

    def subjects_of(self, algorithms: Sequence[str], lens_models: Sequence[str]) -> list[str]:
        """Subjects of a run to which it applies; one empty name for the chain itself."""
        if self.subjects == CHAIN:
            return [""]
        named = lens_models if self.subjects == LENS_MODELS else algorithms
        if isinstance(self.subjects, tuple):
            return [name for name in (*algorithms, *lens_models) if name in self.subjects]
        return [name for name in named if self.explain(name) is not None]

    def reaches(self, module: str) -> bool:
        """True if it can find faults of a module such as ``inim.display.pixels``."""
        return any(
            module == covered or module.startswith(f"{covered}.")
            for covered in (f"inim.{name}" for name in self.covers)
        )


_REGISTERED: list[Relation] = []


def relation(
    name: str, *, covers: str, limit: float, unit: str, source: str, **more: Any
) -> Callable[[Check], Check]:
    """Declare a relation; `covers` are names below ``inim``, separated by spaces."""

    def register(check: Check) -> Check:
        topic = check.__module__.rpartition(".")[2]
        modules = tuple(covers.split())
        _REGISTERED.append(Relation(name, topic, check, modules, limit, unit, source, **more))
        return check

    return register


@cache
def all_relations() -> tuple[Relation, ...]:
    """All relations, in the order of the chain."""
    for topic in TOPICS:
        importlib.import_module(f"inim.apps.stress.relations.{topic}")
    return tuple(sorted(_REGISTERED, key=lambda declared: TOPICS.index(declared.topic)))


def run_relation(declared: Relation, subject: str, effort: int) -> RelationResult:
    """Check a relation of a subject."""
    started = time.perf_counter()
    result = RelationResult(
        relation=declared.name,
        topic=declared.topic,
        subject=subject,
        claim=declared.claim,
        limit=declared.limit,
        unit=declared.unit,
        source=declared.source,
        explained=declared.explain(subject) or "",
        cases=0,
        compared=0,
        broken=0,
        largest_share=0.0,
        worst=None,
        worst_case="",
        farthest=0.0,
        axis=declared.axis,
        growth=[],
        message="",
        seconds=0.0,
        passed=False,
    )
    try:
        deviations = list(declared.check(subject, effort))
    except InimError as error:
        return replace(result, message=str(error))
    except Exception as error:
        return replace(result, message=" ".join(f"{type(error).__name__}: {error}".split())[:300])
    binding = [d for d in deviations if not d.warned]
    worst = max(binding, key=lambda d: _size(d.worst), default=None)
    is_within = worst is not None and _size(worst.worst) <= declared.limit
    return replace(
        result,
        cases=len(deviations),
        compared=sum(d.compared for d in deviations),
        broken=sum(d.broken for d in deviations),
        largest_share=max((d.broken / max(d.compared, 1) for d in deviations), default=0.0),
        worst=_size(worst.worst) if worst else None,
        worst_case=worst.case if worst else "",
        farthest=max((d.farthest for d in deviations), default=0.0),
        growth=[
            GrowthPoint(position=d.position, worst=_size(d.worst), warned=d.warned)
            for d in deviations
            if d.position is not None
        ],
        seconds=time.perf_counter() - started,
        passed=is_within or bool(result.explained),
    )


def _size(worst: float) -> float:
    """A deviation; infinite if it is not a number."""
    return float("inf") if np.isnan(worst) else float(worst)


def difference(case: str, actual: Any, expected: Any, unit: Any = 1.0, **more: Any) -> Deviation:
    """Largest difference of two arrays in multiples of a unit.

    Equal infinities do not differ. Different shapes, whole numbers that are not equal, and a NaN in
    one of them, differ infinitely.
    """
    a, b = (np.asarray(values) for values in (actual, expected))
    if a.shape != b.shape:
        return Deviation(case, np.inf, a.size, a.size, **more)
    if not a.size:
        return Deviation(case, 0.0, 0, **more)
    if "f" not in a.dtype.kind + b.dtype.kind:
        return Deviation(case, 0.0 if (a == b).all() else np.inf, a.size, **more)
    real = np.longdouble
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        far = np.abs(a.astype(real) - b.astype(real)) / np.asarray(unit, real)
    far = np.where((a == b) | (np.isnan(a) & np.isnan(b)), 0, far)
    broken = int(np.count_nonzero(far))
    return Deviation(case, float(np.nan_to_num(far, nan=np.inf).max()), a.size, broken, **more)


def excess(case: str, values: Any, bound: Any, **more: Any) -> Deviation:
    """Largest excess of values over an upper bound; 0 if all are within it."""
    over = np.asarray(values, float) - np.asarray(bound, float)
    return Deviation(case, float(np.max(over, initial=0.0)), over.size, **more)


def is_true(case: str, statement: Any, compared: int = 1) -> Deviation:
    """0 for a true statement, infinite for a false one."""
    return Deviation(case, 0.0 if bool(np.all(statement)) else np.inf, compared)


#: Rounding error of float64 and of float32.
EPS, EPS32 = float(np.finfo(np.float64).eps), float(np.finfo(np.float32).eps)
