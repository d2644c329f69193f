"""Where a libLLVM may lie on this machine, and which version each one is."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from inim.backend import machine

__all__ = [
    "LLVM_VARIABLE",
    "PRIVATE_MARKER",
    "SEARCH_VARIABLE",
    "find_libllvm",
    "is_libllvm",
    "known_bad",
    "llvm_version",
    "private_folders",
]

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
    multiarch = getattr(sys.implementation, "_multiarch", "") or f"{os.uname().machine}-linux-gnu"
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
    if version and version[0] <= 16 and os.uname().machine in ("x86_64", "AMD64", "i686"):
        return f"LLVM {version[0]} aborts the process on x86 CPUs"
    return ""
