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


#: Parts of a validation, with the beginnings of the stages in report.json that they sum up.
RUN_PARTS = {
    "rendering": ("capture ", "ground-truth "),
    "reconstruction": ("reconstruct ",),
    "generating": ("generate ",),
    "scoring": ("score",),
}


def run_parts(timings: Mapping[str, float]) -> dict[str, float]:
    """Seconds of the parts of a validation, from `timings` of its report.json."""
    return {
        part: sum(seconds for name, seconds in timings.items() if name.startswith(stages))
        for part, stages in RUN_PARTS.items()
    }
