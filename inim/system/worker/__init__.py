"""One supervised worker process per job, and output folders; they need POSIX locks and limits."""

from inim.system.errors import BackendError

try:
    import fcntl as fcntl
    import resource as resource
except ModuleNotFoundError:
    raise BackendError(
        "rendering and reports need Linux or macOS: on Windows, run inim in WSL; generate, "
        "inspect, new-scene and export work here"
    ) from None
