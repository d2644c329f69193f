"""Choice of the renderer backend: CUDA, or LLVM with a usable libLLVM.

This package never imports Mitsuba or Dr.Jit itself. A bad libLLVM does not raise, it aborts the
process (LLVM 15 and 16 on x86), so each candidate is tried in a child process first and
the result is stored. `activate` makes this process use a backend: any, if Dr.Jit is not loaded yet,
otherwise the one that Dr.Jit loaded.
"""

from __future__ import annotations

import os
import platform
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from inim.system.backend.trial import Verdict, stored_trial
from inim.system.errors import BackendError, UsageError, missing_package
from inim.system.process import machine

SEARCH_VARIABLE = "INIM_LLVM_SEARCH"
LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
# The installed package that contains a libLLVM: where there is a wheel of it, a dependency.
_WHEEL = "karellen_llvm_core-"
# What that libLLVM needs, in the order of loading. Their usual names are links, which the package
# creates when Python first starts, and not at all where the environment cannot be written then.
_WHEEL_NEEDS = ("libunwind.so.1.0", "libc++abi.so.1.0", "libc++.so.1.0")
_LIBATOMIC = "libatomic.so.1"

_LIBRARY = r"libLLVM(?:-(\d[\d.]*?))?(?:\.so(?:\.(\d+(?:\.\d+)*)[^/]*)?|\.dylib)"
_FOLDER_VERSION = r"llvm(?:@[\d.]+)?/(\d+(?:\.\d+)+)|llvm[-@](\d+(?:\.\d+)*)"


def llvm_version(library: Path) -> tuple[int, ...] | None:
    """The version in a libLLVM's name or, failing that, its folder; else None."""
    match = re.fullmatch(_LIBRARY, library.name)
    # "libLLVM.so.1" is an alias without the version: no usable LLVM is older than 3.
    for text in match.groups() if match else ():
        if text and int(text.split(".")[0]) >= 3:
            return tuple(int(part) for part in text.split("."))
    folder = re.search(_FOLDER_VERSION, library.parent.as_posix())
    text = (folder.group(1) or folder.group(2)) if folder else None
    return tuple(int(part) for part in text.split(".")) if text else None


def find_libllvm(search: Sequence[Path] | None = None) -> list[Path]:
    """Every libLLVM on this machine, by real path: the installed package's, then newest first.

    With DRJIT_LIBLLVM_PATH set, that one alone.
    """
    named = os.environ.get(LLVM_VARIABLE)
    if named:
        return [Path(named).resolve() if os.sep in named else Path(named)]
    if search is None and os.environ.get(SEARCH_VARIABLE):
        search = [Path(part) for part in os.environ[SEARCH_VARIABLE].split(os.pathsep) if part]
    folders = _usual_folders() if search is None else search
    libraries = [path for folder in folders for path in _libraries_in(folder)]
    if search is None:
        libraries += [Path(name) for name in machine.linker_cache(b"libLLVM")]
    real = dict.fromkeys(path.resolve() for path in libraries if re.fullmatch(_LIBRARY, path.name))
    files = [path for path in real if path.is_file()]
    packaged = [] if search is not None else wheel_folders()

    def preference(path: Path) -> tuple[bool, tuple[int, ...]]:
        return path.parent in packaged, llvm_version(path) or (0,)

    return sorted(files, key=preference, reverse=True)


def wheel_folders() -> list[Path]:
    """Folders of the installed package's libLLVM; `pip install --target` has another layout."""
    folders = []
    for place in map(Path, filter(None, sys.path)):
        if any(name.startswith(_WHEEL) for name in _names_in(place)):
            folders += [place / "lib", place.parent.parent]
    return [folder.resolve() for folder in folders]


def _usual_folders() -> Iterator[Path]:
    yield from wheel_folders()
    for prefix in (os.environ.get("CONDA_PREFIX"), sys.prefix):
        if prefix:
            yield Path(prefix) / "lib"
    multiarch = getattr(sys.implementation, "_multiarch", "") or f"{platform.machine()}-linux-gnu"
    yield Path("/usr/lib") / multiarch
    yield from Path("/usr/lib").glob("llvm-*/lib")
    yield from (Path("/usr/lib64"), Path("/usr/local/lib"))
    yield from Path("/opt/homebrew/opt").glob("llvm*/lib")
    yield from Path("/usr/local/opt").glob("llvm*/lib")


def _libraries_in(folder: Path) -> list[Path]:
    # A system's folder holds thousands of files: make no Path of each.
    return sorted(folder / name for name in _names_in(folder) if name.startswith("libLLVM"))


def _names_in(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)  # noqa: PTH208
    except OSError:
        return []


def rejection_reason(version: tuple[int, ...] | None) -> str:
    """Reason why a version is rejected without a trial, or an empty string."""
    if version and version[0] <= 14:
        return f"LLVM {version[0]} is too old for Dr.Jit"
    # Their x86 code generator cannot select float minimum and maximum, and aborts.
    if version and version[0] <= 16 and platform.machine() in ("x86_64", "AMD64", "i686"):
        return f"LLVM {version[0]} aborts the process on x86 CPUs"
    return ""


class Backend(NamedTuple):
    """Working backend: its libraries and its description."""

    name: str  #: {"cuda", "llvm"}
    variant: str  #: Mitsuba's name for it.
    libllvm: Path | None
    libllvm_version: str | None
    device: str  #: The processor or graphics card, for people.


def environment(backend: Backend) -> dict[str, str]:
    """Environment variables for a child process that will use `backend`."""
    return {LLVM_VARIABLE: str(backend.libllvm)} if backend.libllvm else {}


def activate(backend: Backend) -> None:
    """Make this process use `backend`.

    Dr.Jit searches its libraries once, when it is imported. If it is already loaded, its own
    choice is accepted unless its version is known to fail.

    Raises `BackendError`: Dr.Jit is already loaded without a library that `backend` needs.
    """
    if "drjit" in sys.modules:
        check_loaded(backend.name)
        return
    # Beside CUDA, too: the reference kernel of timings runs on the CPU.
    libllvm = backend.libllvm or _usable_libllvm()
    load(required_libraries(libllvm))
    if libllvm:
        os.environ[LLVM_VARIABLE] = str(libllvm)


def _usable_libllvm() -> Path | None:
    return next((library for library, verdict in llvm_verdicts() if verdict.usable), None)


def check_loaded(name: str) -> None:
    """Raise `BackendError` unless Dr.Jit, as it is loaded, can use CUDA or LLVM."""
    drjit = sys.modules["drjit"]
    way_out = "import inim.render.library, which chooses one, before mitsuba and drjit"
    if name == "cuda":
        if not drjit.has_backend(drjit.JitBackend.CUDA):
            raise BackendError("Dr.Jit is loaded already, and found no CUDA then; import it anew")
        return
    if not drjit.has_backend(drjit.JitBackend.LLVM):
        raise BackendError(f"Dr.Jit is loaded already, and found no usable libLLVM; {way_out}")
    reason = rejection_reason(drjit.detail.llvm_version())
    if reason:
        raise BackendError(f"Dr.Jit is loaded already, and {reason}; {way_out}")


def required_libraries(library: Path | None) -> list[str]:
    """Libraries to load before Dr.Jit: the system may lack them, or not find them by their names.

    * `library`: the libLLVM to use; None for CUDA.
    """
    is_linux_x86 = sys.platform == "linux" and platform.machine() == "x86_64"
    lacks_atomic = is_linux_x86 and not _system_has_libatomic()
    needed = [Path(__file__).with_name("libatomic") / _LIBATOMIC] if lacks_atomic else []
    if library and library.parent in wheel_folders():
        folders = sorted(library.parent.glob("*-linux-gnu*"))
        needed += [folder / name for name in _WHEEL_NEEDS for folder in folders]
    return [str(path) for path in needed if path.is_file()]


def load(libraries: Iterable[str]) -> None:
    """Load libraries into this process, where later loads find them by name."""
    import ctypes

    for library in libraries:
        ctypes.CDLL(library)


@cache  # once this package's own is loaded, its name alone would find it
def _system_has_libatomic() -> bool:
    try:
        load([_LIBATOMIC])
    except OSError:
        return False
    return True


BACKENDS = ("auto", "cuda", "llvm")
_WAY_OUT = (
    "install one: pip install karellen-llvm-core==22.1.8 (Linux on x86-64), "
    "sudo apt-get install libllvm19 libatomic1 (Debian, Ubuntu), "
    "sudo dnf install llvm-libs libatomic (Fedora), brew install llvm (macOS) or "
    "conda install -c conda-forge libllvm19"
)

_WITHOUT_TARGET = (
    "the package karellen-llvm-core is installed without it, as `pip install --target` does; "
    "install into a virtual environment, or by `uv pip install --target`"
)


def choose_backend(requested: str = "auto", search: Sequence[Path] | None = None) -> Backend:
    """Choose the backend: CUDA if it works, otherwise the newest working libLLVM.

    * `requested`, {"auto", "cuda", "llvm"}: ``auto`` prefers CUDA.
    * `search`: folders for the search of libLLVM, instead of the usual ones. The environment
      variable INIM_LLVM_SEARCH (folders joined by ``:``) has the same effect.

    Raises `BackendError`: no backend works; the message lists the candidates, the reasons of
    rejection, and the remedy. `UsageError`: `requested` is none of the three.
    """
    if requested not in BACKENDS:
        raise UsageError(f"backend {requested!r} is unknown: choose one of {', '.join(BACKENDS)}")
    if requested != "llvm":
        verdict = cuda_verdict()
        if verdict.usable:
            return Backend("cuda", "cuda_ad_rgb", None, None, verdict.device)
        if requested == "cuda":
            raise BackendError(f"no usable CUDA: {verdict.reason}; use --backend llvm or auto")
    return _choose_llvm(search)


def _choose_llvm(search: Sequence[Path] | None) -> Backend:
    refused = []
    for library, verdict in llvm_verdicts(search):
        if verdict.usable:
            words = f"{machine.cpu_model()}, LLVM {verdict.version}, {verdict.device}"
            return Backend("llvm", "llvm_ad_rgb", library, verdict.version, words)
        if verdict.stage == "import":
            missing = None if find_spec("mitsuba") else ModuleNotFoundError(name="mitsuba")
            raise (missing and missing_package(missing)) or BackendError(
                f"Mitsuba cannot be imported: {verdict.reason}; {_WAY_OUT}"
            )
        refused.append(f"{library} ({verdict.reason})")
    named = os.environ.get(LLVM_VARIABLE)
    if named:
        why = ", ".join(refused) or named
        raise BackendError(f"no usable libLLVM: {LLVM_VARIABLE} names {why}; change it or unset it")
    folders = wheel_folders()
    incomplete = folders and not any(map(_libraries_in, folders))
    way_out = _WITHOUT_TARGET if incomplete else _WAY_OUT
    raise BackendError(f"no usable libLLVM: found {', '.join(refused) or 'none'}; {way_out}")


def llvm_verdicts(search: Sequence[Path] | None = None) -> Iterator[tuple[Path, Verdict]]:
    """Each candidate with its verdict, newest first, tried only when asked for."""
    for library in find_libllvm(search):
        reason = rejection_reason(llvm_version(library))
        if reason:
            yield library, Verdict(False, reason)
        else:
            variables = {LLVM_VARIABLE: str(library)}
            yield (
                library,
                stored_trial("llvm_ad_rgb", library, variables, required_libraries(library)),
            )


def cuda_verdict() -> Verdict:
    """Trial of CUDA. Free if the driver library is missing."""
    named = os.environ.get("DRJIT_LIBCUDA_PATH")
    folders = os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)
    places = [named] if named else [f"{folder}/libcuda.so.1" for folder in folders if folder]
    places += [] if named else machine.linker_cache(b"libcuda.so.1")
    drivers = [Path(place) for place in places if Path(place).is_file()]
    if not drivers:
        return Verdict(False, "the driver library libcuda.so.1 was not found")
    # A driver without its device (a container) must not be remembered for one with it.
    devices = sorted(path.name for path in Path("/dev").glob("nvidia*"))
    # An empty value hides every card; none at all hides none.
    visible = [repr(os.environ.get("CUDA_VISIBLE_DEVICES")), *devices]
    return stored_trial("cuda_ad_rgb", drivers[0], {}, required_libraries(None), visible)
