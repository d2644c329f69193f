"""One supervised worker process per job: the channel, and output folders.

They need POSIX: locks that end with their process, folders opened without
following links, memory limits. On other systems a one-line error is raised.
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
