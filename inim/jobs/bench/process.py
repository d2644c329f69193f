"""A process that runs one command and says how long it took and how much memory.

``python -m inim.jobs.bench.process WORDS`` prints one JSON object; see `inim.jobs.bench.commands`.
It is small on purpose: a process's peak memory starts at that of the one that made it.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Sequence
from time import perf_counter
from typing import Any

from inim.jobs.bench.memory import resident_bytes

__all__ = ["measure"]


def measure(words: Sequence[str]) -> dict[str, Any]:
    """Run a command to its end.

    Returns
    -------
    dict
        `seconds` from start to end; `peak_bytes`, largest resident size of the command's largest
        process; `code`, its exit code; `said`, the last line on its stderr.
    """
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
    print(json.dumps(measure(sys.argv[1:])))
