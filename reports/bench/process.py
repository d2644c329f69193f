"""Time and peak memory of a command.

The recorded peak memory of a process includes that of its parent at the fork. Therefore a small
process starts the command: this file, run as a script with the command as its arguments. It prints
one JSON object.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from time import perf_counter
from typing import Any


def run_measured(words: Sequence[str], variables: Mapping[str, str]) -> dict[str, Any]:
    """Run a command with these environment variables until it ends.

    Returns `seconds`, the wall-clock time; `peak_bytes`, the peak resident size of the largest of
    the command and its awaited child processes; `code`, the exit code; and `message`, the last line
    on stderr. Raises `WorkerError` if the small process failed.
    """
    process = subprocess.Popen(
        [sys.executable, __file__, *words],
        env=variables,
        stdin=subprocess.PIPE,  # unused: the system closes it when this process ends
        stdout=subprocess.PIPE,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    with process.stdin, process.stdout:
        answer = process.stdout.read()
    if process.wait():
        from inim.system.errors import WorkerError  # not imported by the small process

        raise WorkerError(f"the process that measures {words[0]} ended with {process.returncode}")
    measurement: dict[str, Any] = json.loads(answer)
    return measurement


def _measure(words: Sequence[str]) -> dict[str, Any]:
    """Run and measure a command, in the small process."""
    started = perf_counter()
    process = subprocess.Popen(
        words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    threading.Thread(target=_end_with_parent, args=(process,), daemon=True).start()
    assert process.stderr is not None
    messages = process.stderr.read().decode(errors="replace").splitlines()
    # The usage includes all child processes that the command waited for.
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return {
        "seconds": perf_counter() - started,
        "peak_bytes": (1 if sys.platform == "darwin" else 1024) * usage.ru_maxrss,
        "code": process.returncode,
        "message": messages[-1] if messages else "",
    }


def _end_with_parent(process: subprocess.Popen[bytes]) -> None:
    """Terminate the command when the parent process ends, which closes stdin."""
    while os.read(0, 1):
        pass
    process.terminate()
    os._exit(1)


if __name__ == "__main__":
    print(json.dumps(_measure(sys.argv[1:])))
