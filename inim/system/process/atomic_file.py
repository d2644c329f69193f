"""Files that appear whole or not at all, temporary folders, and errors of writing them."""

import errno
import os
import shutil
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from inim.system.errors import FileError
from inim.system.process.interrupts import cleaned_up, delayed_interrupts

# Of files that a library writes by their suffix, such as .webm.
_LONGEST_SUFFIX = 16
# Temporary files, and the paths that they replace together; None outside `published_together`.
_unpublished: dict[Path, Path] | None = None


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield the path of a temporary file, which replaces `path` if the block ends without error.

    The file is in the same folder, which is created if needed, and has the same suffix. In
    `published_together` it replaces `path` later.
    """
    # A name may be as long as the file system allows, and not UTF-8. Several machines may share the
    # folder: process numbers are not unique.
    suffix = path.suffix if len(path.suffix) < _LONGEST_SUFFIX and path.suffix.isascii() else ""
    temporary = path.with_name(f".inim.{uuid.uuid4().hex}.partial{suffix}")
    with cleaned_up(partial(_discard, temporary)):
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if _unpublished is None:
            temporary.replace(path)
        else:
            _unpublished[temporary] = path


def _discard(temporary: Path) -> None:
    if _unpublished is None or temporary not in _unpublished:
        temporary.unlink(missing_ok=True)


@contextmanager
def published_together() -> Iterator[None]:
    """Write all atomic files of the block, or none: they replace their paths when it ends.

    Blocks may contain others. Files of child processes are not among them.
    """
    global _unpublished
    if _unpublished is not None:
        yield
        return
    files: dict[Path, Path] = {}
    with cleaned_up(partial(_discard_all, files)):
        _unpublished = files
        yield
        with delayed_interrupts():
            for temporary, path in files.items():
                with file_errors(path):
                    temporary.replace(path)


def _discard_all(files: dict[Path, Path]) -> None:
    global _unpublished
    _unpublished = None
    for temporary in files:
        temporary.unlink(missing_ok=True)


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
