"""Kernels compiled by numba: the only importer of numba, and the decorator of every kernel.

numba reads `.numba_config.yaml` from the current folder when it is imported and whenever it
compiles. That file can name a folder of compiled kernels, which numba executes. Kernels of this
package ignore it. A program's own kernels still obey it.

numba writes compiled kernels next to the source, or to the user's home, and fails to start
if neither is writable; `cache_folder` chooses another folder. A damaged or full cache raises in
the middle of a run; `disable_cache` lets the process continue without it.
"""

from __future__ import annotations

import hashlib
import os
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any

from inim.system.cache import code_digest
from inim.system.errors import FileError
from inim.system.process.python_process import configuration_hidden

with configuration_hidden():
    import numba
    from numba.core import caching, compiler, config


class _Compiler(compiler.Compiler):  # type: ignore[misc]
    """Numba's compiler with the configuration that this process has already."""

    def __init__(self, *arguments: Any) -> None:
        with _fixed_configuration():
            super().__init__(*arguments)

    def _compile_core(self) -> Any:
        with _fixed_configuration():
            return super()._compile_core()


class _KernelFiles(caching.IndexDataCacheFile):  # type: ignore[misc]
    """Numba's files of a kernel: an index, and for each signature one with machine code."""

    def save(self, key: Any, data: Any) -> None:
        """Name the file after the signature.

        numba numbers the files. Two processes that save different signatures at the same time would
        take the same number, and one would later run the other's code.
        """
        digest = hashlib.sha256(repr(key).encode()).hexdigest()[:16]
        base = self._index_name.removesuffix(".nbi")
        self._data_name_pattern = f"{base}-{digest}.{{number:d}}.nbc"
        super().save(key, data)

    def _load_index(self) -> Any:
        """Kernels by signature; none if an earlier program's signatures have types that are gone.

        numba reads the signatures before it compares the stamps.
        """
        try:
            return super()._load_index()
        except (AttributeError, ImportError):
            return {}


@contextmanager
def _fixed_configuration() -> Iterator[None]:
    """Read no configuration meanwhile; numba's own lock keeps other compilations out."""
    reload_config = config.reload_config
    config.reload_config = lambda: None
    try:
        yield
    finally:
        config.reload_config = reload_config


def compiled(function: Callable[..., Any] | None = None, *, inline: str = "never") -> Any:
    """Compile a function on its first call, and keep the result on disk.

    * `inline`, {"never", "always"}: copy the function into its callers.
    """
    if function is None:
        return partial(compiled, inline=inline)
    folder = cache_folder(Path(function.__code__.co_filename).parent)
    before, config.CACHE_DIR = config.CACHE_DIR, folder
    try:
        kernel = numba.njit(inline=inline, cache=True, nogil=True, pipeline_class=_Compiler)(
            function
        )
    finally:
        config.CACHE_DIR = before
    if not config.DISABLE_JIT:
        files = kernel._cache._cache_file
        # numba compares the kernel's own file only; the functions that it calls are in others.
        stamp = (files._source_stamp, code_digest("generators", "system/backend/kernels.py"))
        kernel._cache._cache_file = _KernelFiles(
            files._cache_path, kernel._cache._impl.filename_base, stamp
        )
    return kernel


def share_rows(kernel: Callable[..., None], rows: int, *arguments: Any) -> None:
    """Run ``kernel(begin, end, *arguments)`` over parts of some rows, on several threads.

    A kernel that numba shares among its own threads takes a second longer to compile, and does not
    survive a fork.
    """
    threads = min(_thread_count, rows)
    if threads < 2 or config.DISABLE_JIT:
        kernel(0, rows, *arguments)
        return
    kernel(0, 0, *arguments)  # compiled in this thread only
    part = -(-rows // (_PARTS * threads))
    begins = range(0, rows, part)
    share(lambda begin: kernel(begin, min(begin + part, rows), *arguments), begins)


def share(task: Callable[[Any], object], items: Sequence[Any]) -> None:
    """Call a function for each of some items, on several threads.

    Inside a task, each of them works alone.
    """
    others, remaining = min(_thread_count, len(items)) - 1, iter(items)

    def take_items() -> None:
        for item in remaining:
            task(item)

    threads = _threads(os.getpid(), others) if others > 0 else None
    helping = [threads.submit(take_items) for _ in range(others)] if threads else []
    try:
        take_items()
    finally:
        late = [future for future in helping if not future.cancel()]
        for future in late:
            future.result()


def parts_of(items: Sequence[Any]) -> list[Sequence[Any]]:
    """Parts of some items for `share`, if each part has a start of its own."""
    count = _PARTS * _thread_count
    return [items[n::count] for n in range(min(count, len(items)))]


# Parts of the rows for each thread: the last ones end at about the same time.
_PARTS = 8


@cache
def _threads(process: int, count: int) -> ThreadPoolExecutor:  # noqa: ARG001 (a fork has none)
    """Threads of a process that take parts of rows next to the caller."""
    return ThreadPoolExecutor(count, "kernel")


#: Number of threads that kernels may use; NUMBA_NUM_THREADS sets it.
MOST_THREADS = int(config.NUMBA_NUM_THREADS)
_thread_count = MOST_THREADS


@contextmanager
def limited_threads(count: int) -> Iterator[None]:
    """Run kernels on a number of threads, of this whole process, during a block."""
    global _thread_count
    before, _thread_count = _thread_count, count
    try:
        yield
    finally:
        _thread_count = before


_VARIABLE = "NUMBA_CACHE_DIR"


def cache_folder(package: Path) -> str:
    """Folder for compiled kernels; empty if numba finds a usable folder itself.

    * `package`: the folder whose modules are compiled.

    Raises `FileError`: no folder can be written.
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
    """True if an exception comes from numba's reading or writing of compiled kernels."""
    return caching.__file__ in [f.f_code.co_filename for f in _frames(error.__traceback__)]


def disable_cache(error: BaseException) -> None:
    """Compile kernels without the cache from now on, and remove an unreadable index.

    * `error`: for which `is_cache_fault` holds.
    """
    for frame in _frames(error.__traceback__):
        index = getattr(frame.f_locals.get("self"), "_index_path", None)
        if frame.f_code.co_filename == caching.__file__ and isinstance(index, str):
            _remove_indices(Path(index).parent)
    caching.Cache.load_overload = lambda *_: None
    caching.Cache.save_overload = lambda *_: None


def _remove_indices(folder: Path) -> None:
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
    """True if files can be created in a folder, or it can be created."""
    if not folder.is_absolute():  # nobody knows the user's home
        return False
    while not os.path.lexists(folder) and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)


def _user() -> int:
    """The user's number; 0, as of all files, where users have none."""
    return os.getuid() if hasattr(os, "getuid") else 0


def _is_private(folder: Path) -> bool:
    status = folder.lstat()
    ours = status.st_uid == _user() and not status.st_mode & (stat.S_IRWXG | stat.S_IRWXO)
    return stat.S_ISDIR(status.st_mode) and ours
