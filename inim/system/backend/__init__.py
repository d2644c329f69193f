"""Choice of the renderer backend: CUDA, or LLVM with a usable libLLVM.

This package never imports Mitsuba or Dr.Jit itself. Some versions of LLVM abort the process that
uses them, so a libLLVM's version is read from its file before anything loads it. `activate` makes
this process use a backend: any, if Dr.Jit is not loaded yet, otherwise the one that Dr.Jit loaded.
"""

import mmap
import os
import platform
import re
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

from inim.system.errors import BackendError, UsageError
from inim.system.process import machine

BACKENDS = ("auto", "cuda", "llvm")
LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
# The installed package that contains a libLLVM: where there is a wheel of it, a dependency.
_WHEEL = "karellen_llvm_core-"
# What that libLLVM needs, in the order of loading. Their usual names are links, which the package
# creates when Python first starts, and not at all where the environment cannot be written then.
_WHEEL_NEEDS = ("libunwind.so.1.0", "libc++abi.so.1.0", "libc++.so.1.0")
_LIBATOMIC = "libatomic.so.1"
_LIBRARY = r"libLLVM(-\d[\d.]*)?(\.so(\.\d[^/]*)?|\.dylib)"
_VERSION = b"LLVM version "
REMEDY = (
    "install one: pip install karellen-llvm-core==22.1.8 (Linux on x86-64), "
    "sudo apt-get install libllvm19 libatomic1 (Debian, Ubuntu), "
    "sudo dnf install llvm-libs libatomic (Fedora), brew install llvm (macOS) or "
    "conda install -c conda-forge libllvm19"
)
_WITHOUT_TARGET = (
    "the package karellen-llvm-core is installed without it, as `pip install --target` does; "
    "install into a virtual environment, or by `uv pip install --target`"
)


class Backend(NamedTuple):
    """Usable backend: its library and its description."""

    name: str  #: {"cuda", "llvm"}
    variant: str  #: Mitsuba's name for it.
    libllvm: Path | None
    libllvm_version: str | None
    device: str  #: The processor or graphics card, for people.


def choose_backend(requested: str = "auto") -> Backend:
    """Choose the backend without loading it: CUDA if there is a card, otherwise LLVM.

    * `requested`, {"auto", "cuda", "llvm"}: ``auto`` prefers CUDA.

    Raises `BackendError`: no backend is usable; the message lists the candidates, the reasons of
    rejection, and the remedy. `UsageError`: `requested` is none of the three.
    """
    if requested not in BACKENDS:
        raise UsageError(f"backend {requested!r} is unknown: choose one of {', '.join(BACKENDS)}")
    if requested != "llvm":
        card, reason = find_card()
        if card:
            return Backend("cuda", "cuda_ad_rgb", None, None, card)
        if requested == "cuda":
            raise BackendError(f"no usable CUDA: {reason}; use --backend llvm or auto")
    library, version = _choose_libllvm()
    device = f"{machine.cpu_model()}, LLVM {version}, {machine.cpu_count()} threads"
    return Backend("llvm", "llvm_ad_rgb", library, version, device)


def _choose_libllvm() -> tuple[Path, str]:
    """The first libLLVM of `find_libllvm` that is not rejected, and its version."""
    refused = []
    for library in find_libllvm():
        version = llvm_version(library)
        reason = rejection_reason(version)
        if not reason:
            return library, version
        refused.append(f"{library} ({reason})")
    words = ", ".join(refused)
    if os.environ.get(LLVM_VARIABLE):
        words = f"{LLVM_VARIABLE} names {words}; change it or unset it"
        raise BackendError(f"no usable libLLVM: {words}")
    folders = wheel_folders()
    incomplete = folders and not any(map(_libraries_in, folders))
    way_out = _WITHOUT_TARGET if incomplete else REMEDY
    raise BackendError(f"no usable libLLVM: found {words or 'none'}; {way_out}")


def find_libllvm() -> Iterator[Path]:
    """Every libLLVM on this machine: the installed package's, then the system's, newest first.

    With DRJIT_LIBLLVM_PATH set, that one alone: a path, or a name that the linker finds.
    """
    named = os.environ.get(LLVM_VARIABLE)
    if named:
        places = [] if os.sep in named else machine.linker_cache(os.fsencode(named))
        yield Path(places[0] if places else named)
        return
    for folder in wheel_folders():
        yield from _libraries_in(folder)
    libraries = [Path(name) for name in machine.linker_cache(b"libLLVM")]
    libraries += [path for folder in _system_folders() for path in _libraries_in(folder)]
    files = {path.resolve() for path in libraries if re.fullmatch(_LIBRARY, path.name)}
    yield from sorted((path for path in files if path.is_file()), key=_numbers, reverse=True)


def _numbers(library: Path) -> list[int]:
    """Numbers in a library's name and folder, which sort versions."""
    return [int(number) for number in re.findall(r"\d+", library.name + library.parent.name)]


def wheel_folders() -> list[Path]:
    """Folders of the installed package's libLLVM; `pip install --target` has another layout."""
    folders = []
    for place in map(Path, filter(None, sys.path)):
        if any(name.startswith(_WHEEL) for name in _names_in(place)):
            folders += [place / "lib", place.parent.parent]
    return [folder.resolve() for folder in folders]


def _system_folders() -> Iterator[Path]:
    """Folders of libraries that are not in the linker's cache."""
    for prefix in (os.environ.get("CONDA_PREFIX"), sys.prefix):
        if prefix:
            yield Path(prefix) / "lib"
    for homebrew in ("/opt/homebrew/opt", "/usr/local/opt"):
        yield from Path(homebrew).glob("llvm*/lib")


def _libraries_in(folder: Path) -> list[Path]:
    """Each libLLVM of a folder, once."""
    names = [name for name in _names_in(folder) if re.fullmatch(_LIBRARY, name)]
    return sorted({(folder / name).resolve() for name in names})


def _names_in(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)  # noqa: PTH208
    except OSError:
        return []


@cache
def llvm_version(library: Path) -> str:
    """Version of a libLLVM, such as "22.1.8", as it prints it; empty if the file is no libLLVM."""
    try:
        with (
            library.open("rb") as file,
            mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content,
        ):
            start = content.find(_VERSION) + len(_VERSION)
            match = re.match(rb"\d+\.\d+\.\d+", content[start : start + 16])
    except (OSError, ValueError):  # an empty file has no map
        return ""
    return match.group().decode() if match else ""


def rejection_reason(version: str) -> str:
    """Reason why Dr.Jit cannot use a version of LLVM, or an empty string."""
    major = int(version.partition(".")[0] or 0)
    if not major:
        return "it is missing, or no libLLVM"
    if major <= 14:
        return f"LLVM {major} is too old for Dr.Jit"
    # Their x86 code generator cannot select float minimum and maximum, and aborts.
    if major <= 16 and platform.machine() in ("x86_64", "AMD64", "i686"):
        return f"LLVM {major} aborts the process on x86 CPUs"
    return ""


def find_card() -> tuple[str, str]:
    """Name of the graphics card that CUDA uses, and the reason if there is none."""
    import ctypes

    try:
        driver = ctypes.CDLL(os.environ.get("DRJIT_LIBCUDA_PATH") or "libcuda.so.1")
        ctypes.CDLL(os.environ.get("DRJIT_LIBOPTIX_PATH") or "libnvoptix.so.1")
    except OSError as error:
        return "", f"the driver lacks a library ({error})"
    card = ctypes.create_string_buffer(256)
    if driver.cuInit(0) or driver.cuDeviceGetName(card, len(card), 0):
        return "", "the driver finds no card"
    return card.value.decode(errors="replace"), ""


def activate(backend: Backend) -> None:
    """Make this process use `backend`.

    Dr.Jit searches its libraries once, when it is imported. If it is already loaded, its own
    choice is accepted unless its version is known to fail.

    Raises `BackendError`: the libLLVM cannot be loaded, or Dr.Jit is already loaded without a
    library that `backend` needs.
    """
    if "drjit" in sys.modules:
        check_loaded(backend.name)
        return
    library = backend.libllvm
    if library is None:  # next to CUDA, too: the reference kernel of timings runs on the CPU
        library = next((p for p in find_libllvm() if not rejection_reason(llvm_version(p))), None)
    try:
        load([*required_libraries(library), *([str(library)] if library else [])])
    except OSError as error:
        raise BackendError(f"{library}: cannot be loaded ({error}); {REMEDY}") from error
    if library:
        os.environ[LLVM_VARIABLE] = str(library)


def check_loaded(name: str) -> None:
    """Raise `BackendError` unless Dr.Jit, as it is loaded, can use CUDA or LLVM."""
    drjit = sys.modules["drjit"]
    way_out = "import inim.render.library, which chooses one, before mitsuba and drjit"
    if name == "cuda":
        if not drjit.has_backend(drjit.JitBackend.CUDA):
            raise BackendError(
                "Dr.Jit finds no CUDA, or not the one that it needs; use --backend llvm"
            )
        return
    if not drjit.has_backend(drjit.JitBackend.LLVM):
        raise BackendError(f"Dr.Jit is loaded already, and found no usable libLLVM; {way_out}")
    reason = rejection_reason(".".join(map(str, drjit.detail.llvm_version())))
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
