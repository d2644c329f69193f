"""The Mitsuba variant: set for a process of inim's own, borrowed in anybody else's."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import drjit as dr
import mitsuba as mi

from inim import backend as backends
from inim.errors import BackendError
from inim.render import counter_sampler, display_emitter, scene, sensors
from inim.scene.parameters import check_plugin_folder

# With one thread Mitsuba's own file readers hang, and Embree builds crawl.
_FEWEST_THREADS = 2


def use(wanted: str = "auto") -> backends.Backend:
    """Set a backend's variant for good, with inim's plugins: for a process of inim's own.

    Repeating it is free.

    Parameters
    ----------
    wanted : {"auto", "llvm", "cuda"}

    Raises
    ------
    BackendError
        When none works on this machine.
    """
    check_plugin_folder(
        Path()
    )  # Mitsuba loads plugins from the current folder, whatever it renders
    backend = backends.choose_backend(wanted)
    register_plugins()
    if mi.variant() != backend.variant:
        backends.activate(backend)
        _check_version(backend)
        if dr.thread_count() < _FEWEST_THREADS:
            dr.set_thread_count(_FEWEST_THREADS)
        mi.set_variant(backend.variant)
        mi.set_log_level(mi.LogLevel.Error)
    return backend


def _check_version(backend: backends.Backend) -> None:
    """Results are kept under the version of LLVM that made them: it must be that one."""
    loaded = ".".join(map(str, dr.detail.llvm_version()))
    if backend.name == "llvm" and loaded != backend.libllvm_version:
        raise BackendError(
            f"LLVM {backend.libllvm_version} was chosen, and Dr.Jit is loaded already, with "
            f"{loaded}; import inim.render before drjit"
        )


@contextmanager
def borrowed(wanted: str = "auto") -> Iterator[None]:
    """An RGB variant for as long as it lasts: for a process that somebody else's program runs.

    The active variant's backend is kept where `wanted` allows it. Afterwards, whatever happened,
    the variant and the thread count are as before; only where no variant was active the one used
    stays, as Mitsuba cannot go back to none.

    Parameters
    ----------
    wanted : {"auto", "llvm", "cuda"}

    Raises
    ------
    BackendError
        When none works on this machine.
    UsageError
        `wanted` is none of the three.
    """
    check_plugin_folder(Path())
    before, threads = mi.variant(), dr.thread_count()
    variant = _variant(before or "", wanted)
    register_plugins()
    try:
        if threads < _FEWEST_THREADS:
            dr.set_thread_count(_FEWEST_THREADS)
        if variant != before:
            mi.set_variant(variant)
        yield
    finally:
        if before is not None and mi.variant() != before:
            mi.set_variant(before)
        if dr.thread_count() != threads:
            dr.set_thread_count(threads)


def _variant(active: str, wanted: str) -> str:
    """The RGB variant of the active one's backend, or of the one to be chosen."""
    family = active.partition("_")[0]
    if wanted in ("auto", family) and family in ("cuda", "llvm"):
        backend = backends.Backend(family, f"{family}_ad_rgb", None, None, "")
    else:
        backend = backends.choose_backend(wanted)
    backends.activate(backend)
    return backend.variant


@cache
def register_plugins() -> None:
    """Register inim's plugins in the variant that is active, if any, and in all that follow.

    Afterwards `mi.load_file` and `mi.load_dict` know the emitter `inim_display` and the sensors
    `inim_eye` and `inim_pickup`; see "In a scene of Mitsuba's" in the documents. Repeating it is
    free. They work in the variants ``llvm_ad_rgb`` and ``cuda_ad_rgb``, and say so in any other.
    """
    mi.detail.add_variant_callback(_register)
    _register()


def _register(_old: str | None = None, _new: str | None = None) -> None:
    """Register the plugins anew: they belong to the variant they were made in."""
    if mi.variant() is None:
        return
    if not mi.variant().startswith("scalar"):
        counter_sampler.register()
    for plugins in (scene, sensors, display_emitter):
        plugins.register()
