"""Kernels compiled by numba: the only importer of numba, and the decorator of every kernel.

numba reads `.numba_config.yaml` from the current folder when it is imported and whenever it
compiles. That file can name a folder of compiled kernels, which numba executes. Kernels of this
package ignore it. A program's own kernels still obey it.

Compiled kernels are in a folder of the user's cache that is named after the digest of the code and
of the compiler (`cache_folder`). A damaged or full cache raises in the middle of a run;
`disable_cache` lets the process continue without it.
"""

import hashlib
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import cache, partial
from pathlib import Path
from traceback import walk_tb
from typing import Any

import numpy as np

from inim.system.cache import code_digest, value_digest
from inim.system.errors import FileError
from inim.system.process.machine import user_cache_folder
from inim.system.process.python_process import configuration_hidden

with configuration_hidden():
    import llvmlite
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


@contextmanager
def _fixed_configuration() -> Iterator[None]:
    """Read no configuration meanwhile; numba's own lock keeps other compilations out."""
    reload_config = config.reload_config
    config.reload_config = lambda: None
    try:
        yield
    finally:
        config.reload_config = reload_config


def compiled(
    function: Callable[..., Any] | None = None,
    *,
    inline: str = "never",
    error_model: str = "python",
) -> Any:
    """Compile a function on its first call, and keep the result on disk.

    * `inline`, {"never", "always"}: copy the function into its callers.
    * `error_model`, {"python", "numpy"}: with "numpy", a division by zero gives infinity instead of
      an exception, so that a loop with divisions is vectorised.
    """
    if function is None:
        return partial(compiled, inline=inline, error_model=error_model)
    before, config.CACHE_DIR = config.CACHE_DIR, str(cache_folder())
    try:
        kernel = numba.njit(
            inline=inline,
            error_model=error_model,
            cache=True,
            nogil=True,
            pipeline_class=_Compiler,
        )(function)
    finally:
        config.CACHE_DIR = before
    if not config.DISABLE_JIT:
        files, base = kernel._cache._cache_file, kernel._cache._impl.filename_base
        kernel._cache._cache_file = _KernelFiles(files._cache_path, base, files._source_stamp)
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
# Versions of the program whose kernels are kept: those used last, some 20 MB each.
_KEPT = 16


def cache_folder() -> Path:
    """Private folder for compiled kernels, named after the digest of all that decides them.

    It is in NUMBA_CACHE_DIR if that is set, otherwise in the user's cache folder, or in the folder
    for temporary files where that cannot be written. numba compares a kernel's own file only; the
    functions that it calls are in others.

    Raises `FileError`: no folder can be written, or it could contain code of other users.
    """
    code = code_digest("generators", "system/backend/kernels.py")
    compilers = [sys.version, numba.__version__, llvmlite.__version__, np.__version__]
    named, cache = os.environ.get(_VARIABLE), user_cache_folder()
    places = [cache / "kernels"] if cache else []
    places = [Path(named)] if named else [*places, Path(tempfile.gettempdir())]
    prefix = f"inim-{_user()}-"
    for place in places:
        folder = place / f"{prefix}{value_digest([code, *compilers])}"
        with suppress(OSError):
            is_new = not folder.is_dir()
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            if _is_private(folder) and os.access(folder, os.W_OK | os.X_OK):
                os.utime(folder)  # the time of its last use
                if is_new:
                    _remove_oldest(place, prefix)
                return folder
    raise FileError(
        f"{folder}: compiled kernels cannot be written there, or other users can; set {_VARIABLE} "
        "to a folder of your own"
    )


def _remove_oldest(place: Path, prefix: str) -> None:
    """Remove the kernels of old versions of the program."""
    with suppress(OSError):  # another process may remove them, too
        folders = sorted(place.glob(f"{prefix}*"), key=lambda folder: folder.stat().st_mtime)
        for folder in folders[:-_KEPT]:
            shutil.rmtree(folder, ignore_errors=True)


def is_cache_fault(error: BaseException) -> bool:
    """True if an exception comes from numba's reading or writing of compiled kernels."""
    frames = walk_tb(error.__traceback__)
    return caching.__file__ in [frame.f_code.co_filename for frame, _ in frames]


def disable_cache() -> None:
    """Compile kernels without the cache from now on, and remove its indices: one is unreadable."""
    for index in cache_folder().rglob("*.nbi"):
        with suppress(OSError):
            index.unlink()
    caching.Cache.load_overload = lambda *_: None
    caching.Cache.save_overload = lambda *_: None


def _user() -> int:
    """The user's number; 0, as of all files, where users have none."""
    return os.getuid() if hasattr(os, "getuid") else 0


def _is_private(folder: Path) -> bool:
    status = folder.lstat()
    ours = status.st_uid == _user() and not status.st_mode & (stat.S_IRWXG | stat.S_IRWXO)
    return stat.S_ISDIR(status.st_mode) and ours
