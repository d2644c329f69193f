"""Access to the untyped `study` data of a bench document."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def part(data: Any, *keys: str) -> Mapping[str, Any]:
    """Mapping under nested `keys`; empty if it is missing or not a mapping."""
    for key in keys:
        data = data.get(key) if isinstance(data, Mapping) else None
    return data if isinstance(data, Mapping) else {}


def items(data: Any, key: str) -> Sequence[Any]:
    """List under `key`; empty if it is missing or not a list."""
    values = data.get(key) if isinstance(data, Mapping) else None
    return values if isinstance(values, (list, tuple)) else ()
