"""Choice of the renderer backend: CUDA, or LLVM with a usable libLLVM.

This package never imports Mitsuba or Dr.Jit itself. A bad libLLVM does not raise, it aborts the
process (LLVM 15 and 16 on x86), so each candidate is tried in a child process first and
the result is stored. `activate` makes this process use a backend: any, if Dr.Jit is not loaded yet,
otherwise the one that Dr.Jit loaded.
"""

from __future__ import annotations

from inim.backend.choice import (
    BACKENDS,
    LLVM_VARIABLE,
    SEARCH_VARIABLE,
    Backend,
    activate,
    check_loaded,
    choose_backend,
    environment,
    known_bad,
)
from inim.backend.trial import Verdict, probe
from inim.process.machine import memory_limit_bytes, peak_bytes

__all__ = [
    "BACKENDS",
    "LLVM_VARIABLE",
    "SEARCH_VARIABLE",
    "Backend",
    "Verdict",
    "activate",
    "check_loaded",
    "choose_backend",
    "environment",
    "known_bad",
    "memory_limit_bytes",
    "peak_bytes",
    "probe",
]
