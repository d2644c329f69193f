"""Options of algorithms, each declared once: a field of a frozen dataclass made by `option`.

Parsing, checks, `inim info algorithms` and the documentation derive from these declarations.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple, TypeVar

from inim.system.errors import UsageError, suggest_words

#: Converts the text or value of an option, by its name in messages; raises `UsageError`.
Convert = Callable[[str, Any], Any]
_Options = TypeVar("_Options")


def option(default: Any, meaning: str, convert: Convert) -> Any:
    """Declare an option as a field of a frozen dataclass: its default, meaning and checks."""
    return field(default=default, metadata={"meaning": meaning, "convert": convert})


def choice(default: str, meaning: str, *choices: str) -> Any:
    """Declare an option that is one of a few words."""
    words = ", ".join(choices)
    return option(default, f"{meaning} ({words})", lambda name, v: one_of(name, str(v), choices))


class Option(NamedTuple):
    """Declaration of an option; `meaning` is empty for other packages' keyword arguments."""

    name: str
    default: Any
    meaning: str


def declared_options(declared: Any) -> Iterator[Option]:
    """Options that a dataclass declares, with the defaults of an instance."""
    for entry in fields(declared):
        default = getattr(declared, entry.name, entry.default)
        yield Option(entry.name, default, entry.metadata["meaning"])


def choose_options(
    defaults: _Options, chosen_values: Mapping[str, Any], algorithm: str
) -> _Options:
    """Options of an algorithm: an instance of its dataclass, with the chosen values or texts.

    Raises `UsageError` for an invalid value.
    """
    convert = {entry.name: entry.metadata["convert"] for entry in fields(defaults)}  # type: ignore[arg-type]
    values = {
        key: convert[key](f"{algorithm}: {key}", value) for key, value in chosen_values.items()
    }
    return replace(defaults, **values)  # type: ignore[type-var]


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


@dataclass(frozen=True)
class NoOptions:
    """Options of an algorithm without any of its own."""


#: Values of `CommonOptions.fill` and `colour`.
FILLS = ("none", "hidden", "all", "auto")
COLOURS = ("nearest", "linear", "averaged", "smooth")


@dataclass(frozen=True)
class CommonOptions:
    """Options of every algorithm that finds sources (`inim.generators.steps`)."""

    samples: str = choice(
        "centre",
        "rays per panel pixel or sub-pixel, whose colours are averaged in linear light: through "
        "its centre; through two points on its diagonal; through the centres of its quarters; "
        "auto: as many as suit the layout; centre: one per pixel, for all its sub-pixels",
        "auto", "centre", "1", "2", "4",
    )  # fmt: skip
    colour: str = choice(
        "nearest",
        "colour of a ray: of the nearest picture pixel; interpolated; averaged over the footprint "
        "of the ray; averaged and interpolated",
        *COLOURS,
    )
    fill: str = choice(
        "none",
        "holes to fill: none; regions hidden by a surface or by the picture's edge; uncovered "
        "regions as well; auto: hidden in pictures that fill their frame, with other colours than "
        "nearest",
        *FILLS,
    )
