"""The conditions of a measurement: load."""

from __future__ import annotations

import os

__all__ = ["load_average", "warn_of_load"]

# Share of the cores that others may keep busy before times are in doubt.
_BUSY = 0.25


def load_average() -> float | None:
    """Programs at work or waiting for a core, mean of the last minute; None if not known."""
    try:
        return os.getloadavg()[0]
    except OSError:
        return None


def warn_of_load(before: float | None) -> list[str]:
    """A warning where others were at work when the measurement began."""
    cores = os.cpu_count() or 1
    if before is None:
        return ["the load of this machine is not known: times may be those of a busy one"]
    if before <= _BUSY * cores:
        return []
    return [
        f"the machine was busy: load average {before:.2f} on {cores} cores at the start; "
        "trust ratios and fastest runs more than medians, and run it again alone"
    ]
