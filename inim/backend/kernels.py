"""Kernels compiled by numba: the only importer of numba, and the decorator of every kernel.

numba reads `.numba_config.yaml` from the current folder when it is imported and whenever it
compiles. That file can name a folder of compiled kernels, which numba executes. Kernels of this
package ignore it. A program's own kernels still obey it.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from inim.backend.numba_cache import cache_folder
from inim.errors import BackendError
from inim.process.current_folder import configuration_hidden

with configuration_hidden():
    import numba
    from numba.core import compiler, config

prange = numba.prange


class _Compiler(compiler.Compiler):  # type: ignore[misc]
    """Numba's compiler with the configuration that this process has already."""

    def __init__(self, *arguments: Any) -> None:
        with _fixed_configuration():
            super().__init__(*arguments)

    def _compile_core(self) -> Any:
        with _fixed_configuration():
            return super()._compile_core()


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
    function: Callable[..., Any] | None = None, *, parallel: bool = False, inline: str = "never"
) -> Any:
    """Compile a function on its first call, and keep the result on disk.

    Parameters
    ----------
    function : callable
    parallel : bool
        Run the turns of its `prange` loops on all threads.
    inline : {"never", "always"}
        Copy the function into its callers.
    """
    if function is None:
        return partial(compiled, parallel=parallel, inline=inline)
    folder = cache_folder(Path(function.__code__.co_filename).parent)
    before, config.CACHE_DIR = config.CACHE_DIR, folder
    try:
        kernel = numba.njit(
            parallel=parallel, inline=inline, cache=True, nogil=True, pipeline_class=_Compiler
        )(function)
    finally:
        config.CACHE_DIR = before
    if parallel:
        _parallel_kernels.append(kernel)
    if _is_forked:
        _refuse_after_fork()
    return kernel


_parallel_kernels: list[Any] = []
_is_forked = False


def _refuse_after_fork() -> None:
    """Make parallel kernels raise in a forked process, which GNU OpenMP would end.

    A pool of processes would start another one, and never return.
    """
    global _is_forked
    layer = numba.np.ufunc.parallel
    if layer._is_initialized and layer.threading_layer() == "omp" and sys.platform == "linux":
        _is_forked = True
        for kernel in _parallel_kernels:
            kernel._reset_overloads()
            kernel._compile_for_args = _refuse


def _refuse(*_: object, **__: object) -> NoReturn:
    raise BackendError(
        "this process was forked from one that has run kernels, whose threads it lacks; start it "
        "by multiprocessing.get_context('spawn') instead, or set NUMBA_THREADING_LAYER=workqueue"
    )


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_refuse_after_fork)
