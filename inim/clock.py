"""Counting what goes into rendering."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Clock"]


@dataclass
class Clock:
    """Seconds spent inside the renderer and samples traced there, summed over calls."""

    seconds: float = 0.0
    samples: int = 0
