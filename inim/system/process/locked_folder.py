"""Private folders that are locked while their process runs, so that a later process removes those
that a killed one has left. POSIX only.
"""

import fcntl
import glob
import os
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from inim.system.process.atomic_file import temporary_folder


@contextmanager
def lock_folder(folder: Path, operation: int = fcntl.LOCK_EX) -> Iterator[int]:
    """Hold the lock of a folder, which ends with the process; without LOCK_NB, wait for it.

    Yields the descriptor of the folder.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            fcntl.flock(descriptor, operation)
        except OSError:
            if operation & fcntl.LOCK_NB:
                raise
        yield descriptor
    finally:
        os.close(descriptor)


@contextmanager
def locked_folder(place: Path, prefix: str) -> Iterator[Path]:
    """Yield the absolute path of a new private folder in `place`, and remove it afterwards.

    Also removes this user's folders of the same prefix that killed processes have left.
    """
    for path in place.glob(f"{glob.escape(prefix)}*.partial"):
        with suppress(OSError):  # the folder of a running process is locked
            if not path.is_symlink() and path.lstat().st_uid == os.getuid():
                with lock_folder(path, fcntl.LOCK_EX | fcntl.LOCK_NB):
                    shutil.rmtree(path, ignore_errors=True)
    while True:
        with ExitStack() as stack:
            folder = stack.enter_context(temporary_folder(place, prefix))
            # Another process may remove it between its creation and the lock.
            try:
                descriptor = stack.enter_context(lock_folder(folder, fcntl.LOCK_SH))
            except FileNotFoundError:
                continue
            if os.fstat(descriptor).st_nlink:
                yield folder
                return
