"""Times of the paper's algorithms in plain Python on one thread, as in the paper.

A child process with ``NUMBA_DISABLE_JIT=1`` runs the same code uncompiled. It reads one JSON object
from standard input and prints the times as another.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from inim.display import Display
from inim.pipeline.timing import Rounds, TimedMethod, Timing, prepare_method, time_calls
from inim.system.errors import WorkerError
from reports.bench.study import picture_of

#: Suffix of the name of an algorithm that ran in plain Python.
PLAIN_PYTHON = " in plain Python"
_ROOT = Path(__file__).parents[3]


def time_plain_python(
    methods: Sequence[TimedMethod], display: Display, pixels_per_pitch: int, rounds: Rounds
) -> tuple[list[TimedMethod], dict[str, Timing]]:
    """Time methods in plain Python, on the picture of `picture_of`.

    Returns the same EIAs, with the suffix `PLAIN_PYTHON` in their names, and their times by name.
    Raises `WorkerError` if the child process ended without times.
    """
    names = [method.name for method in methods]
    parameters = {k: v for k, v in display.parameters().items() if v is not None}
    request = {
        "display": parameters, "pixels_per_pitch": pixels_per_pitch, "names": names,
        "runs": rounds.runs, "warmups": rounds.warmups,
    }  # fmt: skip
    ended = subprocess.run(
        [sys.executable, "-m", __name__],
        cwd=_ROOT,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        input=json.dumps(request).encode(),
        stdout=subprocess.PIPE,
        check=False,
    )
    if ended.returncode:
        raise WorkerError(
            f"plain Python of {', '.join(names)} ended with exit code {ended.returncode}"
        )
    times = {
        name + PLAIN_PYTHON: Timing(timing["cold_s"], tuple(timing["times_s"]), timing["slow"])
        for name, timing in json.loads(ended.stdout).items()
    }
    return [replace(m, name=m.name + PLAIN_PYTHON) for m in methods], times


def _measure(request: Mapping[str, Any]) -> dict[str, Any]:
    """Time the requested algorithms, in the child process."""
    display = Display(**request["display"])
    rgbd = picture_of(display, request["pixels_per_pitch"])
    methods = [prepare_method(name, rgbd, display) for name in request["names"]]
    rounds = Rounds(request["runs"], request["warmups"])
    times = time_calls({method.name: method.run for method in methods}, rounds)
    return {name: vars(timing) for name, timing in times.items()}


if __name__ == "__main__":
    print(json.dumps(_measure(json.load(sys.stdin))))
