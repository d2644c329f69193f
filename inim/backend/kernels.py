"""Kernels compiled by numba: the only importer of numba, and the decorator of every kernel.

numba reads `.numba_config.yaml` from the current folder when it is imported and whenever it
compiles. That file can name a folder of compiled kernels, which numba executes. Kernels of this
package ignore it. A program's own kernels still obey it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from inim.backend.numba_cache import cache_folder
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
    before, config.CACHE_DIR = (
        config.CACHE_DIR,
        cache_folder(Path(function.__code__.co_filename).parent),
    )
    try:
        return numba.njit(
            parallel=parallel, inline=inline, cache=True, nogil=True, pipeline_class=_Compiler
        )(function)
    finally:
        config.CACHE_DIR = before
