"""Parts of a study's own data in a bench document, which has no declaration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def part(data: Any, *keys: str) -> Mapping[str, Any]:
    """The mapping under nested `keys`, empty when it is missing or not a mapping."""
    for key in keys:
        data = data.get(key) if isinstance(data, Mapping) else None
    return data if isinstance(data, Mapping) else {}


def items(data: Any, key: str) -> Sequence[Any]:
    """The list under `key`, empty when it is missing or not a list."""
    found = data.get(key) if isinstance(data, Mapping) else None
    return found if isinstance(found, (list, tuple)) else ()
