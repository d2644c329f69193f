"""Trying a backend in a child process, which may die or hang without harm."""

from __future__ import annotations

import os
import sys
from typing import NamedTuple

__all__ = ["Verdict", "probe"]

_PROBE_SECONDS = 60.0
_CURABLE = ("import", "start")


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


class Verdict(NamedTuple):
    """What trying one library said; `lasting` ones are worth remembering."""

    usable: bool
    reason: str = ""
    version: str = ""
    device: str = ""
    stage: str = ""
    lasting: bool = True


def probe(variant: str, variables: dict[str, str], seconds: float = _PROBE_SECONDS) -> Verdict:
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
