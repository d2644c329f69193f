"""Choosing a backend: CUDA where it works, else the newest libLLVM that works."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from inim.backend import machine
from inim.backend.activation import Backend, variables_for
from inim.backend.libllvm import LLVM_VARIABLE, find_libllvm, known_bad, llvm_version
from inim.backend.trial import Verdict
from inim.backend.verdicts import verdict_on
from inim.errors import BackendError, UsageError

__all__ = ["BACKENDS", "choose_backend", "cuda_verdict", "llvm_verdicts"]

BACKENDS = ("auto", "cuda", "llvm")
_WAY_OUT = (
    "type: inim install-llvm  (or, as root on Debian and Ubuntu: "
    "apt-get install libllvm19 libatomic1; on macOS: brew install llvm)"
)


def choose_backend(wanted: str = "auto", search: Sequence[Path] | None = None) -> Backend:
    """The backend to use: CUDA where it works, else the newest libLLVM that works.

    Parameters
    ----------
    wanted : {"auto", "cuda", "llvm"}
        ``auto`` prefers CUDA.
    search : sequence of Path, optional
        The folders to look for libLLVM in, instead of the usual ones. The environment
        variable INIM_LLVM_SEARCH (folders joined by ``:``) does the same.

    Raises
    ------
    BackendError
        Nothing works; the message says what was found, why it was refused, what to type.
    UsageError
        `wanted` is none of the three.
    """
    if wanted not in BACKENDS:
        raise UsageError(f"backend {wanted!r} is unknown: choose one of {', '.join(BACKENDS)}")
    if wanted != "llvm":
        verdict = cuda_verdict()
        if verdict.usable:
            return Backend("cuda", "cuda_ad_rgb", None, None, verdict.device)
        if wanted == "cuda":
            raise BackendError(f"no usable CUDA: {verdict.reason}; use --backend llvm or auto")
    return _choose_llvm(search)


def _choose_llvm(search: Sequence[Path] | None) -> Backend:
    refused = []
    for library, verdict in llvm_verdicts(search):
        if verdict.usable:
            words = f"{machine.cpu_model()}, LLVM {verdict.version}, {verdict.device}"
            return Backend("llvm", "llvm_ad_rgb", library, verdict.version, words)
        if verdict.stage == "import":
            raise BackendError(f"Mitsuba cannot be imported: {verdict.reason}; {_WAY_OUT}")
        refused.append(f"{library} ({verdict.reason})")
    named = os.environ.get(LLVM_VARIABLE)
    if named:
        why = ", ".join(refused) or named
        raise BackendError(f"no usable libLLVM: {LLVM_VARIABLE} names {why}; change it or unset it")
    raise BackendError(f"no usable libLLVM: found {', '.join(refused) or 'none'}; {_WAY_OUT}")


def llvm_verdicts(search: Sequence[Path] | None = None) -> Iterator[tuple[Path, Verdict]]:
    """Each candidate with its verdict, newest first, tried only when asked for."""
    for library in find_libllvm(search):
        known = known_bad(llvm_version(library))
        if known:
            yield library, Verdict(False, known)
        else:
            yield library, verdict_on("llvm_ad_rgb", library, variables_for(library))


def cuda_verdict() -> Verdict:
    """Whether CUDA works here. Costs nothing where the driver library is missing."""
    named = os.environ.get("DRJIT_LIBCUDA_PATH")
    folders = os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)
    places = [named] if named else [f"{folder}/libcuda.so.1" for folder in folders if folder]
    places += [] if named else machine.linker_cache(b"libcuda.so.1")
    drivers = [Path(place) for place in places if Path(place).is_file()]
    if not drivers:
        return Verdict(False, "the driver library libcuda.so.1 was not found")
    # A driver without its device (a container) must not be remembered for one with it.
    devices = sorted(path.name for path in Path("/dev").glob("nvidia*"))
    visible = [os.environ.get("CUDA_VISIBLE_DEVICES", ""), *devices]
    return verdict_on("cuda_ad_rgb", drivers[0], variables_for(None), visible)
