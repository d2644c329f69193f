"""Choosing the Mitsuba variant once per process, with inim's plugins registered in it."""

from __future__ import annotations

from functools import cache

import drjit as dr
import mitsuba as mi

from inim import backend as backends
from inim.render import counter_sampler, display_emitter, sensors

__all__ = ["use"]

# With one thread Mitsuba's own file readers hang, and Embree builds crawl.
_FEWEST_THREADS = 2


def use(wanted: str = "auto") -> backends.Backend:
    """Activate a backend, set its variant and register the plugins; repeating it is free.

    Parameters
    ----------
    wanted : {"auto", "llvm", "cuda"}

    Raises
    ------
    BackendError
        When none works on this machine.
    """
    backend = backends.choose_backend(wanted)
    if mi.variant() != backend.variant:  # else it works already, with whatever library
        backends.activate(backend)
    _register_for_good()
    if mi.variant() != backend.variant:
        if dr.thread_count() < _FEWEST_THREADS:
            dr.set_thread_count(_FEWEST_THREADS)
        mi.set_variant(backend.variant)
        mi.set_log_level(mi.LogLevel.Error)
    return backend


@cache
def _register_for_good() -> None:
    """Register the plugins in the variant there is, if any, and in all that follow."""
    mi.detail.add_variant_callback(_register)
    _register()


def _register(_old: str | None = None, _new: str | None = None) -> None:
    """Register the plugins anew: they belong to the variant they were made in."""
    if mi.variant() is None or mi.variant().startswith("scalar"):
        return
    for plugins in (counter_sampler, sensors, display_emitter):
        plugins.register()
