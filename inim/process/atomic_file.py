"""Files that appear whole or not at all, temporary folders, and errors of writing them."""

from __future__ import annotations

import shutil
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from inim.errors import FileError
from inim.process.interrupts import cleaned_up


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield the path of a temporary file, which replaces `path` if the block ends without error.

    The file is in the same folder, which is created if needed, and has the same suffix.
    """
    # Several machines may share the folder: process numbers are not unique.
    temporary = path.with_name(f".{path.stem}.{uuid.uuid4().hex}.partial{path.suffix}")
    with cleaned_up(partial(temporary.unlink, missing_ok=True)):
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(path)


@contextmanager
def temporary_folder(place: Path, prefix: str) -> Iterator[Path]:
    """Yield the absolute path of a new private folder in `place`; remove it afterwards."""
    folder = place.absolute() / f"{prefix}{uuid.uuid4().hex}.partial"
    with cleaned_up(partial(shutil.rmtree, folder, ignore_errors=True)):
        folder.mkdir(mode=0o700)
        yield folder


@contextmanager
def file_errors(path: Path, remedy: str = "choose another folder with -o") -> Iterator[None]:
    """Convert an `OSError` in the block into a `FileError` with the path and the remedy."""
    try:
        yield
    except OSError as error:
        cause = error.strerror or error
        raise FileError(f"{path}: cannot be written ({cause}); {remedy}") from error


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill a temporary file next to `path`, then rename it into place.

    Raises `FileError`: the folder cannot be written or the disk is full; `path` is then unchanged.
    """
    remedy = "free some space or choose another folder with -o"
    with file_errors(path, remedy), atomic_file(path) as temporary:
        write(temporary)
