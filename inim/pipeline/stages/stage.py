"""What wraps a stage: result cache, timing, and what the report says was skipped.

A stage is a plain function from values to values. `stage` declares above it what it is called and
which code decides its result; the function itself knows nothing of that. What decides a result are
the stage's arguments: a dataclass by its fields, but for one called `name`, which is a label; a
handle by its `cache_key`; anything else by its value.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, Generic, ParamSpec, TypeVar

from inim import metrics
from inim.backend.choice import versions
from inim.cache import ResultCache, code_digest
from inim.process.observer import Observer

_Given = ParamSpec("_Given")
_Made = TypeVar("_Made")
# What was done, what was skipped, and why that is safe.
_Words = tuple[str, str, str]
#: These words, or what makes them of the samples traced and the arguments.
Describe = _Words | Callable[..., _Words]

_FOUND = (
    "read from the store",
    "all of it",
    "nothing that decides it has changed since it was made",
)


@dataclass(frozen=True)
class Code:
    """Code that decides a result: edited or in another version it makes other results.

    Attributes
    ----------
    places : tuple of str
        Paths below the package.
    packages : tuple of str
        Whose versions count.
    plugins : callable, optional
        What other packages add to it.
    """

    places: tuple[str, ...]
    packages: tuple[str, ...]
    plugins: Callable[[], dict[str, Any]] | None = None

    def key(self) -> dict[str, Any]:
        """Digests and versions."""
        found = {"program": code_digest(*self.places), "packages": versions(self.packages)}
        return found | ({} if self.plugins is None else {"plugins": self.plugins()})


_VALUES = ("image", "display", "scene")
RENDERING = Code(
    (
        "render",
        "lens",
        "files",
        "pipeline/stages/scene.py",
        "pipeline/stages/generate.py",
        *_VALUES,
    ),
    ("drjit", "mitsuba", "numpy", "OpenEXR", "trimesh"),
)
GENERATING = Code(
    (*RENDERING.places, "generators", "regression/fingerprints.py"),
    (*RENDERING.packages, "llvmlite", "numba"),
)
SCORING = Code(
    ("metrics", "image", "regression"),
    ("flip-evaluator", "numpy", "scikit-image", "scipy"),
    metrics.foreign_identities,
)


class SkippedSteps:
    """What a run did and what it skipped, as `skipped` of report.json."""

    def __init__(self, rows: Iterable[dict[str, str]] = ()) -> None:
        self.rows = [dict(row) for row in rows]

    def add(self, what: str, done: str, skipped: str, why: str) -> None:
        """Add a row; like ones are one row."""
        kind, _, name = what.partition(": ")
        for row in self.rows:
            alike = (row["done"], row["skipped"], row["why"]) == (done, skipped, why)
            if name and alike and row["what"].startswith(f"{kind}: "):
                row["what"] += f", {name}"
                return
        self.rows.append({"what": what, "done": done, "skipped": skipped, "why": why})


@dataclass(frozen=True)
class Run:
    """What stages run with.

    Attributes
    ----------
    cache : ResultCache
    observer : Observer
    skipped : SkippedSteps
        Of this round of samples.
    """

    cache: ResultCache = field(default_factory=ResultCache)
    observer: Observer = field(default_factory=Observer)
    skipped: SkippedSteps = field(default_factory=SkippedSteps)

    def for_round(self) -> Run:
        """The same for a round of samples: times go on adding up, what is skipped is its own."""
        return replace(self, skipped=SkippedSteps(self.skipped.rows))


class Stage(Generic[_Given, _Made]):
    """A stage with what wraps it; called with the function's arguments and ``run=``."""

    def __init__(
        self,
        function: Callable[_Given, _Made],
        name: str,
        code: Code,
        kinds: tuple[type, ...],
        timed: str | None,
        describe: Describe | None,
        follows: tuple[str, ...],
    ) -> None:
        functools.update_wrapper(self, function)
        self.function = function
        # Its own file decides its result, too.
        own = function.__module__.partition(".")[2].replace(".", "/") + ".py"
        self._code = replace(code, places=(*code.places, own))
        self._name, self._kinds = name, kinds
        self._timed, self._describe, self._follows = timed, describe, follows
        self._signature = inspect.signature(function)

    def __call__(self, *args: Any, run: Run, **named: Any) -> _Made:
        """The result: found, or made by the function."""
        bound = self._bound(*args, **named)
        call: Callable[..., _Made] = self.function
        name, before = self._name.format(**bound), run.observer.samples
        timed: AbstractContextManager[None] = nullcontext()
        if self._timed is not None:
            timed = run.observer.timed(self._timed.format(**bound))
        with timed:
            made, why = run.cache.find_or_make(
                name,
                lambda: self._parts(bound),
                lambda: call(**bound),
                self._kinds,
                explain=self._describe is not None,
            )
        if self._describe is not None and why is None:
            run.skipped.add(name, *_FOUND)
        elif self._describe is not None:
            words = self._describe
            if callable(words):
                words = words(run.observer.samples - before, **bound)
            done, skipped, safe = words
            run.skipped.add(name, f"{done} ({why})" if why else done, skipped, safe)
        result: _Made = made
        return result

    def is_known(self, *args: Any, run: Run, **named: Any) -> bool:
        """Whether a call would find its result; arguments that follow from others are left out."""
        bound = self._bound(*args, **named, **dict.fromkeys(self._follows))
        return run.cache.holds(self._name.format(**bound), self._parts(bound))

    def _bound(self, *args: Any, **named: Any) -> dict[str, Any]:
        bound = self._signature.bind(*args, **named)
        bound.apply_defaults()
        return dict(bound.arguments)

    def _parts(self, given: dict[str, Any]) -> dict[str, Any]:
        """All that decides the result, by names that people can read."""
        parts: dict[str, Any] = {}
        for name, value in given.items():
            if name in self._follows:
                continue
            if hasattr(value, "cache_key"):
                parts |= value.cache_key()
            elif is_dataclass(value) and not isinstance(value, type):
                shown = (f.name for f in fields(value) if f.name != "name")
                parts |= {f"{name} {one}": getattr(value, one) for one in shown}
            else:
                parts[name] = value
        return parts | self._code.key()


def stage(
    name: str,
    *,
    code: Code,
    makes: tuple[type, ...] = (),
    timed: str | None = None,
    describe: Describe | None = None,
    follows: tuple[str, ...] = (),
) -> Callable[[Callable[_Given, _Made]], Stage[_Given, _Made]]:
    """Declare a stage.

    Parameters
    ----------
    name : str
        Of its result in the cache and in the report, with arguments in braces:
        ``"true view: {viewpoint.name}"``.
    code : Code
        That decides its result, besides the function's own file.
    makes : tuple of type
        Dataclasses that its result is made of.
    timed : str, optional
        Under which name its time is reported; may be that of several stages.
    describe : three words, or a callable, optional
        What the report says was done, what was skipped and why that is safe; a callable makes it of
        the samples traced and the arguments. Without it the report says nothing.
    follows : tuple of str
        Arguments that follow from the others and so decide nothing.
    """

    def declare(function: Callable[_Given, _Made]) -> Stage[_Given, _Made]:
        return Stage(function, name, code, makes, timed, describe, follows)

    return declare
