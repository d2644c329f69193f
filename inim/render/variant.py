"""The Mitsuba variant: set permanently in inim's own processes, temporarily in others."""

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache

from inim.render import counter_sampler, display_emitter, scene, sensors
from inim.render.library import dr, mi
from inim.system import backend as backends
from inim.system.errors import BackendError, UsageError
from inim.system.plugins import PluginModule
from inim.system.process import machine

# With one thread Mitsuba's own file readers hang, and Embree builds crawl.
_FEWEST_THREADS = 2


def use(requested: str = "auto") -> backends.Backend:
    """Set a backend's variant and inim's plugins permanently, in one of inim's own processes.

    Repeating it is free. `requested` is "auto", "llvm" or "cuda". Raises `BackendError` if none
    works on this machine.
    """
    backend = backends.choose_backend(requested)
    register_plugins()
    if mi.variant() != backend.variant:
        backends.activate(backend)
        _check_version(backend)
        count = os.environ.get(machine.THREADS_VARIABLE, "")
        threads = int(count) if count.isdecimal() else dr.thread_count()
        dr.set_thread_count(max(_FEWEST_THREADS, threads))
        mi.set_variant(backend.variant)
        mi.set_log_level(mi.LogLevel.Error)
    return backend


def _check_version(backend: backends.Backend) -> None:
    """Results are kept under the version of LLVM that made them: it must be that one."""
    loaded = ".".join(map(str, dr.detail.llvm_version()))
    if backend.name == "llvm" and loaded != backend.libllvm_version:
        raise BackendError(
            f"LLVM {backend.libllvm_version} was chosen, and Dr.Jit is loaded already, with "
            f"{loaded}; import inim.render.library before drjit"
        )


def load_plugins(modules: Iterable[PluginModule]) -> None:
    """Import modules that register Mitsuba plugins in the active variant, in a worker.

    Raises `UsageError` if a module cannot be loaded, or changes the variant.
    """
    before = mi.variant()
    for module in modules:
        module.load()
        if mi.variant() != before:
            raise UsageError(
                f"--plugin {module.name}: sets the variant {mi.variant()} instead of {before}; "
                "only register plugins in it"
            )


@contextmanager
def temporary(requested: str = "auto") -> Iterator[None]:
    """Use an RGB variant temporarily, in a process that runs another program.

    The active variant's backend is kept if `requested` allows it. Afterwards, also after an
    exception, the variant and the thread count are restored. If no variant was active, the new one
    remains, because Mitsuba cannot unset it. `requested` is "auto", "llvm" or "cuda"; raises
    `UsageError` for another word, and `BackendError` if no backend works on this machine.
    """
    before, threads = mi.variant(), dr.thread_count()
    variant = _choose_variant(before or "", requested)
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


def _choose_variant(active: str, requested: str) -> str:
    """The RGB variant of the active one's backend, or of the one to be chosen."""
    family = active.partition("_")[0]
    if requested in ("auto", family) and family in ("cuda", "llvm"):
        backend = backends.Backend(family, f"{family}_ad_rgb", None, None, "")
    else:
        backend = backends.choose_backend(requested)
    backends.activate(backend)
    return backend.variant


@cache
def register_plugins() -> None:
    """Register inim's plugins in the active variant, if any, and in all later ones.

    Afterwards `mi.load_file` and `mi.load_dict` accept the emitter `inim_display` and the sensors
    `inim_eye` and `inim_pickup`; see "A display in a Mitsuba scene" in the documentation. A
    repeated call has no effect. The plugins work in the variants ``llvm_ad_rgb`` and
    ``cuda_ad_rgb``, and raise a one-line error in any other. Import `inim.render` before
    `mitsuba`: it chooses a libLLVM that works. Otherwise Dr.Jit takes the system's, and
    `mi.set_variant` raises `BackendError` if that one aborts the process.
    """
    mi.detail.add_variant_callback(_register)
    _register()


def _register(_old: str | None = None, _new: str | None = None) -> None:
    """Register the plugins again: they belong to the active variant."""
    if mi.variant() is None:
        return
    if mi.variant().startswith("llvm"):
        backends.check_loaded("llvm")
    if not mi.variant().startswith("scalar"):
        counter_sampler.register()
    for plugins in (scene, sensors, display_emitter):
        plugins.register()
