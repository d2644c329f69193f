"""Where numba keeps what it compiles: a folder where it would find none, and life without one.

Numba writes beside the source, or else below the user's home, and refuses to start where neither
can be written; a damaged or full cache raises in the middle of a run.
"""

from __future__ import annotations

import os
import stat
import sys
import tempfile
from pathlib import Path
from types import FrameType, TracebackType

from inim.errors import FileError

_VARIABLE = "NUMBA_CACHE_DIR"
_CACHING = "numba.core.caching"


def cache_folder(package: Path) -> str:
    """The folder for compiled kernels that numba must be given; empty where it finds its own.

    Parameters
    ----------
    package : Path
        The folder whose modules are compiled.

    Raises
    ------
    FileError
        No folder can be written.
    """
    named = os.environ.get(_VARIABLE, "")
    if named or any(map(_can_hold, (package / "__pycache__", _user_cache()))):
        return named
    folder = Path(tempfile.gettempdir()) / f"inim-{_user()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
    except OSError as error:
        raise FileError(
            f"{folder}: no folder for compiled kernels can be written ({error.strerror}); set "
            f"{_VARIABLE} to one that can"
        ) from None
    if not _is_private(folder):  # compiled code that others put there would be run
        raise FileError(
            f"{folder}: belongs to another user or is open to others; set {_VARIABLE} to a folder "
            "of your own"
        )
    return str(folder)


def is_cache_fault(error: BaseException) -> bool:
    """Whether an exception comes out of numba's reading or writing of compiled kernels."""
    module = sys.modules.get(_CACHING)
    files = [frame.f_code.co_filename for frame in _frames(error.__traceback__)]
    return module is not None and module.__file__ in files


def go_without_cache(error: BaseException) -> None:
    """Let this process compile what it needs, and drop the index that could not be read.

    Parameters
    ----------
    error : BaseException
        For which `is_cache_fault` holds.
    """
    caching = sys.modules[_CACHING]
    for frame in _frames(error.__traceback__):
        index = getattr(frame.f_locals.get("self"), "_index_path", None)
        if frame.f_code.co_filename == caching.__file__ and isinstance(index, str):
            _forget(Path(index).parent)
    caching.Cache.load_overload = lambda *_: None
    caching.Cache.save_overload = lambda *_: None


def _forget(folder: Path) -> None:
    """Remove numba's indices, by which it finds compiled kernels, as far as that is allowed."""
    for index in folder.glob("*.nbi"):
        try:
            index.unlink()
        except OSError:
            return


def _frames(traceback: TracebackType | None) -> list[FrameType]:
    frames: list[FrameType] = []
    while traceback:
        frames.append(traceback.tb_frame)
        traceback = traceback.tb_next
    return frames


def _user_cache() -> Path:
    """The folder below the user's home that numba turns to."""
    below_home = "~/Library/Caches" if sys.platform == "darwin" else "~/.cache"
    home = os.path.expanduser(below_home)  # noqa: PTH111 (stays as it is where there is none)
    return Path(os.environ.get("XDG_CACHE_HOME") or home) / "numba"


def _can_hold(folder: Path) -> bool:
    """Whether files can be made in a folder, or it can be made."""
    if not folder.is_absolute():  # nobody knows the user's home
        return False
    while not os.path.lexists(folder) and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)


def _user() -> int:
    """The user's number; 0, as of all files, where users have none."""
    return os.getuid() if hasattr(os, "getuid") else 0


def _is_private(folder: Path) -> bool:
    found = folder.lstat()
    ours = found.st_uid == _user() and not found.st_mode & (stat.S_IRWXG | stat.S_IRWXO)
    return stat.S_ISDIR(found.st_mode) and ours
