"""Mitsuba and Dr.Jit, with a libLLVM that works here.

Importing this module points Dr.Jit at a libLLVM that works here, before anything loads it: it
looks for one only once, and some kill the process. `inim.render.variant.use` then sets the variant.

Mitsuba looks up plugins and data, such as `plugins/path.so` and `data/ior/Au.k.spd`, in the current
folder before its own. After this import it looks in its own folder first, so files elsewhere
replace none of them. In a user's program, Mitsuba still loads plugins and data that only exist in
the current folder. inim's own processes run in an empty one.
"""

import sys
from pathlib import Path

from inim.system import backend
from inim.system.errors import BackendError, missing_package

if "drjit" not in sys.modules:
    backend.activate(backend.choose_backend())

try:
    import drjit as dr
    import mitsuba as mi
except ImportError as error:
    raise missing_package(error) or BackendError(
        f"Mitsuba cannot be imported: {error}; {backend.REMEDY}"
    ) from error

mi.file_resolver().prepend(str(Path(mi.__file__).resolve().parent))

__all__ = ["dr", "mi"]
