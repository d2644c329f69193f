"""All code that uses Mitsuba and Dr.Jit.

Importing this package points Dr.Jit at a libLLVM that works here, before anything loads it: it
looks for one only once, and some kill the process. `inim.render.variant.use` then sets the variant.
"""

import sys

from inim import backend

if "drjit" not in sys.modules:
    backend.activate(backend.choose_backend())
