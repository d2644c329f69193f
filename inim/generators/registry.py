"""Registry of algorithms: their declarations, and algorithms chosen with options.

An algorithm is one file with one function, ``prepare(rays, options)``, which returns a function
that finds the sources of these rays in a picture (`PanelRays`, `SourceFinder`). A decorator
declares its options, a frozen dataclass (`inim.generators.options`), and its properties::

    @algorithm(Options, exact=True, samples="auto", color="#0072b2")
    def prepare(rays, options): ...

Algorithms in this folder are found by their files. Other packages register theirs in the
entry-point group ``inim.generators``::

    [project.entry-points."inim.generators"]
    mine = "my_package.eia:prepare"

They may also be a function ``prepare(display, shape, pixel_mm, **options)`` that returns a
`Generator`, with or without declared properties; keyword arguments are the options.

The files in this folder import no compiler and no renderer before `prepare` is called, so that
reading a declaration is fast.
"""

from __future__ import annotations

import inspect
import pkgutil
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar, cast

from inim.display.declaration import value_text
from inim.generators.options import CommonOptions, Option, choose_options, declared_options
from inim.image.rgbd import RGBD, CameraRGBDs, camera_directions
from inim.system.errors import UsageError, suggest_words
from inim.system.plugins import announced_names, attribute_errors, load

#: The algorithm of whoever names none; listed first.
DEFAULT = "template"
#: Ray tracing the scene itself, which a validation can score as it does the generators.
PICKUP = "pickup"
#: The EIA whose views come closest to the scene, which a validation can score as well.
OPTIMAL = "optimal"
#: Algorithms whose input is the scene itself.
SCENE_ALGORITHMS = (PICKUP, OPTIMAL)

_ENTRY_POINTS = "inim.generators"
# Parameter of another package's `prepare` that is not an option: a pixel mask.
_MASK = "mask"
# Attribute of a `prepare` that holds its declaration.
_DECLARATION = "__inim_algorithm__"

#: Input of an algorithm, captured from a scene: a type of picture, or an arrangement of cameras.
Input = type[RGBD] | str
Prepare = Callable[..., Any]
_AnyPrepare = TypeVar("_AnyPrepare", bound=Prepare)


@dataclass(frozen=True)
class Algorithm:
    """An algorithm with its options, from `parse_algorithm`; as text, the name with the options.

    Attributes
    ----------
    name : str
        Without the options.
    prepare : function
        See the module.
    finds_rays : bool
        True if `prepare` finds the sources of rays; False if it makes a `Generator`.
    options : object
        Its own options: an instance of the declared dataclass; or a mapping, for `prepare`.
    common : CommonOptions
        Options of all algorithms.
    own : bool
        It ships with inim.
    exact : bool
        By its definition it shows the first hit of every panel pixel's ray in the columns of the
        picture, or in those that its option `columns` names.
    portable : bool
        Its EIA depends on comparisons of stored numbers only: the same bits on every machine.
    reads : type
        Type of the pictures that it reads: `RGBD`; `LayeredRGBD`, for the surfaces behind the front
        as well (`inim.image.rgbd`); or `CameraRGBDs`, for the pictures of several cameras
        (`inim.image.rgbd`), which are merged for it.
    color, marker : str, optional
        Color and marker of its points in plots, as matplotlib names them.
    chosen_options : tuple of (str, value)
        Options that were chosen; the others have their defaults.
    """

    name: str
    prepare: Prepare
    finds_rays: bool = False
    options: Any = None
    common: CommonOptions = field(default_factory=CommonOptions)
    own: bool = False
    exact: bool = False
    portable: bool = False
    reads: type[RGBD | CameraRGBDs] = RGBD
    color: str | None = None
    marker: str | None = None
    chosen_options: tuple[tuple[str, Any], ...] = ()

    def __str__(self) -> str:
        return ":".join([self.name, *(f"{key}={value}" for key, value in self.chosen_options)])

    def __reduce__(self) -> tuple[Callable[..., Algorithm], tuple[Any, ...]]:
        return choose_algorithm, (self.name, dict(self.chosen_options))

    @property
    def own_options(self) -> tuple[Option, ...]:
        """Declarations of its own options."""
        if self.finds_rays:
            return tuple(declared_options(self.options))
        parameters = self._parameters.items()
        named = {n: p.default for n, p in parameters if p.kind is not p.VAR_KEYWORD and n != _MASK}
        return tuple(Option(name, default, "") for name, default in named.items())

    @property
    def _parameters(self) -> Mapping[str, inspect.Parameter]:
        """Parameters of another package's `prepare` after the size of the picture."""
        return dict(list(inspect.signature(self.prepare).parameters.items())[3:])

    @property
    def takes_mask(self) -> bool:
        """True if another package's `prepare` accepts a pixel mask."""
        return _MASK in self._parameters

    @property
    def summary(self) -> str:
        """The first line of `prepare`'s docstring."""
        return (inspect.getdoc(self.prepare) or "").partition("\n")[0]

    @property
    def columns(self) -> str:
        """Columns that its first hits are in; see `inim.generators.raycast.columns`."""
        return "layers" if self.reads is not RGBD else self._value("columns", "surface")

    @property
    def input(self) -> Input:
        """Form in which a scene is captured for it."""
        if self.reads is CameraRGBDs:
            return self._value("views", "5")
        return cast(type[RGBD], self.reads)

    def _value(self, name: str, default: str) -> str:
        """Value of one of its own options, if it has it."""
        if self.finds_rays:
            return str(getattr(self.options, name, default))
        defaults = {option.name: option.default for option in self.own_options}
        return str(self.options.get(name, defaults.get(name, default)))

    def choose(self, chosen_values: Mapping[str, Any]) -> Algorithm:
        """The algorithm with some options; raises `UsageError` for an unknown or invalid one."""
        shared = {option.name for option in declared_options(self.common)}
        names = [option.name for option in self.own_options]
        any_name = not self.finds_rays and any(
            p.kind is p.VAR_KEYWORD for p in self._parameters.values()
        )
        own: dict[str, Any] = {}
        common: dict[str, Any] = {}
        for key, value in chosen_values.items():
            if key in names:
                own[key] = value
            elif key in shared:
                common[key] = value
            elif any_name:
                own[key] = value
            else:
                every = [*names, *(n for n in vars(self.common) if n not in names)]
                raise UsageError(
                    f"algorithm {self.name!r} has no option {key!r}; its options are "
                    f"{', '.join(every)}; {suggest_words(key, every, 'use one of these')}"
                )
        chosen_algorithm = replace(self, chosen_options=tuple(chosen_values.items()))
        with chosen_algorithm.errors():
            options = choose_options(self.options, own, self.name) if self.finds_rays else own
        chosen = choose_options(self.common, common, self.name)
        if chosen.colour == "nearest" and "fill" not in common:
            chosen = replace(chosen, fill="none")  # the plain form shows its sources only
        chosen_algorithm = replace(chosen_algorithm, options=options, common=chosen)
        if self.reads is CameraRGBDs:
            camera_directions(str(chosen_algorithm.input))
        return chosen_algorithm

    def errors(self) -> AbstractContextManager[None]:
        """Name another package's algorithm in errors of the block; inim's own need none."""
        if self.own:
            return nullcontext()
        return attribute_errors(_ENTRY_POINTS, "algorithm", str(self))


def algorithm(
    options: type | None = None,
    *,
    exact: bool = False,
    portable: bool = False,
    reads: type[RGBD | CameraRGBDs] = RGBD,
    samples: str = "centre",
    colour: str = "nearest",
    fill: str = "none",
    color: str | None = None,
    marker: str | None = None,
) -> Callable[[_AnyPrepare], _AnyPrepare]:
    """Declare an algorithm; decorates `prepare`.

    Parameters
    ----------
    options : type, optional
        Frozen dataclass of its own options (`inim.generators.options`). With it, the function is
        ``prepare(rays, options)``; without, ``prepare(display, shape, pixel_mm, **options)``.
    samples, colour, fill : str
        Defaults of the options that all algorithms have (`CommonOptions`). With nearest colours,
        nothing is filled by default.
    exact, portable, reads, color, marker :
        See `Algorithm`.
    """

    def declare(prepare: _AnyPrepare) -> _AnyPrepare:
        declared = Algorithm(
            "", prepare, options is not None, {} if options is None else options(),
            CommonOptions(samples, colour, fill), False, exact, portable, reads, color, marker,
        )  # fmt: skip
        setattr(prepare, _DECLARATION, declared)
        return prepare

    return declare


@cache
def _built_in() -> dict[str, Algorithm]:
    """The algorithms of this folder, the default one first."""
    package = __name__.rpartition(".")[0]
    algorithms = {}
    for module in pkgutil.iter_modules([str(Path(__file__).parent)]):
        if not module.ispkg:
            prepare = getattr(import_module(f"{package}.{module.name}"), "prepare", None)
            declared = getattr(prepare, _DECLARATION, None)
            if declared is not None:
                algorithms[module.name] = replace(declared, name=module.name, own=True)
    return {
        name: algorithms[name]
        for name in sorted(algorithms, key=lambda name: (name != DEFAULT, name))
    }


def is_own(name: str) -> bool:
    """True if an algorithm, given without options, is built-in. Loads no other package."""
    return name in _built_in()


def is_optimal(name: str) -> bool:
    """True if a method, by its name with options, is the optimal EIA."""
    return name.partition(":")[0] == OPTIMAL


def algorithm_names() -> list[str]:
    """All algorithms there are: the project's own, then those that other packages announce."""
    others = announced_names(_ENTRY_POINTS)
    return [*_built_in(), *(n for n in others if n not in (*_built_in(), *SCENE_ALGORITHMS))]


def find_algorithm(name: str) -> Algorithm:
    """The algorithm of a name, with its defaults.

    Raises `UsageError` if it is unknown, announced twice, or announced and cannot be loaded.
    """
    if name in _built_in():
        return _built_in()[name]
    if name in SCENE_ALGORITHMS:
        raise UsageError(f"algorithm {name!r} needs the scene, not a picture: use `inim validate`")
    if name not in announced_names(_ENTRY_POINTS):
        raise UsageError(f"algorithm {name!r}: {suggest_words(name, algorithm_names())}")

    def define(prepare: Prepare) -> Algorithm:
        plain = Algorithm("", prepare, options={})
        declared = replace(getattr(prepare, _DECLARATION, plain), name=name)
        _ = declared.own_options  # its signature can be read
        return declared

    declared: Algorithm = load(_ENTRY_POINTS, name, "algorithm", define)
    return declared


def choose_algorithm(name: str, options: Mapping[str, Any]) -> Algorithm:
    """The algorithm of a name, with options; raises `UsageError` as `parse_algorithm`."""
    return find_algorithm(name).choose(options)


def parse_algorithm(text: str | Algorithm, **options: Any) -> Algorithm:
    """An algorithm with options, from ``name`` or ``name:key=value:key=value`` and further options.

    Those of inim's own algorithms load neither numba nor the renderer. Raises `UsageError` as
    `find_algorithm` and `split_algorithm`, and for an unknown or invalid option.
    """
    if isinstance(text, Algorithm):
        return text.choose({**dict(text.chosen_options), **options}) if options else text
    if not isinstance(text, str):
        raise UsageError(
            f"algorithm: is a {type(text).__name__}; give a name, and options as keywords, such as "
            'generate(..., "gu2020", samples=4)'
        )
    name, stated_options = split_algorithm(text)
    return choose_algorithm(name, {**stated_options, **options})


def algorithm_summary(name: str) -> tuple[str, str]:
    """Name of an algorithm with the defaults of all its options, and its docstring's first line.

    Raises `UsageError` as `find_algorithm`.
    """
    definition = find_algorithm(name)
    options = [
        *definition.own_options,
        *(declared_options(definition.common) if definition.own else ()),
    ]
    no_default = (inspect.Parameter.empty, None)
    defaults = {o.name: "..." if o.default in no_default else o.default for o in options}
    return ":".join(
        [name, *(f"{key}={value}" for key, value in defaults.items())]
    ), definition.summary


def split_algorithm(text: str) -> tuple[str, dict[str, str]]:
    """Name and options in a text, ``name`` or ``name:key=value:key=value``.

    Raises `UsageError` for an option without a value, or given twice.
    """
    name, *items = (part.strip() for part in text.split(":"))
    options: dict[str, str] = {}
    for item in items:
        key, equals, value = item.partition("=")
        if not (equals and key.strip() and value.strip()):
            raise UsageError(f"algorithm {text!r}: write options as name:key=value")
        if key.strip() in options:
            raise UsageError(f"algorithm {text!r}: option {key.strip()!r} is given twice; drop one")
        options[key.strip()] = value.strip()
    return name, options


def algorithm_items(algorithms: object) -> tuple[str, ...]:
    """Algorithms one by one, each a name with its options: ``template:samples=4``.

    `algorithms` are a text, separated at its commas, a mapping of options by name,
    ``{"template": {"samples": 4}, "wang2024": {}}``, or a sequence of these. Raises `UsageError`
    for another type.
    """
    if isinstance(algorithms, str):
        return tuple(item.strip() for item in algorithms.split(",") if item.strip())
    if isinstance(algorithms, Mapping):
        return tuple(_label(str(name), options) for name, options in algorithms.items())
    if isinstance(algorithms, list | tuple):
        return tuple(item for part in algorithms for item in algorithm_items(part))
    raise UsageError(
        f"algorithms: {algorithms!r} is a {type(algorithms).__name__}; give names such as "
        "'template:samples=4', a mapping of names to options, or a list of these"
    )


def _label(name: str, options: object) -> str:
    if not isinstance(options, Mapping):
        raise UsageError(
            f"algorithms[{name!r}]: is a {type(options).__name__}; give options as a mapping, "
            "which may be empty"
        )
    label = f"algorithms[{name!r}]"
    return ":".join([name, *(f"{key}={value_text(label, v)}" for key, v in options.items())])
