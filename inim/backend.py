"""Which renderer backend works on this machine: CUDA, or LLVM with a usable libLLVM.

Nothing here imports Mitsuba or Dr.Jit. A bad libLLVM does not raise, it aborts the
process (LLVM 15 and 16 on x86), so each candidate is tried in a child process first and
the verdict is remembered. Call `activate` before Mitsuba is first imported.
"""

from __future__ import annotations

import contextlib
import os
import re
import sys
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple, cast

from inim.errors import BackendError, UsageError

BACKENDS = ("auto", "cuda", "llvm")
SEARCH_VARIABLE = "INIM_LLVM_SEARCH"
LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
PRIVATE_MARKER = "inim-llvm.json"
PROBE_SECONDS = 60.0
REMEMBERED = 64
_CURABLE = ("import", "start")
WAY_OUT = (
    "type: inim install-llvm  (or, as root on Debian and Ubuntu: "
    "apt-get install libllvm19 libatomic1; on macOS: brew install llvm)"
)
DISTRIBUTIONS = ("inim", "mitsuba", "drjit", "numpy", "OpenEXR", "trimesh", "flip-evaluator")

_LIBRARY = r"libLLVM(?:-(\d[\d.]*?))?(?:\.so(?:\.(\d+(?:\.\d+)*)[^/]*)?|\.dylib)"
_FOLDER_VERSION = r"llvm(?:@[\d.]+)?/(\d+(?:\.\d+)+)|llvm[-@](\d+(?:\.\d+)*)"

# Runs alone in a child. The kernel holds what LLVM 15 and 16 cannot compile; the scene
# starts Embree (or OptiX). The kernel cache is off: a cached kernel would hide a bad
# compiler. NaN is never equal to anything, so a wrong answer cannot pass by comparison.
PROBE = r"""
import json, os, sys
for name in ("HOME", "DRJIT_CACHE_DIR"):
    os.environ.pop(name, None)
try:
    import resource
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
except (ImportError, ValueError, OSError):
    pass

def answer(**verdict):
    print("INIM-PROBE " + json.dumps(verdict), flush=True)
    raise SystemExit(0)

try:
    import mitsuba as mi
    import drjit as dr
except Exception as error:
    answer(stage="import", reason=str(error))
variant = sys.argv[1]
try:
    mi.set_variant(variant)
    x = dr.arange(mi.Float, 16) - 8
    y = dr.minimum(x, 0.5) + dr.fma(x, x, 1.25) + dr.maximum(x, -2)
    wanted = [min(i, 0.5) + i * i + 1.25 + max(i, -2) for i in range(-8, 8)]
    if list(y) != wanted or list(dr.min(x)) != [-8] or list(dr.max(x)) != [7]:
        answer(stage="kernel", reason="it computes wrong numbers")
    scene = mi.load_dict({"type": "scene", "cube": {"type": "cube"}})
    origin = mi.Point3f(mi.Float([0.5, 2.5]), mi.Float([0.25, 0.25]), 3)
    hit = scene.ray_intersect(mi.Ray3f(origin, mi.Vector3f(0, 0, -1)))
    valid = list(hit.is_valid())
    if valid != [True, False] or not abs(hit.t[0] - 2) < 1e-5:
        answer(stage="scene", reason="it intersects rays wrongly")
    if variant.startswith("cuda"):
        version = ".".join(map(str, dr.detail.cuda_version()))
        device = "compute capability %s" % (dr.detail.cuda_compute_capability(),)
    else:
        version = ".".join(map(str, dr.detail.llvm_version()))
        device = "%d threads" % dr.thread_count()
except Exception as error:
    answer(stage="start", reason=str(error))
answer(stage="done", reason="", version=version, device=device)
"""


@dataclass(frozen=True)
class Backend:
    """A backend that was seen to work: what to load and how to call it in words."""

    name: str
    variant: str
    libllvm: Path | None
    libllvm_version: str | None
    device: str


class Verdict(NamedTuple):
    """What trying one library said; `lasting` ones are worth remembering."""

    usable: bool
    reason: str = ""
    version: str = ""
    device: str = ""
    stage: str = ""
    lasting: bool = True


def choose_backend(wanted: str = "auto", search: Sequence[Path] | None = None) -> Backend:
    """The backend to use: CUDA where it works, else the newest libLLVM that works.

    Parameters
    ----------
    wanted : {"auto", "cuda", "llvm"}
        ``auto`` prefers CUDA.
    search : sequence of Path, optional
        The folders to look for libLLVM in, instead of the usual ones. The environment
        variable INIM_LLVM_SEARCH (folders joined by ``:``) does the same.

    Raises
    ------
    BackendError
        Nothing works; the message says what was found, why it was refused, what to type.
    UsageError
        `wanted` is none of the three.
    """
    if wanted not in BACKENDS:
        raise UsageError(f"backend {wanted!r} is unknown: choose one of {', '.join(BACKENDS)}")
    if wanted != "llvm":
        verdict = cuda_verdict()
        if verdict.usable:
            return Backend("cuda", "cuda_ad_rgb", None, None, verdict.device)
        if wanted == "cuda":
            raise BackendError(f"no usable CUDA: {verdict.reason}; use --backend llvm or auto")
    return _choose_llvm(search)


def _choose_llvm(search: Sequence[Path] | None) -> Backend:
    refused = []
    for library, verdict in llvm_verdicts(search):
        if verdict.usable:
            words = f"{cpu_model()}, LLVM {verdict.version}, {verdict.device}"
            return Backend("llvm", "llvm_ad_rgb", library, verdict.version, words)
        if verdict.stage == "import":
            raise BackendError(f"Mitsuba cannot be imported: {verdict.reason}; {WAY_OUT}")
        refused.append(f"{library} ({verdict.reason})")
    named = os.environ.get(LLVM_VARIABLE)
    if named:
        why = ", ".join(refused) or named
        raise BackendError(f"no usable libLLVM: {LLVM_VARIABLE} names {why}; change it or unset it")
    raise BackendError(f"no usable libLLVM: found {', '.join(refused) or 'none'}; {WAY_OUT}")


# --- Candidates ---------------------------------------------------------------------------


def llvm_version(library: Path) -> tuple[int, ...] | None:
    """The version told by a libLLVM's name or, failing that, its folder; else None."""
    match = re.fullmatch(_LIBRARY, library.name)
    # "libLLVM.so.1" is an alias without the version: no usable LLVM is older than 3.
    for text in match.groups() if match else ():
        if text and int(text.split(".")[0]) >= 3:
            return tuple(int(part) for part in text.split("."))
    folder = re.search(_FOLDER_VERSION, library.parent.as_posix())
    text = (folder.group(1) or folder.group(2)) if folder else None
    return tuple(int(part) for part in text.split(".")) if text else None


def find_libllvm(search: Sequence[Path] | None = None) -> list[Path]:
    """Every libLLVM on this machine, by real path, newest version first.

    With DRJIT_LIBLLVM_PATH set, that one alone.
    """
    named = os.environ.get(LLVM_VARIABLE)
    if named:
        return [Path(named).resolve() if os.sep in named else Path(named)]
    if search is None and os.environ.get(SEARCH_VARIABLE):
        search = [Path(part) for part in os.environ[SEARCH_VARIABLE].split(os.pathsep) if part]
    folders = _usual_folders() if search is None else search
    found = [path for folder in folders for path in _libraries_in(folder)]
    if search is None:
        found += [Path(name) for name in _linker_cache(b"libLLVM")]
    real = dict.fromkeys(path.resolve() for path in found if re.fullmatch(_LIBRARY, path.name))
    files = [path for path in real if path.is_file()]
    return sorted(files, key=lambda path: llvm_version(path) or (0,), reverse=True)


def private_folders() -> list[Path]:
    """Where `inim install-llvm` may have put a copy: the virtual environment, the home."""
    folders = [Path(sys.prefix) / "lib" / "inim-llvm"]
    data = _user_folder("XDG_DATA_HOME", ".local/share")
    return [*folders, data / "llvm"] if data else folders


def _usual_folders() -> Iterator[Path]:
    yield from private_folders()
    for prefix in (os.environ.get("CONDA_PREFIX"), sys.prefix):
        if prefix:
            yield Path(prefix) / "lib"
    multiarch = getattr(sys.implementation, "_multiarch", "") or f"{os.uname().machine}-linux-gnu"
    yield Path("/usr/lib") / multiarch
    yield from Path("/usr/lib").glob("llvm-*/lib")
    yield from (Path("/usr/lib64"), Path("/usr/local/lib"))
    yield from Path("/opt/homebrew/opt").glob("llvm*/lib")
    yield from Path("/usr/local/opt").glob("llvm*/lib")


def _libraries_in(folder: Path) -> list[Path]:
    try:
        # A system's folder holds thousands of files: make no Path of each.
        with os.scandir(folder) as entries:
            return sorted(Path(entry) for entry in entries if entry.name.startswith("libLLVM"))
    except OSError:
        return []


def _linker_cache(name: bytes) -> list[str]:
    """Paths in the linker's cache whose file name starts with `name`.

    Read directly: `ldconfig -p` says the same, but is not on an ordinary user's PATH.
    """
    try:
        data = Path("/etc/ld.so.cache").read_bytes()
    except OSError:
        return []
    found = re.findall(rb"/[^\0]*/" + re.escape(name) + rb"[^\0/]*(?=\0)", data)
    return [os.fsdecode(path) for path in dict.fromkeys(found)]


# --- Verdicts -----------------------------------------------------------------------------


def llvm_verdicts(search: Sequence[Path] | None = None) -> Iterator[tuple[Path, Verdict]]:
    """Each candidate with its verdict, newest first, tried only when asked for."""
    for library in find_libllvm(search):
        known = known_bad(llvm_version(library))
        if known:
            yield library, Verdict(False, known)
        else:
            yield library, _remembered("llvm_ad_rgb", library, _variables(library))


def known_bad(version: tuple[int, ...] | None) -> str:
    """Why a version is refused without being run, or an empty string."""
    if version and version[0] <= 14:
        return f"LLVM {version[0]} is too old for Dr.Jit"
    # Their x86 code generator cannot select float minimum and maximum, and aborts.
    if version and version[0] <= 16 and os.uname().machine in ("x86_64", "AMD64", "i686"):
        return f"LLVM {version[0]} aborts the process on x86 CPUs"
    return ""


def cuda_verdict() -> Verdict:
    """Whether CUDA works here. Costs nothing where the driver library is missing."""
    named = os.environ.get("DRJIT_LIBCUDA_PATH")
    folders = os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)
    places = [named] if named else [f"{folder}/libcuda.so.1" for folder in folders if folder]
    places += [] if named else _linker_cache(b"libcuda.so.1")
    drivers = [Path(place) for place in places if Path(place).is_file()]
    if not drivers:
        return Verdict(False, "the driver library libcuda.so.1 was not found")
    # A driver without its device (a container) must not be remembered for one with it.
    devices = sorted(path.name for path in Path("/dev").glob("nvidia*"))
    visible = [os.environ.get("CUDA_VISIBLE_DEVICES", ""), *devices]
    return _remembered("cuda_ad_rgb", drivers[0], _variables(None), visible)


def _remembered(
    variant: str, library: Path, variables: dict[str, str], extra: Sequence[str] = ()
) -> Verdict:
    # Where dependencies are looked for is part of what was tried.
    key = _fingerprint(variant, library, [variables.get("LD_LIBRARY_PATH", ""), *extra])
    known = _from_cache(_read_cache().get(key))
    if known:
        return known
    verdict = probe(variant, variables)
    if key and verdict.lasting:
        # Re-read: another process may have added its own meanwhile.
        _write_cache({**_read_cache(), key: verdict._asdict()})
    return verdict


def probe(variant: str, variables: dict[str, str], seconds: float = PROBE_SECONDS) -> Verdict:
    """Try a backend in a child process, which may die or hang without harm.

    Parameters
    ----------
    variant : str
        The Mitsuba variant to start.
    variables : dict
        Environment variables to add for the child.
    seconds : float
        After this long the child is killed and the backend counts as unusable.
    """
    import subprocess

    try:
        child = subprocess.run(
            [sys.executable, "-c", PROBE, variant],
            env={**os.environ, **variables, "PYTHONSAFEPATH": "1"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=seconds,
            text=True,
            errors="replace",
        )
    except subprocess.TimeoutExpired:
        return Verdict(False, f"it hung for {seconds:g} s", lasting=False)
    return _read_answer(child.returncode, child.stdout, child.stderr)


def _read_answer(code: int, output: str, errors: str) -> Verdict:
    said = [line for line in output.splitlines() if line.startswith("INIM-PROBE ")]
    if not said:
        import signal

        # An abort is the compiler's own verdict; other deaths may be a lack of memory.
        lasting = -code in (signal.SIGABRT, signal.SIGILL)
        how = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        return Verdict(False, f"it killed its process with {how}", lasting=lasting)
    import json

    answer = json.loads(said[-1].removeprefix("INIM-PROBE "))
    # Dr.Jit's exception says "not found" for every failure; its log has the cause.
    log = [line for line in errors.splitlines() if line.startswith("jit") and "HOME" not in line]
    reason = " ".join((log[0] if log and answer["reason"] else answer["reason"]).split())
    stage = answer["stage"]
    version, device = (str(answer.get(name, "")) for name in ("version", "device"))
    # A failed load or start may be cured from outside: a missing dependency, a driver.
    return Verdict(stage == "done", reason, version, device, stage, stage not in _CURABLE)


# --- Memory of verdicts -------------------------------------------------------------------


def cache_file() -> Path | None:
    """Where verdicts are remembered, or None where the user has no home."""
    folder = _user_folder("XDG_CACHE_HOME", ".cache")
    return folder / "backends.json" if folder else None


def _user_folder(variable: str, below_home: str) -> Path | None:
    named = Path(os.environ.get(variable, ""))
    if named.is_absolute():
        return named / "inim"
    try:
        home = Path.home()
    except RuntimeError:
        return None
    return home / below_home / "inim" if home.is_absolute() else None


def _fingerprint(variant: str, library: Path, extra: Sequence[str]) -> str:
    """All that the verdict depends on; empty when the file cannot be looked at."""
    try:
        stat = library.stat()
    except OSError:
        return ""
    parts = [variant, f"{library.resolve()}:{stat.st_size}:{stat.st_mtime_ns}", sys.version]
    parts += [distribution_version(name) or "" for name in ("drjit", "mitsuba")]
    return "|".join([*parts, f"{zlib.crc32(_cpu_text().encode()):x}", *extra])


def _from_cache(entry: object) -> Verdict | None:
    """The remembered verdict, or None for an entry that another hand has written."""
    if not isinstance(entry, dict) or not isinstance(entry.get("usable"), bool):
        return None
    try:
        return Verdict(**entry)
    except TypeError:
        return None


def _read_cache() -> dict[str, Any]:
    import json

    path = cache_file()
    try:
        content = json.loads(path.read_text("utf-8")) if path else {}
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _write_cache(entries: dict[str, Any]) -> None:
    import json

    path = cache_file()
    if path is None:
        return
    newest = dict(list(entries.items())[-REMEMBERED:])
    partial = path.with_name(f"{path.name}.{os.getpid()}")
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(json.dumps(newest, indent=1), "utf-8")
        partial.replace(path)


# --- Use ----------------------------------------------------------------------------------


def environment(backend: Backend) -> dict[str, str]:
    """The variables to set for a child process that will use `backend`."""
    return _variables(backend.libllvm)


def activate(backend: Backend) -> None:
    """Make this process use `backend`. To be called before Mitsuba is first imported.

    Raises
    ------
    BackendError
        Dr.Jit is loaded already and was set up for another libLLVM.
    """
    variables = environment(backend)
    wanted = variables.get(LLVM_VARIABLE)
    if "drjit" in sys.modules and wanted and os.environ.get(LLVM_VARIABLE) != wanted:
        raise BackendError(
            f"{wanted} cannot be used: Dr.Jit is loaded already, with "
            f"{os.environ.get(LLVM_VARIABLE) or 'a libLLVM of its own choice'}; "
            f"call inim.backend.activate before importing mitsuba"
        )
    _preload(_companions(backend.libllvm))
    os.environ.update(variables)


def _variables(library: Path | None) -> dict[str, str]:
    variables = {LLVM_VARIABLE: str(library)} if library else {}
    folders = [str(folder) for folder in _companions(library)]
    if folders:
        before = os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)
        every = dict.fromkeys([*folders, *before])
        variables["LD_LIBRARY_PATH"] = os.pathsep.join(folder for folder in every if folder)
    return variables


def _companions(library: Path | None) -> list[Path]:
    """Private folders whose libraries the system lacks: LLVM's dependencies, libatomic."""
    folders = [*([library.parent] if library else []), *private_folders()]
    return [folder for folder in dict.fromkeys(folders) if (folder / PRIVATE_MARKER).is_file()]


def _preload(folders: Iterable[Path]) -> None:
    """Load the private libraries into this process, in whatever order they allow.

    LD_LIBRARY_PATH is read when a process starts, so it serves children only. What is
    loaded already satisfies, by its name, the later demands of libLLVM and Dr.Jit.
    """
    import ctypes

    waiting = [path for folder in folders for path in sorted(folder.glob("*.so*"))]
    waiting = [path for path in waiting if not re.fullmatch(_LIBRARY, path.name)]
    progress = True
    while waiting and progress:
        left = []
        for path in waiting:
            try:
                ctypes.CDLL(str(path))
            except OSError:
                left.append(path)
        progress, waiting = len(left) < len(waiting), left


# --- Facts about the machine --------------------------------------------------------------


def distribution_version(name: str) -> str | None:
    """The installed version of a Python distribution, or None."""
    from importlib import metadata

    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _cpu_text() -> str:
    """The first processor's lines of /proc/cpuinfo that stay the same between boots."""
    try:
        # One read: a machine with hundreds of cores fills megabytes, line by line.
        with Path("/proc/cpuinfo").open("rb", buffering=0) as file:
            first = file.read(8192).decode(errors="replace").split("\n\n")[0]
    except OSError:
        return " ".join(os.uname())
    keep = ("model name", "flags", "Features", "CPU part")
    return "\n".join(line for line in first.splitlines() if line.startswith(keep))


def cpu_model() -> str:
    """The processor's name, or its architecture where the system does not say."""
    for line in _cpu_text().splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return os.uname().machine


def cpu_count() -> int:
    """How many processors this process may use (its affinity, not the machine's)."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def memory_limit_bytes() -> int:
    """The memory this process may use [bytes]: the machine's, or a container's limit."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    limits = [_number_in(path) for path in _limit_files(Path("/proc/self/cgroup"))]
    return min([total, *(limit for limit in limits if limit)])


def _limit_files(membership: Path, root: Path = Path("/sys/fs/cgroup")) -> Iterator[Path]:
    """The limits of this process's control group and of each group above it."""
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


def describe() -> dict[str, Any]:
    """All that a report about this machine needs, ready for JSON."""
    import platform

    cuda = cuda_verdict()
    chosen: dict[str, Any] | str
    try:
        chosen = {name: value and str(value) for name, value in asdict(choose_backend()).items()}
    except BackendError as error:
        chosen = str(error)
    return {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpu": cpu_model(),
        "cores": cpu_count(),
        "memory_bytes": memory_limit_bytes(),
        "versions": {name: distribution_version(name) for name in DISTRIBUTIONS},
        "libllvm": [_candidate(path, verdict) for path, verdict in llvm_verdicts()],
        "cuda": {"usable": cuda.usable, "reason": cuda.reason, "device": cuda.device},
        "chosen": chosen,
        "cache": str(cache_file() or ""),
    }


def _candidate(library: Path, verdict: Verdict) -> dict[str, Any]:
    named = ".".join(map(str, llvm_version(library) or ()))
    version = verdict.version or named or None
    reason = verdict.reason
    return {"path": str(library), "version": version, "usable": verdict.usable, "reason": reason}


def sys_info() -> str:
    """The facts of `describe` as text, one per line."""
    facts = describe()
    chosen = facts["chosen"]
    rows = [(name, facts[name]) for name in ("python", "platform", "cpu", "cores")]
    rows.append(("memory", f"{facts['memory_bytes'] / 2**30:.1f} GiB"))
    rows += [(name, version or "not installed") for name, version in facts["versions"].items()]
    for found in facts["libllvm"]:
        words = "usable" if found["usable"] else f"refused: {found['reason']}"
        rows.append(("libLLVM", f"{found['version'] or '?'}  {found['path']}  {words}"))
    rows.append(("CUDA", facts["cuda"]["device"] or f"not used: {facts['cuda']['reason']}"))
    if isinstance(chosen, dict):
        chosen = " ".join(cast(str, chosen[name]) for name in ("variant", "device"))
    rows += [("backend", chosen), ("cache", facts["cache"] or "none (no home folder)")]
    return "\n".join(f"{name:<15} {value}" for name, value in rows)
