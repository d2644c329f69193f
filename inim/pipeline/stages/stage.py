"""Stages: the result cache, the timing and the record of skipped steps around plain functions.

A stage is a plain function from values to values. The decorator `stage` declares the name of its
result and the code that affects it. `deciding_inputs` builds its cache key from the arguments.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, fields, is_dataclass
from functools import partial
from typing import Any, Generic, ParamSpec, TypeVar

from inim.scores import metrics
from inim.system.cache import ResultCache, code_digest
from inim.system.process.observer import Observer
from inim.system.process.threads import OneThread

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")
# Work done, work skipped, and the reason why skipping is safe.
_Step = tuple[str, str, str]
#: A step, or a function of the samples traced and the arguments that returns one.
Describe = _Step | Callable[..., _Step]

_CACHED: _Step = ("read from the cache", "all of it", "its inputs and code are unchanged")
# The stages, which call each other, and the threads of all kernels.
_SHARED = ("pipeline/stages", "system/backend/kernels.py")


@dataclass(frozen=True)
class Code:
    """Code that affects a result: a change makes cached results invalid.

    `paths` are files and folders of the package, in addition to those that all stages share.
    `plugins` returns the identities of other packages' plugins.
    """

    paths: tuple[str, ...]
    plugins: Callable[[], dict[str, Any]] | None = None

    def key(self) -> dict[str, Any]:
        """Digests of the program's code, and identities of plugins."""
        key: dict[str, Any] = {"program": code_digest(*self.paths, *_SHARED)}
        return key | ({} if self.plugins is None else {"plugins": self.plugins()})


def deciding_inputs(code: Code, /, **values: Any) -> dict[str, Any]:
    """All inputs that decide a result, by readable names: the key of every cached result.

    A handle contributes its `cache_key`, a dataclass its fields except its label `name`, and any
    other value itself.
    """
    inputs: dict[str, Any] = {}
    for name, value in values.items():
        if hasattr(value, "cache_key"):
            inputs |= value.cache_key()
        elif is_dataclass(value) and not isinstance(value, type):
            names = (f.name for f in fields(value) if f.name != "name")
            inputs |= {f"{name} {field_name}": getattr(value, field_name) for field_name in names}
        else:
            inputs[name] = value
    return inputs | code.key()


RENDERING = Code(("render", "display", "image", "system/files.py", "system/row_bands.py"))
GENERATING = Code(
    (
        *RENDERING.paths,
        "generators",
        "scores/regression/fingerprints.py",
        "scores/regression/verdict.py",
    )
)
SCORING = Code(
    ("scores", "image", "display", "system/files.py", "system/row_bands.py"),
    metrics.foreign_identities,
)
#: Everything, for a whole report.
PROGRAM = Code(("",), metrics.foreign_identities)


class SkippedSteps:
    """Skipped steps of a run, as in report.json."""

    def __init__(self) -> None:
        self._details: dict[str, _Step] = {}

    def add(self, step: str, work: str, skipped: str, reason: str) -> None:
        """Add a step. In a later round of samples, it replaces that of the round before."""
        self._details[step] = work, skipped, reason

    def add_cached(self, step: str) -> None:
        """Add a step whose result is in the cache, unless this run stored it there."""
        self._details.setdefault(step, _CACHED)

    @property
    def rows(self) -> list[dict[str, str]]:
        """All steps; those that differ only in the name after the colon are one row."""
        rows: dict[tuple[str, _Step], list[str]] = {}
        for step, details in self._details.items():
            kind, colon, name = step.partition(": ")
            rows.setdefault((kind + colon, details), []).append(name)
        return [
            {"step": kind + ", ".join(names), "performed": work, "skipped": skipped, "why": reason}
            for (kind, (work, skipped, reason)), names in rows.items()
        ]


@dataclass(frozen=True)
class Run:
    """Services for the stages of a run.

    The thread `ahead` works for later stages, on all cores; the block `with run.ahead` ends it.
    """

    cache: ResultCache = field(default_factory=ResultCache)
    observer: Observer = field(default_factory=Observer)
    skipped: SkippedSteps = field(default_factory=SkippedSteps)
    ahead: OneThread = field(default_factory=partial(OneThread, "ahead"))


class CachedStage(Generic[_Arguments, _Result]):
    """A stage function with its cache; called with the function's arguments and ``run=``."""

    def __init__(
        self,
        function: Callable[_Arguments, _Result],
        name: str,
        code: Code,
        result_types: tuple[type, ...],
        timer: str | None,
        describe: Describe | None,
        derived: tuple[str, ...],
    ) -> None:
        functools.update_wrapper(self, function)
        self.function = function
        self._name, self._code, self._result_types = name, code, result_types
        self._timer, self._describe, self._derived = timer, describe, derived
        self._signature = inspect.signature(function)

    def __call__(self, *args: Any, run: Run, **kwargs: Any) -> _Result:
        """Return the cached result, or call the function and cache its result."""
        arguments = self._arguments(*args, **kwargs)
        call: Callable[..., _Result] = self.function
        name, samples = self._name.format(**arguments), run.observer.samples
        timer: AbstractContextManager[None] = nullcontext()
        if self._timer is not None:
            timer = run.observer.timed(self._timer.format(**arguments))
        with timer:
            result, reason = run.cache.find_or_make(
                name,
                lambda: self._key(arguments),
                lambda: call(**arguments),
                self._result_types,
                explain=self._describe is not None,
            )
        if self._describe is not None and reason is None:
            run.skipped.add_cached(name)
        elif self._describe is not None:
            step = self._describe
            if callable(step):
                step = step(run.observer.samples - samples, **arguments)
            work, *rest = step
            run.skipped.add(name, f"{work} ({reason})" if reason else work, *rest)
        typed_result: _Result = result
        return typed_result

    def is_cached(self, *args: Any, run: Run, **kwargs: Any) -> bool:
        """True if the cache holds the result; derived arguments may be omitted."""
        arguments = self._arguments(*args, **kwargs, **dict.fromkeys(self._derived))
        return run.cache.holds(self._name.format(**arguments), self._key(arguments))

    def _arguments(self, *args: Any, **kwargs: Any) -> dict[str, Any]:
        bound = self._signature.bind(*args, **kwargs)
        bound.apply_defaults()
        return dict(bound.arguments)

    def _key(self, arguments: dict[str, Any]) -> dict[str, Any]:
        """Cache key: all inputs except derived ones."""
        return deciding_inputs(
            self._code, **{k: v for k, v in arguments.items() if k not in self._derived}
        )


def stage(
    name: str,
    *,
    code: Code,
    result_types: tuple[type, ...] = (),
    timer: str | None = None,
    describe: Describe | None = None,
    derived: tuple[str, ...] = (),
) -> Callable[[Callable[_Arguments, _Result]], CachedStage[_Arguments, _Result]]:
    """Declare a stage.

    `name` is that of the result in the cache and in the report, with arguments in braces:
    ``"ground-truth view: {viewpoint.name}"``. `code` affects the result, and `result_types` are the
    dataclasses that the result contains. `timer` is the name of its time in the report; several
    stages may share one. `describe` gives the work done, the work skipped and the reason for the
    report, or is a function of the samples traced and the arguments that returns them; without it
    the report omits the stage. `derived` arguments follow from the others and are not part of the
    cache key.
    """

    def declare(function: Callable[_Arguments, _Result]) -> CachedStage[_Arguments, _Result]:
        return CachedStage(function, name, code, result_types, timer, describe, derived)

    return declare
