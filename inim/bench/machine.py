"""The conditions of a measurement: threads and load."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from inim.errors import UsageError

__all__ = ["load_average", "most_threads", "threads", "warn_of_load"]

# Share of the cores that others may keep busy before times are in doubt.
_BUSY = 0.25


def most_threads() -> int:
    """Threads this process may use at once."""
    import numba

    return int(numba.config.NUMBA_NUM_THREADS)


@contextmanager
def threads(count: int | None) -> Iterator[int]:
    """Generators and yardstick on the same number of threads; all there are if None.

    Raises
    ------
    UsageError
        More than there are.
    """
    import numba

    from inim.render.reference_kernel import drjit_threads

    most = most_threads()
    wanted = most if count is None else count
    if not 1 <= wanted <= most:
        raise UsageError(f"--threads {wanted}: this machine has 1 to {most}")
    before = numba.get_num_threads()
    numba.set_num_threads(wanted)
    try:
        with drjit_threads(wanted):
            yield wanted
    finally:
        numba.set_num_threads(before)


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
