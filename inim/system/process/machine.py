"""Properties of this machine: processor, memory, the linker's cache and the user's folders."""

import os
import platform
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from inim.system.errors import OutOfMemoryError

#: numba's number of threads, which is also the renderer's in inim's own processes.
THREADS_VARIABLE = "NUMBA_NUM_THREADS"


def cpu_text() -> str:
    """The first processor's lines of /proc/cpuinfo that stay the same between boots."""
    try:
        # One read: a machine with hundreds of cores fills megabytes, line by line.
        with Path("/proc/cpuinfo").open("rb", buffering=0) as file:
            first = file.read(8192).decode(errors="replace").split("\n\n")[0]
    except OSError:
        return " ".join(platform.uname())
    keep = ("model name", "flags", "Features", "CPU part")
    return "\n".join(line for line in first.splitlines() if line.startswith(keep))


def cpu_model() -> str:
    """Name of the processor, or its architecture if unavailable."""
    for line in cpu_text().splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


def cpu_count() -> int:
    """Number of processors available to this process, by its affinity."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def busy_seconds() -> float | None:
    """Processor time of all programs since the machine started, in seconds; None if unavailable."""
    try:
        ticks = [int(word) for word in Path("/proc/stat").read_text().split("\n")[0].split()[1:9]]
    except (OSError, ValueError):
        return None
    idle, waiting = ticks[3:5]
    return (sum(ticks) - idle - waiting) / os.sysconf("SC_CLK_TCK")


def memory_limit_bytes() -> int:
    """Memory limit of this process: a machine's, container's or shell's; 0 if unavailable."""
    return min(_memory_limits().values(), default=0)


def _memory_limits() -> dict[str, int]:
    """Memory limits of this process in bytes, by name; empty if unavailable."""
    if not hasattr(os, "sysconf"):
        return {}
    import resource

    limits = {_MACHINE: os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")}
    sizes = [_number_in(path) for path in _limit_files(Path("/proc/self/cgroup"))]
    if any(sizes):
        limits[_GROUP] = min(size for size in sizes if size)
    # `ulimit -v` limits addresses, of which libraries reserve more than they use.
    for name, kind in (("ulimit -v", resource.RLIMIT_AS), ("ulimit -d", resource.RLIMIT_DATA)):
        size = resource.getrlimit(kind)[0]
        if size != resource.RLIM_INFINITY:
            limits[name] = size
    return limits


_MACHINE, _GROUP = "the machine's memory", "the memory of the container or control group"
# Least limits for NumPy, SciPy, numba and Mitsuba. OpenBLAS, of which NumPy and SciPy have one
# each, reserves memory for each of at most 64 threads. If that fails while a library loads, it is
# tried again forever, and signals are not handled.
_MIB = 2**20
_LEAST_BYTES = {
    _MACHINE: 192 * _MIB,
    _GROUP: 192 * _MIB,
    "ulimit -v": 1536 * _MIB,
    "ulimit -d": 512 * _MIB,
}
_RESERVED_PER_THREAD = 96 * _MIB
_MOST_THREADS = 64


def check_memory() -> None:
    """Raise `OutOfMemoryError` if a memory limit is too low to load numerical libraries."""
    for name, size in _memory_limits().items():
        needed, remedy = _LEAST_BYTES[name], "provide more"
        if name.startswith("ulimit"):
            needed += _RESERVED_PER_THREAD * min(cpu_count(), _MOST_THREADS)
            remedy = f"raise it: {name} {needed // 1024}"
        if size < needed:
            raise OutOfMemoryError(
                f"{name}: {size // _MIB} MiB, below the {needed // _MIB} MiB that numerical "
                f"libraries need on {cpu_count()} processors; {remedy}"
            )


def peak_bytes(*, of_children: bool = False) -> int:
    """Peak memory of this process, or of one of its ended children [bytes]."""
    import resource

    scope = resource.RUSAGE_CHILDREN if of_children else resource.RUSAGE_SELF
    # In KiB by Linux, in bytes by macOS.
    return resource.getrusage(scope).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def _limit_files(membership: Path, root: Path = Path("/sys/fs/cgroup")) -> Iterator[Path]:
    """Files with the memory limits of this process's control group and of its parents."""
    try:
        lines = membership.read_text().splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, group = line.split(":", 2)
        if controllers and "memory" not in controllers.split(","):
            continue
        top = root / "memory" if controllers else root
        name = "memory.limit_in_bytes" if controllers else "memory.max"
        # In a container the group's own path may not exist; the root then holds the limit.
        for folder in (top / group.lstrip("/") / "x").parents:
            yield folder / name
            if folder == top:
                break


def _number_in(path: Path) -> int | None:
    try:
        return int(path.read_text())
    except (OSError, ValueError):
        return None


def linker_cache(name: bytes) -> list[str]:
    """Paths in the linker's cache whose file name starts with `name`.

    The cache is read directly: `ldconfig -p` gives the same list, but is not on an ordinary user's
    PATH.
    """
    try:
        data = Path("/etc/ld.so.cache").read_bytes()
    except OSError:
        return []
    paths = re.findall(rb"/[^\0]*/" + re.escape(name) + rb"[^\0/]*(?=\0)", data)
    return [os.fsdecode(path) for path in dict.fromkeys(paths)]


def user_cache_folder() -> Path | None:
    """Cache folder for inim; None if the user has no home folder."""
    named = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if named.is_absolute():
        return named / "inim"
    try:
        home = Path.home()
    except RuntimeError:
        return None
    return home / ".cache" / "inim" if home.is_absolute() else None
