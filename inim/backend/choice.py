"""Choosing a backend: CUDA where it works, else the newest libLLVM that works; and using it."""

from __future__ import annotations

import os
import platform
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from inim.backend.trial import Verdict, verdict_on
from inim.errors import BackendError, UsageError, missing_package
from inim.process import machine

SEARCH_VARIABLE = "INIM_LLVM_SEARCH"
LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
# Lies in each folder that `inim install-llvm` has filled.
PRIVATE_MARKER = "inim-llvm.json"

_LIBRARY = r"libLLVM(?:-(\d[\d.]*?))?(?:\.so(?:\.(\d+(?:\.\d+)*)[^/]*)?|\.dylib)"
_FOLDER_VERSION = r"llvm(?:@[\d.]+)?/(\d+(?:\.\d+)+)|llvm[-@](\d+(?:\.\d+)*)"


def is_libllvm(name: str) -> bool:
    """Whether a file of this name is LLVM's library rather than one of its parts."""
    return re.fullmatch(_LIBRARY, name) is not None


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
    """Every libLLVM on this machine, by real path, newest version first.

    With DRJIT_LIBLLVM_PATH set, that one alone.
    """
    named = os.environ.get(LLVM_VARIABLE)
    if named:
        return [Path(named).resolve() if os.sep in named else Path(named)]
    if search is None and os.environ.get(SEARCH_VARIABLE):
        search = [Path(part) for part in os.environ[SEARCH_VARIABLE].split(os.pathsep) if part]
    folders = _usual_folders() if search is None else search
    found = [path for folder in folders for path in _libraries_in(folder)]
    if search is None:
        found += [Path(name) for name in machine.linker_cache(b"libLLVM")]
    real = dict.fromkeys(path.resolve() for path in found if is_libllvm(path.name))
    files = [path for path in real if path.is_file()]
    return sorted(files, key=lambda path: llvm_version(path) or (0,), reverse=True)


def private_folders() -> list[Path]:
    """Where `inim install-llvm` may have put a copy: the virtual environment, the home."""
    folders = [Path(sys.prefix) / "lib" / "inim-llvm"]
    data = machine.user_folder("XDG_DATA_HOME", ".local/share")
    return [*folders, data / "llvm"] if data else folders


def _usual_folders() -> Iterator[Path]:
    yield from private_folders()
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
    try:
        # A system's folder holds thousands of files: make no Path of each.
        with os.scandir(folder) as entries:
            return sorted(Path(entry) for entry in entries if entry.name.startswith("libLLVM"))
    except OSError:
        return []


def known_bad(version: tuple[int, ...] | None) -> str:
    """Why a version is refused without being run, or an empty string."""
    if version and version[0] <= 14:
        return f"LLVM {version[0]} is too old for Dr.Jit"
    # Their x86 code generator cannot select float minimum and maximum, and aborts.
    if version and version[0] <= 16 and platform.machine() in ("x86_64", "AMD64", "i686"):
        return f"LLVM {version[0]} aborts the process on x86 CPUs"
    return ""


class Backend(NamedTuple):
    """A backend that was seen to work: what to load and how to call it in words.

    Attributes
    ----------
    name : {"cuda", "llvm"}
    variant : str
        Mitsuba's name for it.
    libllvm : Path or None
    libllvm_version : str or None
    device : str
        The processor or graphics card, for people.
    """

    name: str
    variant: str
    libllvm: Path | None
    libllvm_version: str | None
    device: str


def environment(backend: Backend) -> dict[str, str]:
    """The variables to set for a child process that will use `backend`."""
    return variables_for(backend.libllvm)


def activate(backend: Backend) -> None:
    """Make this process use `backend`.

    Dr.Jit looks for its libraries once, when it is imported: where it is loaded already, what it
    found is asked, and serves as well if it is no version that is known to fail.

    Raises
    ------
    BackendError
        Dr.Jit is loaded already, without what `backend` needs.
    """
    drjit = sys.modules.get("drjit")
    if drjit is not None:
        _check_loaded(drjit, backend.name)
        return
    _preload(_companions(backend.libllvm))
    os.environ.update(environment(backend))


def _check_loaded(drjit: Any, name: str) -> None:
    """Raise `BackendError` unless Dr.Jit, as it is loaded, can use CUDA or LLVM."""
    way_out = "import inim.render, which chooses one, before mitsuba and drjit"
    if name == "cuda":
        if not drjit.has_backend(drjit.JitBackend.CUDA):
            raise BackendError("Dr.Jit is loaded already, and found no CUDA then; import it anew")
        return
    if not drjit.has_backend(drjit.JitBackend.LLVM):
        raise BackendError(f"Dr.Jit is loaded already, and found no usable libLLVM; {way_out}")
    reason = known_bad(drjit.detail.llvm_version())
    if reason:
        raise BackendError(f"Dr.Jit is loaded already, and {reason}; {way_out}")


def variables_for(library: Path | None) -> dict[str, str]:
    """The variables that make a child use a libLLVM, or CUDA where it is None."""
    variables = {LLVM_VARIABLE: str(library)} if library else {}
    folders = [str(folder) for folder in _companions(library)]
    if folders:
        before = os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)
        every = dict.fromkeys([*folders, *before])
        variables["LD_LIBRARY_PATH"] = os.pathsep.join(folder for folder in every if folder)
    return variables


def _companions(library: Path | None) -> list[Path]:
    """Private folders whose libraries the system lacks: LLVM's dependencies, libatomic."""
    folders = [*([library.parent] if library else []), *private_folders()]
    return [folder for folder in dict.fromkeys(folders) if (folder / PRIVATE_MARKER).is_file()]


def _preload(folders: Iterable[Path]) -> None:
    """Load the private libraries into this process, in whatever order they allow.

    LD_LIBRARY_PATH is read when a process starts, so it serves children only. What is
    loaded already satisfies, by its name, the later demands of libLLVM and Dr.Jit.
    """
    import ctypes

    waiting = [path for folder in folders for path in sorted(folder.glob("*.so*"))]
    waiting = [path for path in waiting if not is_libllvm(path.name)]
    progress = True
    while waiting and progress:
        left = []
        for path in waiting:
            try:
                ctypes.CDLL(str(path))
            except OSError:
                left.append(path)
        progress, waiting = len(left) < len(waiting), left


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
            missing = None if find_spec("mitsuba") else ModuleNotFoundError(name="mitsuba")
            raise (missing and missing_package(missing)) or BackendError(
                f"Mitsuba cannot be imported: {verdict.reason}; {_WAY_OUT}"
            )
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
