"""JSON Schemas (draft 2020-12) of the documents that inim writes, a file `NAME.schema.json` each.

What several of them share is in `parts.schema.json`, which they refer to by its URN; `schema` gives
a document's with these parts in it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib import resources
from typing import Any

__all__ = ["NAMES", "schema"]

#: Of the documents; `sweep` is a row of a sweep's table, and `baseline` a report's candidate, too.
NAMES = (
    "report",
    "picture",
    "compare",
    "baseline",
    "bench",
    "stress",
    "sweep",
    "tolerate",
    "unit",
    "inspect",
    "patterns",
    "calibration",
    "photo",
)
_PARTS = "urn:inim:parts:1#/$defs/"
_OWN = "#/$defs/"


def schema(name: str) -> dict[str, Any]:
    """The schema of a document, complete in itself: whatever it refers to is in its ``$defs``.

    Parameters
    ----------
    name : str
        One of `NAMES`.

    Raises
    ------
    ValueError
        Another name.
    """
    if name not in NAMES:
        raise ValueError(f"schema {name!r}: use {' or '.join(NAMES)}")
    found = _read(name)
    parts = _read("parts")["$defs"]
    needed = dict(found.get("$defs", {}))
    left = [found]
    while left:
        for one in _parts_of(left.pop()):
            if one not in needed:
                needed[one] = parts[one]
                left.append(parts[one])
    return found | ({"$defs": needed} if needed else {})


def _read(name: str) -> dict[str, Any]:
    """A file's schema; references to parts become references within it."""
    text = resources.files(__name__).joinpath(f"{name}.schema.json").read_text("utf-8")
    found: dict[str, Any] = json.loads(text.replace(_PARTS, _OWN))
    return found


def _parts_of(value: Any) -> Iterator[str]:
    """Names in ``$defs`` that a schema refers to."""
    if isinstance(value, dict):
        if str(value.get("$ref", "")).startswith(_OWN):
            yield value["$ref"].removeprefix(_OWN)
        for one in value.values():
            yield from _parts_of(one)
    elif isinstance(value, list):
        for one in value:
            yield from _parts_of(one)
