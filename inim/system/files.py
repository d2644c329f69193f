"""Reading and writing of files, without the renderer.

This module opens files given by users: regular files only, read up to a limit. Pipes block their
readers and devices never end. The check uses the opened descriptor, because the file behind a name
may change in between.
"""

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from inim.system.errors import FileError

# Do not wait for a pipe's writer; do not become a terminal's controlling process.
_FLAGS = os.O_RDONLY | sum(
    getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_BINARY")
)


@contextmanager
def open_file(path: Path, *, label: str = "", remedy: str = "") -> Iterator[BinaryIO]:
    """Open a regular file for reading bytes.

    * `label`: name for error messages; by default the path.
    * `remedy`: end of error messages.

    Raises `FileError`: missing, unreadable (now or while it is open), a folder, a pipe, a device or
    a socket.
    """
    try:
        descriptor = os.open(path, _FLAGS)
    except (OSError, ValueError) as error:
        raise _error(path, _describe(error), label, remedy) from None
    try:
        mode = os.fstat(descriptor).st_mode
        if not stat.S_ISREG(mode):
            problem = "is a folder" if stat.S_ISDIR(mode) else _IRREGULAR
            raise _error(path, problem, label, remedy)
        with open(descriptor, "rb", closefd=False) as file:
            yield file
    except OSError as error:
        raise _error(path, _describe(error), label, remedy) from None
    finally:
        os.close(descriptor)


def utf8_name(path: Path) -> str:
    """Name of a file for libraries that accept UTF-8 only; raises `FileError` for others."""
    name = str(path)
    try:
        name.encode()
    except UnicodeEncodeError:
        raise _error(path, "the name is not UTF-8", "", "rename the file or its folder") from None
    return name


def check_file(path: Path) -> None:
    """Raise the errors of `open_file`, for files that another library opens."""
    with open_file(path):
        pass


def read_file(path: Path, most_bytes: int, *, label: str = "", remedy: str = "") -> bytes:
    """Read a regular file; other parameters and errors as for `open_file`.

    * `most_bytes`: largest accepted file size; larger files raise `FileError`.
    """
    with open_file(path, label=label, remedy=remedy) as file:
        size = os.fstat(file.fileno()).st_size
        # Read one more byte: an unreadable file must raise an error even if its size is 0.
        data = (file.read(size + 1) or b"")[:size] if size <= most_bytes else b""
    if size > most_bytes:
        limit = f"{most_bytes / 2**20:g} MiB"
        raise _error(path, f"has {size} bytes, and at most {limit} are read", label, remedy)
    return data


_IRREGULAR = "is not a regular file (a pipe, a device or a socket)"
_PROBLEMS = {errno.ENOENT: "no such file", errno.ENXIO: _IRREGULAR, errno.ENODEV: _IRREGULAR}


def _describe(error: OSError | ValueError) -> str:
    if not isinstance(error, OSError):  # NUL in the name, or not encodable
        return "no such file"
    return _PROBLEMS.get(error.errno or 0, f"cannot be read ({error.strerror or error})")


def _error(path: Path, problem: str, label: str, remedy: str) -> FileError:
    return FileError(f"{label or path}: {problem}{'; ' if remedy else ''}{remedy}")
