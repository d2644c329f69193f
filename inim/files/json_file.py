"""The door for JSON that inim wrote, and anybody may have changed: strict, as its schema says.

Readers behind it need not ask what is there, nor of which type it is; what schemas cannot say, such
as that an algorithm's view has a viewpoint, is theirs.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from inim.errors import FileError
from inim.files.regular_file import read_file
from inim.schemas import schema

if TYPE_CHECKING:
    from jsonschema.exceptions import ValidationError
    from jsonschema.protocols import Validator

# The project's own reports have some 45 kB and a thousand values.
_MOST_BYTES = 2**24
# Checking takes about a second for each hundred thousand.
_MOST_VALUES = 300_000
# Whole numbers of 64 bits.
_MOST_DIGITS = 20
_SHOWN = 60


def read_json(path: Path, way_out: str, *names: str) -> dict[str, Any]:
    """A document from its file.

    Parameters
    ----------
    path : Path
    way_out : str
        What errors end with.
    *names : str
        Of schemas, of `inim.schemas.NAMES`: it must keep the one that it says it is of.

    Raises
    ------
    FileError
        Missing, no regular file, too large, no strict JSON, or not as its schema says; the line
        names the place in the document.
    """
    data = read_file(path, _MOST_BYTES, way_out=way_out)
    try:
        document = _parsed(data)
        wrong = _wrong(document, names)
    except RecursionError:
        wrong = "is nested too deeply"
    except ValueError as error:
        wrong = f"not a JSON document ({_short(str(error), quote=False)})"
    if wrong:
        raise FileError(f"{path}: {wrong}; {way_out}")
    found: dict[str, Any] = document
    return found


def _parsed(data: bytes) -> Any:
    values = data.count(b",")
    if values > _MOST_VALUES:
        raise ValueError(f"of {values} values; at most {_MOST_VALUES} are read")
    return json.loads(
        data.decode("utf-8"), parse_constant=_finite, parse_float=_finite, parse_int=_counted
    )


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{_short(text, quote=False)} is no finite number")
    return number


def _counted(text: str) -> int:
    if len(text) > _MOST_DIGITS:
        raise ValueError(f"a whole number of {len(text)} digits")
    return int(text)


def _wrong(document: Any, names: Sequence[str]) -> str:
    """What its schema does not allow in a document; empty where there is nothing."""
    said = document.get("schema") if isinstance(document, dict) else None
    known = {schema(name)["properties"]["schema"]["const"]: name for name in names}
    if not isinstance(said, str) or said not in known:
        return f"schema is {_short(said)}, not {_either(known)}"
    error: ValidationError | None = next(_validator(known[said]).iter_errors(document), None)
    if error is None:
        return ""
    place = ".".join(_key(part) for part in error.absolute_path)
    return f"{place or 'the document'}: {_words(error)}"


@cache
def _validator(name: str) -> Validator:
    # Loads in a twentieth of a second, which only readers of reports need pay.
    from jsonschema import Draft202012Validator
    from jsonschema.validators import extend

    # JSON Schema takes 1.0 for a whole number, as which Python does not index.
    kinds = Draft202012Validator.TYPE_CHECKER.redefine(
        "integer", lambda _, value: isinstance(value, int) and not isinstance(value, bool)
    )
    strict = extend(Draft202012Validator, type_checker=kinds)
    found: Validator = strict(schema(name))
    return found


def _words(error: ValidationError) -> str:
    """What is wrong with a value, in a few words."""
    value, rule = error.instance, error.validator_value
    if error.validator == "required":
        return f"{_key(next(key for key in rule if key not in value))} is missing"
    if "propertyNames" in error.absolute_schema_path:
        return f"{_short(value)} is no key of it"
    if error.validator == "additionalProperties":
        known = error.schema.get("properties", {})
        return f"{_short(next(key for key in value if key not in known))} is no key of it"
    if error.validator == "type":
        return (
            f"is {_short(value)}, not of type {_either([rule] if isinstance(rule, str) else rule)}"
        )
    if error.validator == "enum":
        return f"is {_short(value)}, not {_either(rule)}"
    if error.validator in ("minItems", "maxItems", "items"):
        return f"has {len(value)} items"
    return f"is {_short(value)}, which its schema does not allow ({error.validator})"


def _either(words: Iterable[object]) -> str:
    return " or ".join("null" if word is None else str(word) for word in words)


def _key(part: object) -> str:
    """A step of the way to a value."""
    text = str(part)
    return text if text.isprintable() and len(text) <= _SHOWN else _short(text)


def _short(value: object, *, quote: bool = True) -> str:
    """A value in a few characters, printable ones."""
    if isinstance(value, (dict, list)):
        return "an object" if isinstance(value, dict) else "a list"
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    text = str(value)
    text = text if len(text) <= _SHOWN else text[:_SHOWN] + "..."
    return (
        ascii(text)
        if quote and isinstance(value, str)
        else "".join(c if c.isprintable() else " " for c in text)
    )
