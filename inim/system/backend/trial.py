"""Trying a backend in a child process, which may die without harm; verdicts are remembered."""

from __future__ import annotations

import contextlib
import os
import re
import sys
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from inim.system.process import machine
from inim.system.process.atomic_file import atomic_file
from inim.system.process.python_process import python_code, rendering_process

_PROBE_SECONDS = 60.0
_CURABLE = ("import", "start")


# Runs alone in a child. The kernel holds what LLVM 15 and 16 cannot compile; the scene
# starts Embree (or OptiX). The kernel cache is off: a cached kernel would hide a bad
# compiler. NaN is never equal to anything, so a wrong answer cannot pass by comparison.
PROBE = r"""
import ctypes, json, os, sys
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
    for library in sys.argv[2:]:
        ctypes.CDLL(library)
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
        driver = ctypes.CDLL(os.environ.get("DRJIT_LIBCUDA_PATH", "libcuda.so.1"))
        card = ctypes.create_string_buffer(256)
        if driver.cuDeviceGetName(card, len(card), 0):
            answer(stage="start", reason="the driver does not name its card")
        device = card.value.decode()
    else:
        version = ".".join(map(str, dr.detail.llvm_version()))
        device = "%d threads" % dr.thread_count()
except Exception as error:
    answer(stage="start", reason=str(error))
answer(stage="done", reason="", version=version, device=device)
"""


class Verdict(NamedTuple):
    """Result of trying one library; `lasting` results are stored."""

    usable: bool
    reason: str = ""
    version: str = ""
    device: str = ""
    stage: str = ""
    lasting: bool = True


def probe(
    variant: str,
    variables: dict[str, str],
    needed: Sequence[str] = (),
    seconds: float = _PROBE_SECONDS,
) -> Verdict:
    """Try a Mitsuba variant in a child process, which may die or hang without harm.

    The child gets additional environment variables, and first loads the `needed` libraries. After
    `seconds` it is killed, and the backend counts as unusable.
    """
    import subprocess

    with rendering_process(
        python_code(PROBE, variant, *needed),
        variables,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
    ) as process:
        try:
            output, errors = process.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            return Verdict(False, f"it hung for {seconds:g} s", lasting=False)
        return _read_answer(process.returncode, output, errors)


def _read_answer(code: int, output: str, errors: str) -> Verdict:
    answers = [line for line in output.splitlines() if line.startswith("INIM-PROBE ")]
    if not answers:
        import signal

        # An abort is the compiler's own verdict; other deaths may be a lack of memory.
        lasting = -code in (signal.SIGABRT, signal.SIGILL)
        cause = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        return Verdict(False, f"it killed its process with {cause}", lasting=lasting)
    import json

    answer = json.loads(answers[-1].removeprefix("INIM-PROBE "))
    # Dr.Jit's exception says "not found" for every failure; its log has the cause.
    log = [line for line in errors.splitlines() if line.startswith("jit") and "HOME" not in line]
    reason = " ".join((log[0] if log and answer["reason"] else answer["reason"]).split())
    stage = answer["stage"]
    version, device = (str(answer.get(name, "")) for name in ("version", "device"))
    # A failed load or start may be cured from outside: a missing dependency, a driver.
    return Verdict(stage == "done", reason, version, device, stage, stage not in _CURABLE)


REMEMBERED = 64
_METADATA = r"(?:drjit|mitsuba)-.*\.(?:dist|egg)-info"


def stored_trial(
    variant: str,
    library: Path,
    variables: dict[str, str],
    needed: Sequence[str] = (),
    extra: Sequence[str] = (),
) -> Verdict:
    """Stored result of a trial (`probe`) of a libLLVM or of CUDA's driver, or a new result.

    `extra` are further inputs on which the result depends.
    """
    search_path = os.environ.get("LD_LIBRARY_PATH", "")
    key = _fingerprint(variant, library, [search_path, *needed, *extra])
    stored = _parse_verdict(_read_cache().get(key))
    if stored:
        return stored
    verdict = probe(variant, variables, needed)
    if key and verdict.lasting:
        # Re-read: another process may have added its own meanwhile.
        _write_cache({**_read_cache(), key: verdict._asdict()})
    return verdict


def cache_file() -> Path | None:
    """File of stored results, or None if the user has no home."""
    folder = machine.user_cache_folder()
    return folder / "backends.json" if folder else None


def _fingerprint(variant: str, library: Path, extra: Sequence[str]) -> str:
    """All that the verdict depends on; empty when the file cannot be looked at."""
    try:
        stat = library.stat()
    except OSError:
        return ""
    parts = [variant, f"{library.resolve()}:{stat.st_size}:{stat.st_mtime_ns}", sys.version]
    parts += [*_renderer_fingerprint(), f"{zlib.crc32(machine.cpu_text().encode()):x}"]
    return "|".join([*parts, *extra])


def _renderer_fingerprint() -> list[str]:
    """Names and times of the metadata folders of Dr.Jit and Mitsuba, which identify an
    installation.

    importlib.metadata has the version, but takes longer to load than all other steps of this
    module.
    """
    folders = []
    for folder in filter(None, sys.path):
        with contextlib.suppress(OSError), os.scandir(folder) as entries:
            folders += [
                f"{entry.name}:{entry.stat().st_mtime_ns}"
                for entry in entries
                if re.fullmatch(_METADATA, entry.name)
            ]
    return sorted(folders)


def _parse_verdict(entry: object) -> Verdict | None:
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
    with contextlib.suppress(OSError), atomic_file(path) as temporary:
        temporary.write_text(json.dumps(newest, indent=1), "utf-8")
