"""A whole stress run: cases, relations and jitter, then data, table, page and figure."""

from __future__ import annotations

import shlex
import time
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from inim.errors import SceneError
from inim.provenance import backend_data, versions
from inim.report.stress import SCHEMA, write_stress
from inim.rgbd import RGBD
from inim.stress.request import StressRequest, check_request, scene_plan
from inim.version import __version__
from inim.worker.output import open_staging, publish
from inim.worker.supervisor import run_in_worker

__all__ = ["run_stress", "work"]

_MARKER = "stress.json"
_VERSIONS = ("drjit", "hypothesis", "matplotlib", "mitsuba", "numba", "numpy", "scikit-image")
# Rays of a lens-model case.
_RAYS = {True: 60, False: 100}
_THIN = {True: 8, False: 1}


def run_stress(request: StressRequest, *, quiet: bool = True, debug: bool = False) -> bool:
    """Measure in a worker process; `stress.json` and its kin are in `request.out` afterwards.

    Returns
    -------
    bool
        Whether every check holds.

    Raises
    ------
    InimError
        What the worker raised, or `WorkerError` / `OutOfMemoryError` where it could not say.
    """
    return run_in_worker(
        "inim.stress.job:work",
        request,
        lambda: open_staging(request.out),
        check=lambda: check_request(request),
        backend="llvm",
        quiet=quiet,
        debug=debug,
    )


def work(request: StressRequest, staging: Path, listener: Any) -> bool:
    """The worker's side: measure, write, publish; whether every check holds."""
    data = _measured(request, listener)
    listener.stage("write")
    write_stress(data, staging)
    publish(staging, request.out, _MARKER)
    _say(data, listener)
    return bool(data["passed"])


def _measured(request: StressRequest, listener: Any) -> dict[str, Any]:
    """The content of stress.json."""
    started = time.perf_counter()
    listener.stage("start")
    from inim.render import variant

    backend = variant.use("llvm")
    from inim.stress.case import FULL, QUICK
    from inim.stress.families import FAMILIES
    from inim.stress.free_relations import FREE_RELATIONS
    from inim.stress.generators import run_cases
    from inim.stress.jitter import measure_jitter
    from inim.stress.layer_relations import LAYER_RELATIONS
    from inim.stress.optics import run_optics
    from inim.stress.optics_cases import OPTICS_FAMILIES, display_of
    from inim.stress.optics_relations import run_optics_relations
    from inim.stress.regions import checks_of, regions_of, trust_limits
    from inim.stress.relations import run_relations

    size = QUICK if request.quick else FULL
    data = _record(request, backend)
    data["generators"] = run_cases(size, listener)
    data["lens_models"] = run_optics(_RAYS[request.quick], _THIN[request.quick], listener)
    listener.stage("relations")
    data["relations"] = [
        *run_relations(size),
        *run_relations(size, relations=[*LAYER_RELATIONS, *FREE_RELATIONS]),
        *run_optics_relations(),
    ]
    listener.stage("jitter")
    picture, display, name = _picture(request, listener)
    data["jitter"] = measure_jitter(picture, display)
    data["picture"] = {"name": name, "rows": picture.shape[0], "columns": picture.shape[1]}
    generators, optics = data["generators"], data["lens_models"]
    of_generators = {f.name: f.parameter for f in FAMILIES}
    of_optics = {f.name: f.parameter for f in OPTICS_FAMILIES}
    data["regions"] = regions_of(generators, [], of_generators) + regions_of([], optics, of_optics)
    data["trust"] = trust_limits(generators, optics, round(display_of().pixels_per_lens))
    data["checks"] = checks_of(data)
    data["passed"] = all(c["passed"] for c in data["checks"])
    data["seconds"] = time.perf_counter() - started
    return data


def _record(request: StressRequest, backend: Any) -> dict[str, Any]:
    """What made it and how to make it again."""
    return {
        "schema": SCHEMA,
        "title": "Stress" if request.scene is None else f"Stress: {request.scene.stem}",
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "inim_version": __version__,
        "versions": versions(_VERSIONS),
        "command": shlex.join(["python", "-m", "inim.stress", *request.command()]),
        "mode": "quick" if request.quick else "full",
        "backend": backend_data(backend),
        # How much wider the oracle of the lens models is than what it judges.
        "oracle_mantissa_bits": int(np.finfo(np.longdouble).nmant) + 1,
    }


def _picture(request: StressRequest, listener: Any) -> tuple[RGBD, Any, str]:
    """The picture whose depth is jittered: of the scene, or two spheres in closed form."""
    from inim.color import linear_from_srgb
    from inim.display import DISPLAYS
    from inim.scene.two_spheres import two_spheres

    if request.scene is not None:
        return _captured(request, listener)
    display = DISPLAYS["nominal"]
    if request.quick:
        display = display.replace(lens_columns=16, lens_rows=16)
    ready = two_spheres(display, display.capture_shape(5), display.pitch_mm / 5)
    linear = linear_from_srgb(ready.color[..., :3] / np.float32(255))
    return replace(ready, color=linear), display, "two spheres"


def _captured(request: StressRequest, listener: Any) -> tuple[RGBD, Any, str]:
    """As a validation captures it."""
    from inim.render import ground_truth
    from inim.render.scene import open_scene

    plan = scene_plan(request)
    settings = plan.settings
    fitted = open_scene(plan.file, plan.display, settings.fit_share)
    rgbd = ground_truth.capture(
        fitted,
        plan.display,
        pixels_per_pitch=settings.capture_pixels_per_pitch,
        spp=settings.capture_spp,
        seed=2 * settings.seed,
        observer=listener,
    )
    if not rgbd.covered.any():
        raise SceneError(f"{request.scene}: the depth camera sees nothing to jitter")
    color = np.nan_to_num(rgbd.color.astype(np.float32), posinf=0.0)
    return replace(rgbd, color=color), plan.display, str(request.scene)


def _say(data: dict[str, Any], listener: Any) -> None:
    """Each check in a line, then the jitters of the exact path."""
    for check in data["checks"]:
        word = "ok    " if check["passed"] else "FAILED"
        listener.line(f"{word}  {check['name']}: {check['cases']} cases, {check['broken']} broken")
    for row in data["jitter"]:
        if row["algorithm"] == "template":
            listener.line(
                f"depth {row['jitter']}: {row['changed']:.3%} of the pixels change, "
                f"EIA SSIM falls by {row['ssim_loss']:.2e}"
            )
