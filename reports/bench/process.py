"""A command run to its end, how long it took and how much memory.

A process's peak memory starts at that of the one that made it. So the command is made by a small
process, this file run as a script with the command's words, which prints one JSON object.
"""

from __future__ import annotations

import json
import os
import re
import resource
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any


def peak_bytes() -> int:
    """Largest resident size of this process so far.

    The system's own ru_maxrss starts at that of the parent, from before this program was loaded;
    Linux's VmHWM does not.
    """
    try:
        found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text("ascii"))
    except OSError:
        found = None
    if found:
        return 1024 * int(found[1])
    return resident_bytes(resource.getrusage(resource.RUSAGE_SELF))


def resident_bytes(usage: resource.struct_rusage) -> int:
    """The largest resident size that the system's account of a process names."""
    return (1 if sys.platform == "darwin" else 1024) * usage.ru_maxrss


def run_measured(words: Sequence[str], variables: Mapping[str, str]) -> dict[str, Any]:
    """Run a command to its end, in an environment.

    Returns
    -------
    dict
        `seconds` from start to end; `processor_seconds`, of it and all that it waited for;
        `peak_bytes`, largest resident size of the command's largest
        process; `code`, its exit code; `said`, the last line on its stderr.

    Raises
    ------
    WorkerError
        The small process died.
    """
    process = subprocess.Popen(
        [sys.executable, __file__, *words],
        env=variables,
        stdin=subprocess.PIPE,  # nothing is sent: it closes when this process ends, however
        stdout=subprocess.PIPE,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    with process.stdin, process.stdout:
        answer = process.stdout.read()
    if process.wait():
        from inim.errors import WorkerError  # the small process does without

        raise WorkerError(f"the process that measures {words[0]} ended with {process.returncode}")
    found: dict[str, Any] = json.loads(answer)
    return found


def _measure(words: Sequence[str]) -> dict[str, Any]:
    """The small process's side."""
    started = perf_counter()
    process = subprocess.Popen(
        words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    threading.Thread(target=_end_with_parent, args=(process,), daemon=True).start()
    assert process.stderr is not None
    said = process.stderr.read().decode(errors="replace").splitlines()
    # Of the command and of all processes that it waited for.
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return {
        "seconds": perf_counter() - started,
        "processor_seconds": usage.ru_utime + usage.ru_stime,
        "peak_bytes": resident_bytes(usage),
        "code": process.returncode,
        "said": said[-1] if said else "",
    }


def _end_with_parent(process: subprocess.Popen[bytes]) -> None:
    """Wait for the parent's end of stdin to close: it died, and the command has nobody else."""
    while os.read(0, 1):
        pass
    process.terminate()
    os._exit(1)


if __name__ == "__main__":
    print(json.dumps(_measure(sys.argv[1:])))
