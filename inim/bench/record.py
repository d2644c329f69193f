"""What a bench says besides its results: what made it, how to make it again, how busy it was."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from datetime import datetime, timezone
from typing import Any

from inim.backend.choice import backend_data, versions
from inim.documents.bench import BenchDocument, BenchRounds, Load
from inim.documents.parts import Backend
from inim.timing.turns import Rounds, most_threads
from inim.version import __version__

_VERSIONS = ("drjit", "matplotlib", "mitsuba", "numba", "numpy", "scikit-image")
# Share of the cores that others may keep busy before times are in doubt.
_BUSY = 0.25


def record(
    title: str, command: Sequence[str], backend: Any, rounds: Rounds, load: float | None
) -> BenchDocument:
    """A document without results, load at the end and list of files.

    Parameters
    ----------
    title : str
    command : sequence of str
        The words that repeat it.
    backend : inim.backend.Backend
    rounds : Rounds
    load : float or None
        `load_average` before anything was loaded.
    """
    return BenchDocument(
        title=title,
        created=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        inim_version=__version__,
        versions=versions(_VERSIONS),
        command=shlex.join(command),
        backend=Backend(**backend_data(backend)),
        threads=rounds.threads or most_threads(),
        threading_layer=os.environ.get("NUMBA_THREADING_LAYER", "default"),
        rounds=BenchRounds(runs=rounds.runs, warmups=rounds.warmups),
        warnings=warn_of_load(load),
        load=Load(start=load, cores=os.cpu_count(), end=None),
        notes=[],
        scene=None,
        files=[],
    )


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
