"""Declarations of parameters and settings: type, default, range and meaning, each once.

A field of a dataclass has its type, with its valid `Values`; its default; and its meaning, the
`#:` comment behind it or above it. Its name ends with the unit. Checks, the reading of text, the
table of settings, completion and the descriptions in JSON Schemas are derived from it.
"""

import math
import re
import types
from collections.abc import Callable, Collection, Sequence
from dataclasses import MISSING, dataclass, fields
from functools import cache
from numbers import Integral, Real
from os import PathLike
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from inim.system.errors import UsageError
from inim.system.field_comments import field_comments

#: Text of rows that are empty, and of an optional number that is not set.
NOT_SET = "none"
# Far above any sensible length, count or seed, and far below where arithmetic overflows.
_LARGEST = 1e18
# Whole numbers below this are written without a decimal point: counts are read as whole numbers.
_EXACT = 1e15
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+")


@dataclass(frozen=True, kw_only=True, eq=False)
class Values:
    """Valid values of a field.

    * `above`, `low`, `below`, `high`: ends of the range, without or with the end itself.
    * `requirement`: clause of the error for a number outside the range, if there is a better one.
    * `words`: valid words, if they are not those of the type.
    * `rows`: function that reads rows of numbers, from rows or from text; raises `ValueError`.
    """

    above: float = -math.inf
    low: float = -math.inf
    below: float = math.inf
    high: float = math.inf
    requirement: str = ""
    words: Collection[str] = ()
    rows: Callable[[Any], tuple[Any, ...]] | None = None

    def check_range(self, number: float) -> None:
        """Raise `ValueError` with the requirement for a number outside the range."""
        for words, end, is_inside in (
            ("above", self.above, number > self.above),
            ("at least", self.low, number >= self.low),
            ("below", self.below, number < self.below),
            ("at most", self.high, number <= self.high),
        ):
            if not is_inside:
                raise ValueError(self.requirement or f"must be {words} {end:.7g}")


@dataclass(frozen=True)
class Declared:
    """A declared field.

    `name` is for messages. `type` is its type; `kinds` are those of its values, without None if it
    `is_optional`.
    """

    name: str
    type: Any
    kinds: tuple[Any, ...]
    is_optional: bool
    default: Any
    values: Values

    @property
    def is_number(self) -> bool:
        """True for numbers, also optional ones."""
        return bool({int, float} & {*self.kinds})

    def read(self, text: str) -> Any:
        """Value in a text, as after ``-D``; raises `ValueError` for text that is no number."""
        if not self.is_number:
            return text.strip()
        if text.strip() == NOT_SET and self.is_optional:
            return None
        try:
            value = float(text) if float in self.kinds else int(text)
        except ValueError:
            requirement = f"must be a {'number' if float in self.kinds else 'whole number'}"
            if float in self.kinds and _DECIMAL_COMMA.fullmatch(text.strip()):
                requirement += f"; write {text.strip().replace(',', '.')}"
            raise ValueError(requirement) from None
        if not abs(value) < _LARGEST:
            raise ValueError(f"must be finite and below {_LARGEST:g}")
        return value

    def check(self, value: Any) -> Any:
        """Value as a plain number, word or rows; NumPy's numbers are accepted.

        Raises `ValueError` with the requirement.
        """
        if value is None and self.is_optional:
            return None
        if self.is_number:
            return self._checked_number(value)
        if self.values.rows is not None:
            return self.values.rows(value)
        if self.kinds == (str,):
            return value_text(self.name, value)
        words = list(self.values.words or self.kinds)
        if value not in words:
            raise ValueError("use " + " or ".join(map(repr, words)))
        return value

    def _checked_number(self, value: Any) -> Any:
        if float in self.kinds:
            if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
                raise ValueError("must be a finite number")
            value = float(value)
            if int in self.kinds and value.is_integer():
                value = int(value)
        elif isinstance(value, bool) or not isinstance(value, Integral):
            raise ValueError(self.values.requirement or "must be a whole number")
        else:
            value = int(value)
        self.values.check_range(value)
        return value


@cache
def declared(declaration: type) -> dict[str, Declared]:
    """Declared fields of a dataclass, by name."""
    hints = get_type_hints(declaration, include_extras=True)
    return {f.name: _declared(f.name, hints[f.name], f.default) for f in fields(declaration)}


def _declared(name: str, hint: Any, default: Any) -> Declared:
    kinds, values = _kinds(hint)
    types_of_values = tuple(kind for kind in kinds if kind is not type(None))
    return Declared(
        name, hint, types_of_values, len(types_of_values) < len(kinds), default, values or Values()
    )


def _kinds(hint: Any) -> tuple[list[Any], Values | None]:
    """Types of a field's values, words for `Literal`; and its `Values`."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _kinds(parts[0])[0], parts[1]
    if origin in (Union, types.UnionType):
        kinds, values = zip(*map(_kinds, parts), strict=True)
        return [kind for part in kinds for kind in part], next(filter(None, values), None)
    return list(parts) if origin is Literal else [origin or hint], None


def stated_repr(value: Any) -> str:
    """`repr` of a dataclass without the fields at their defaults."""
    values = {f.name: (getattr(value, f.name), f.default) for f in fields(value)}
    stated = [f"{name}={v!r}" for name, (v, default) in values.items() if v != default]
    return f"{type(value).__name__}({', '.join(stated)})"


def meanings(declaration: type) -> dict[str, str]:
    """Meanings of the fields of a dataclass, by name: their comments; ``{}`` is the default."""
    comments = field_comments(declaration)
    return {
        name: comments[name].format("" if field.default is MISSING else setting_text(field.default))
        for name, field in declared(declaration).items()
        if name in comments
    }


# -- text ------------------------------------------------------------------------------------------


def parse_rows(value: str | Sequence[Sequence[float]], *, columns: int) -> tuple[Any, ...]:
    """Rows of numbers, as tuples of floats.

    * `value`: rows, or text with a comma between rows; ``"none"`` or empty: no rows.

    Raises `ValueError`: no numbers, or not `columns` of them in each row.
    """
    rows: Any = value
    if isinstance(value, str):
        text = "" if value.strip() == NOT_SET else value
        rows = [part.split() for part in text.split(",") if part.strip()]
    try:
        numbers = tuple(tuple(float(number) for number in row) for row in rows)
    except TypeError as error:
        raise ValueError(*error.args) from None
    if any(len(row) != columns for row in numbers):
        raise ValueError(f"not {columns} numbers")
    return numbers


def rows_text(rows: Sequence[Sequence[float]]) -> str:
    """Text of rows of numbers, as `parse_rows` reads it."""
    return ", ".join(" ".join(map(repr, row)) for row in rows) or NOT_SET


def setting_text(value: Any) -> str:
    """Text of a setting's value, for records, tables and files: `Declared.read` reads it."""
    if value is None:
        return NOT_SET
    return rows_text(value) if isinstance(value, tuple) else value_text("value", value)


def value_text(label: str, value: object) -> str:
    """Text of a value, read back as the same value.

    * `label`: the value's place, for error messages.

    Raises `UsageError` for anything but text, numbers and paths.
    """
    if isinstance(value, bool) or not isinstance(value, str | Real | PathLike):
        raise UsageError(f"{label}: {value!r} is a {type(value).__name__}; give text or a number")
    if not isinstance(value, Real):
        return str(value)
    if isinstance(value, Integral):
        return str(int(value))
    number = float(value)
    return str(int(number)) if number.is_integer() and abs(number) < _EXACT else repr(number)
