"""Peak memory of an algorithm, measured in a process of its own."""

import pickle
import subprocess
import sys
from pathlib import Path

from inim.display import Display
from inim.image.rgbd import RGBD
from inim.pipeline.timing import prepare_method
from inim.system.backend.kernels import limited_threads
from inim.system.errors import WorkerError
from inim.system.process.python_process import exit_with_parent, python_module, rendering_process

# Large arrays get pages of their own, which are returned as soon as the arrays are freed.
_ALLOCATION = {"MALLOC_MMAP_THRESHOLD_": "131072"}
# Of another display, so that the measured run shares no prepared table.
_OTHER_GAP = 1.001
_RESET = Path("/proc/self/clear_refs")


def peak_memory(name: str, rgbd: RGBD, display: Display, thread_count: int) -> int | None:
    """Bytes that an algorithm needs to prepare and to generate one EIA; None except on Linux.

    Imports and kernels are not included. Raises `WorkerError` if the process fails.
    """
    if not _RESET.exists():
        return None
    command = python_module("inim.apps.bench.memory")
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with rendering_process(command, _ALLOCATION, **pipes) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        pickle.dump((sys.path, name, rgbd, display, thread_count), process.stdin)
        process.stdin.flush()
        answer = process.stdout.read()
        if process.wait():
            raise WorkerError(f"{name}: the process that measures its memory ended without result")
    return int(answer)


def _measure() -> int:
    """Measure the algorithm given on stdin, after a run that loads its kernels."""
    sys.path[:], name, rgbd, display, thread_count = pickle.load(sys.stdin.buffer)
    exit_with_parent()
    with limited_threads(thread_count):
        other = display.replace(gap_mm=_OTHER_GAP * display.gap_mm)
        prepare_method(name, rgbd, other).run()
        _RESET.write_text("5")  # the peak begins at the present size
        before = _status_bytes("VmRSS")
        prepare_method(name, rgbd, display).run()
    return _status_bytes("VmHWM") - before


def _status_bytes(field: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith(f"{field}:"))


if __name__ == "__main__":
    print(_measure())
