"""Registry of algorithms and their properties.

An algorithm is one file with one function, ``prepare(display, shape, pixel_mm, **options)``, which
returns a `Generator`. A decorator declares its properties::

    @algorithm(exact=True, color="#0072b2")
    def prepare(display, shape, pixel_mm, *, samples=1): ...

Algorithms in this folder are found by their files. Other packages register theirs in the
entry-point group ``inim.generators``, with the same function, with or without properties::

    [project.entry-points."inim.generators"]
    mine = "my_package.eia:prepare"

The files in this folder import no compiler and no renderer before `prepare` is called, so that
reading a property is fast.
"""

from __future__ import annotations

import inspect
import math
import pkgutil
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar, cast

from inim.display.declaration import value_text
from inim.generators.base import Generator
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
#: The parameter of a `prepare` that takes a pixel mask; not an option of the algorithm.
MASK = "mask"

#: Option of every algorithm that reports its sources: the filling of holes; see
#: `inim.generators.raycast.fill`.
FILL = "fill"
#: Values of `FILL`: leave holes black; fill regions hidden by a surface or by the picture's edge;
#: fill uncovered regions, too; "hidden" for pictures that fill their frame, otherwise "none".
FILLS = ("none", "hidden", "all", "auto")
#: Option of every algorithm that reports its sources: the colour of a ray, from the pixels around
#: its source; see `inim.generators.raycast.colour`.
COLOUR = "colour"
#: Values of `COLOUR`: the nearest pixel; interpolated; averaged over the footprint of a panel
#: pixel; averaged and interpolated.
COLOURS = ("nearest", "linear", "averaged", "smooth")
#: The parameter of a `prepare` that can leave holes where it shows what it only supposes; not an
#: option of the algorithm.
LEAVE_HOLES = "leave_holes"

_ENTRY_POINTS = "inim.generators"
# Attribute of a `prepare` that holds its declared properties.
_PROPERTIES = "__inim_algorithm__"

#: Option of algorithms that read several pictures: the cameras in front of a scene.
VIEWS = "views"

#: Input of an algorithm, captured from a scene: a type of picture, or an arrangement of cameras.
Input = type[RGBD] | str
Prepare = Callable[..., Generator]
_AnyPrepare = TypeVar("_AnyPrepare", bound=Prepare)


@dataclass(frozen=True)
class AlgorithmProperties:
    """Properties of an algorithm with some options.

    Attributes
    ----------
    exact : bool
        By its definition it shows the first hit of every panel pixel's ray in the columns of the
        picture, or in those that its option `columns` names.
    portable : bool
        Its EIA depends on comparisons of stored numbers only: the same bits on every machine.
    reads : type
        Type of the pictures that it reads: `RGBD`; `LayeredRGBD`, for the surfaces behind the front
        as well (`inim.image.rgbd`); or `CameraRGBDs`, for the pictures of several cameras
        (`inim.image.rgbd`), which are merged for it.
    views : str
        Arrangement of these cameras in front of a scene.
    colour, fill : str
        Defaults of its options `COLOUR` and `FILL`; with nearest colours, nothing is filled by
        default.
    color, marker : str, optional
        Color and marker of its points in plots, as matplotlib names them.
    name : str
        Without the options.
    own : bool
        It ships with inim.
    columns : str
        The columns that its first hits are in; see `inim.generators.raycast.columns`.
    takes_mask : bool
        It makes the pixels of a mask only; others are run in full and blackened.
    """

    exact: bool = False
    portable: bool = False
    reads: type[RGBD | CameraRGBDs] = RGBD
    colour: str = "nearest"
    fill: str = "none"
    color: str | None = None
    marker: str | None = None
    name: str = ""
    own: bool = False
    columns: str = "surface"
    takes_mask: bool = False
    views: str = ""

    @property
    def input(self) -> Input:
        """Form in which a scene is captured for it."""
        return self.views if self.reads is CameraRGBDs else cast(type[RGBD], self.reads)


def algorithm(
    *,
    exact: bool = False,
    portable: bool = False,
    reads: type[RGBD | CameraRGBDs] = RGBD,
    colour: str = "nearest",
    fill: str = "none",
    color: str | None = None,
    marker: str | None = None,
) -> Callable[[_AnyPrepare], _AnyPrepare]:
    """Declare the properties of an algorithm (see `AlgorithmProperties`); decorates `prepare`."""
    declared = AlgorithmProperties(exact, portable, reads, colour, fill, color, marker)

    def declare(prepare: _AnyPrepare) -> _AnyPrepare:
        setattr(prepare, _PROPERTIES, declared)
        return prepare

    return declare


@dataclass(frozen=True)
class Algorithm:
    """An algorithm by its name; `own` if it ships with inim.

    ``prepare(display, shape, pixel_mm, **options)`` makes a `Generator`.
    """

    name: str
    prepare: Prepare
    own: bool

    @property
    def options(self) -> tuple[inspect.Parameter, ...]:
        """Options after the name: the parameters of `prepare` from the fourth on."""
        parameters = list(inspect.signature(self.prepare).parameters.values())[3:]
        return tuple(p for p in parameters if p.name not in (MASK, LEAVE_HOLES))

    @property
    def takes_mask(self) -> bool:
        """True if `prepare` accepts a pixel mask."""
        return MASK in inspect.signature(self.prepare).parameters

    @property
    def summary(self) -> str:
        """The first line of `prepare`'s docstring."""
        return (inspect.getdoc(self.prepare) or "").partition("\n")[0]

    @property
    def leaves_holes(self) -> bool:
        """True if `prepare` can leave holes for a later fill."""
        return LEAVE_HOLES in inspect.signature(self.prepare).parameters

    def has_option(self, name: str) -> bool:
        """True if `prepare` has an option of this name."""
        return any(p.name == name for p in self.options)

    def check_options(self, options: Mapping[str, Any]) -> None:
        """Raise `UsageError` for an option that it does not have."""
        if any(p.kind is inspect.Parameter.VAR_KEYWORD for p in self.options):
            return
        names = [p.name for p in self.options]
        for key in options:
            if key not in (*names, FILL, COLOUR):
                has = f"its options are {', '.join(names)}" if names else "it has none"
                raise UsageError(f"algorithm {self.name!r} has no option {key!r}; {has}")

    def properties(self, options: Mapping[str, Any]) -> AlgorithmProperties:
        """Properties with some options."""
        declared = getattr(self.prepare, _PROPERTIES, None)
        if not isinstance(declared, AlgorithmProperties):
            declared = AlgorithmProperties()
        has_layers = declared.reads is not RGBD
        columns = "layers" if has_layers else str(options.get("columns", "surface"))
        views = ""
        if declared.reads is CameraRGBDs:
            default = {p.name: p.default for p in self.options}.get(VIEWS, "5")
            views = str(options.get(VIEWS, default))
            camera_directions(views)
        return replace(
            declared, name=self.name, own=self.own, columns=columns, takes_mask=self.takes_mask,
            views=views,
        )  # fmt: skip


@cache
def _built_in() -> dict[str, Algorithm]:
    """The algorithms of this folder, the default one first."""
    package = __name__.rpartition(".")[0]
    algorithms = {}
    for module in pkgutil.iter_modules([str(Path(__file__).parent)]):
        if not module.ispkg:
            prepare = getattr(import_module(f"{package}.{module.name}"), "prepare", None)
            if prepare is not None and hasattr(prepare, _PROPERTIES):
                algorithms[module.name] = Algorithm(module.name, prepare, own=True)
    return {
        name: algorithms[name]
        for name in sorted(algorithms, key=lambda name: (name != DEFAULT, name))
    }


def is_own(name: str) -> bool:
    """True if an algorithm, given without options, is built-in. Loads no other package."""
    return name in _built_in()


def foreign_errors(text: str) -> AbstractContextManager[None]:
    """Name another package's algorithm in errors of the block; inim's own algorithms need none."""
    if is_own(parse_algorithm(text)[0]):
        return nullcontext()
    return attribute_errors(_ENTRY_POINTS, "algorithm", text)


def is_optimal(name: str) -> bool:
    """True if a method, by its name with options, is the optimal EIA."""
    return name.partition(":")[0] == OPTIMAL


def algorithm_names() -> list[str]:
    """All algorithms there are: the project's own, then those that other packages announce."""
    others = announced_names(_ENTRY_POINTS)
    return [*_built_in(), *(n for n in others if n not in (*_built_in(), *SCENE_ALGORITHMS))]


def find_algorithm(name: str) -> Algorithm:
    """The algorithm of a name without options.

    Raises `UsageError` if it is unknown, announced twice, or announced and cannot be loaded.
    """
    if name in _built_in():
        return _built_in()[name]
    if name in SCENE_ALGORITHMS:
        raise UsageError(f"algorithm {name!r} needs the scene, not a picture: use `inim validate`")
    if name not in announced_names(_ENTRY_POINTS):
        raise UsageError(f"algorithm {name!r}: {suggest_words(name, algorithm_names())}")

    def define(prepare: Prepare) -> Algorithm:
        definition = Algorithm(name, prepare, own=False)
        _ = definition.options  # its signature can be read
        return definition

    definition: Algorithm = load(_ENTRY_POINTS, name, "algorithm", define)
    return definition


def properties(text: str) -> AlgorithmProperties:
    """Properties of an algorithm, ``name`` or ``name:key=value``.

    Those of inim's own algorithms load neither numba nor the renderer. Raises `UsageError` as
    `find_algorithm` and `parse_algorithm`.
    """
    name, options = parse_algorithm(text)
    return find_algorithm(name).properties(options)


def algorithm_summary(name: str) -> tuple[str, str]:
    """Name of an algorithm with the defaults of all its options, and its docstring's first line.

    Raises `UsageError` as `find_algorithm`.
    """
    definition = find_algorithm(name)
    no_default = (inspect.Parameter.empty, None)
    defaults = {p.name: "..." if p.default in no_default else p.default for p in definition.options}
    if definition.own:
        properties = definition.properties({})
        defaults |= {COLOUR: properties.colour, FILL: properties.fill}
    return ":".join([name, *(f"{key}={value}" for key, value in defaults.items())]), (
        definition.summary
    )


def parse_algorithm(text: str) -> tuple[str, dict[str, str]]:
    """An algorithm with options, ``name`` or ``name:key=value:key=value``.

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


def check_algorithm(text: str) -> None:
    """Raise `UsageError` unless an algorithm of that name exists and has those options."""
    name, options = parse_algorithm(text)
    find_algorithm(name).check_options(options)


def one_of(name: str, value: Any, choices: tuple[str, ...]) -> str:
    """The value of an option that is one of a few words; raises `UsageError` for any other."""
    if value not in choices:
        raise UsageError(f"{name} = {value!r}: {suggest_words(value, choices)}")
    return str(value)


def positive_mm(name: str, value: Any) -> float:
    """The value of an option that is a length, given as a number or as text.

    Raises `UsageError` unless it is positive and finite.
    """
    try:
        length = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        length = math.nan
    if not 0 < length < math.inf:
        raise UsageError(f"{name} = {value!r}: it must be a positive length in mm")
    return length
