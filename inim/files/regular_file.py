"""The door for files that a user names: opened as regular files only, and read to a limit.

A pipe keeps its reader waiting for ever and a device never ends; so what was opened is looked at,
not what a name meant a moment before.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from inim.errors import FileError

# Neither waits for a pipe's other end, nor takes a terminal for its own.
_FLAGS = os.O_RDONLY | sum(
    getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_BINARY")
)


@contextmanager
def open_file(path: Path, *, shown: str = "", way_out: str = "") -> Iterator[BinaryIO]:
    """A regular file, open to read its bytes.

    Parameters
    ----------
    path : Path
    shown : str
        What to call it in errors; its path otherwise.
    way_out : str
        What errors end with.

    Raises
    ------
    FileError
        Missing, unreadable, also later while it is open, a folder, or no regular file: a pipe, a
        device, a socket.
    """
    try:
        descriptor = os.open(path, _FLAGS)
    except (OSError, ValueError) as error:
        raise _error(path, _why(error), shown, way_out) from None
    try:
        mode = os.fstat(descriptor).st_mode
        if not stat.S_ISREG(mode):
            words = "is a folder" if stat.S_ISDIR(mode) else _IRREGULAR
            raise _error(path, words, shown, way_out)
        with open(descriptor, "rb", closefd=False) as file:
            yield file
    except OSError as error:
        raise _error(path, _why(error), shown, way_out) from None
    finally:
        os.close(descriptor)


def check_file(path: Path) -> None:
    """Raise as `open_file` does; for files that others open by their names."""
    with open_file(path):
        pass


def read_file(path: Path, most_bytes: int, *, shown: str = "", way_out: str = "") -> bytes:
    """All of a regular file; parameters and errors as of `open_file`, and one for too large a file.

    Parameters
    ----------
    most_bytes : int
        The largest that is read.
    """
    with open_file(path, shown=shown, way_out=way_out) as file:
        size = os.fstat(file.fileno()).st_size
        # A byte more, so that a file that cannot be read is an error though it states no size.
        data = (file.read(size + 1) or b"")[:size] if size <= most_bytes else b""
    if size > most_bytes:
        limit = f"{most_bytes / 2**20:g} MiB"
        raise _error(path, f"has {size} bytes, and at most {limit} are read", shown, way_out)
    return data


_IRREGULAR = "is no regular file (a pipe, a device or a socket)"
_WORDS = {errno.ENOENT: "no such file", errno.ENXIO: _IRREGULAR, errno.ENODEV: _IRREGULAR}


def _why(error: OSError | ValueError) -> str:
    if not isinstance(error, OSError):  # a name with a NUL in it, or none in this locale
        return "no such file"
    return _WORDS.get(error.errno or 0, f"cannot be read ({error.strerror or error})")


def _error(path: Path, words: str, shown: str, way_out: str) -> FileError:
    return FileError(f"{shown or path}: {words}{'; ' if way_out else ''}{way_out}")
