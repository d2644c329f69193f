"""One supervised worker process per job, and what both sides need: a channel, output folders.

They need what POSIX systems have: locks that end with their process, folders opened without
following links, memory limits. Where there is none of it, a line says so.
"""

from inim.errors import BackendError

try:
    import fcntl as fcntl
    import resource as resource
except ModuleNotFoundError:
    raise BackendError(
        "rendering and reports need Linux or macOS: on Windows, run inim in WSL; generate, "
        "inspect, new-scene, export and depth work here"
    ) from None
