"""Validation: from a scene to a scored report of every algorithm, viewpoint by viewpoint."""

from __future__ import annotations

import platform
import shlex
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from inim import metrics
from inim.formats.image import write_exr, write_png, write_rgbd
from inim.generators import colour_of, find_sources, hole_fraction
from inim.jobs.plan import Plan, Request
from inim.report import SCHEMA, Report
from inim.rgbd import RGBD
from inim.version import __version__

__all__ = ["Listener", "default_out", "run", "validate"]

_VERSIONS = ("drjit", "flip-evaluator", "mitsuba", "numba", "numpy", "OpenEXR", "scikit-image")
# A truth view or EIA whose brightest value is below this shows nothing.
_BLACK = 1e-4
# Above this share of clipped pixels, scores say more about exposure than about the algorithm.
_CLIPPED_SHARE = 0.01


class Listener:
    """Hears how a run goes on; the command line's version prints and draws a bar."""

    def begin(self, total_rays: int) -> None:
        """The number of rays the whole run will trace."""

    def stage(self, name: str) -> None:
        """A stage begins."""

    def rays(self, count: int) -> None:
        """So many rays more are done."""

    def line(self, text: str) -> None:
        """A result worth a line."""


@dataclass
class _Run:
    """What accumulates while a plan is carried out; the report is made from it."""

    plan: Plan
    folder: Path
    listener: Listener
    clock: Any
    timings: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    checks: list[dict[str, Any]] = field(default_factory=list)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage under its name; the same name adds up."""
        self.listener.stage(name)
        started = time.perf_counter()
        yield
        self.timings[name] = self.timings.get(name, 0.0) + time.perf_counter() - started

    def check(
        self, name: str, value: float | None, relation: str, limit: float, detail: str = ""
    ) -> None:
        """Add a row to the verdict. A value that is missing or not finite never passes."""
        known = value is not None and bool(np.isfinite(value))
        passed = bool(known and (value >= limit if relation == ">=" else value <= limit))  # type: ignore[operator]
        self.checks.append(
            {
                "name": name,
                "value": value,
                "relation": relation,
                "limit": limit,
                "passed": passed,
                "detail": detail,
            }
        )

    def finite(self, name: str, *images: np.ndarray) -> list[np.ndarray]:
        """Pictures whose pixels are finite: others are counted, fail a check and turn black."""
        wrong = [~np.isfinite(image).all(axis=-1) for image in images]
        bad = sum(int(np.count_nonzero(w)) for w in wrong)
        if bad:
            self.check(f"{name}: pixels not finite", bad, "<=", 0, "taken as black")
        return [
            np.where(w[..., None], np.float32(0), image) if w.any() else image
            for w, image in zip(wrong, images, strict=True)
        ]

    def save(self, name: str, linear: np.ndarray) -> None:
        """Write a picture as PNG and EXR."""
        write_png(self.folder / f"{name}.png", linear)
        write_exr(self.folder / f"{name}.exr", linear, self._attributes())

    def _attributes(self) -> dict[str, str]:
        return {
            "inim:scene_sha256": self.plan.file.sha256,
            "inim:seed": str(self.plan.settings.seed),
        }


def validate(
    scene: str | Path,
    out: str | Path | None = None,
    *,
    definitions: Mapping[str, Any] | None = None,
    display: str | None = None,
    algorithms: str | None = None,
    viewpoints: str | None = None,
    lens_model: str | None = None,
    backend: str = "auto",
) -> Report:
    """Validate a scene in a worker process, as `python -m inim.validate` does.

    Parameters
    ----------
    scene : path
        Mitsuba XML with `inim.*` settings.
    out : path, optional
        Folder for the report; `<scene>-report` in the current folder otherwise.
    definitions : mapping, optional
        Settings and scene parameters to override, like ``{"inim.pitch_mm": 0.5}``.
    display, algorithms, viewpoints, lens_model : str, optional
        Shorthands for the settings of those names.
    backend : {"auto", "llvm", "cuda"}

    Returns
    -------
    Report
        With `passed` False where a check failed; that is a result, not an error.

    Raises
    ------
    InimError
        Of the kind that fits, with the line the command would print.
    """
    from inim.jobs.worker import run_in_worker

    scene = Path(scene)
    request = Request(
        scene=scene,
        out=default_out(scene) if out is None else Path(out),
        definitions=tuple(f"{k}={v}" for k, v in (definitions or {}).items()),
        display=display,
        algorithms=algorithms,
        viewpoints=viewpoints,
        lens_model=lens_model,
        backend=backend,
    )
    run_in_worker(request)
    return Report.load(request.out)


def default_out(scene: Path) -> Path:
    """Where a report goes when nobody says: beside where the command is typed."""
    return Path(f"{scene.stem}-report")


def run(plan: Plan, staging: Path, listener: Listener | None = None) -> Report:
    """Carry out a plan in this process and write its report into `staging`.

    Parameters
    ----------
    plan : Plan
    staging : Path
        An empty folder; see `inim.jobs.output`.
    listener : Listener, optional

    Returns
    -------
    Report
    """
    started = time.perf_counter()
    listener = listener or Listener()
    listener.stage("start")
    from inim.kernel import variant

    backend = variant.use(plan.request.backend)
    from inim.kernel.trace import Clock

    job = _Run(plan, staging, listener, Clock())
    job.timings["start"] = time.perf_counter() - started
    listener.begin(_planned_rays(plan))
    truth = _ground_truth(job)
    algorithms = _algorithms(job, truth)
    data = _report_data(job, truth, algorithms, backend)
    data["timings"] |= {
        "mitsuba_render": job.clock.seconds,
        "total": time.perf_counter() - started,
    }
    _print_scores(listener, data)
    report = Report(staging, data)
    report.write()
    return report


def _planned_rays(plan: Plan) -> int:
    s, d = plan.settings, plan.display
    capture = np.prod(d.capture_shape(s.capture_pixels_per_pitch)) * s.capture_spp
    eia = np.prod(d.eia_shape) * 2 * max(1, s.eia_spp // 2)
    view = d.lens_rows * d.lens_columns * s.view_pixels_per_lens**2
    looks = len(plan.algorithms) + 1
    per_view = 2 * max(1, s.view_spp // 2) + looks * s.reconstruction_spp
    return int(capture + eia + view * per_view * len(plan.viewpoints))


@dataclass(frozen=True)
class _GroundTruth:
    """Everything the algorithms are compared with."""

    fitted: Any
    rgbd: RGBD
    eia: Any
    views: dict[str, Any]
    relic: dict[str, np.ndarray]
    ceiling: dict[str, np.ndarray]


def _ground_truth(job: _Run) -> _GroundTruth:
    from inim.kernel import ground_truth
    from inim.kernel.scene import open_scene

    plan, s = job.plan, job.plan.settings
    # Each picture's seed is its own, so that adding a viewpoint changes no other picture.
    seeds = {name: 1000 * (s.seed + 1) + i for i, name in enumerate(("capture", "eia", "views"))}
    common = {"clock": job.clock, "progress": job.listener.rays}
    with job.stage("open scene"):
        fitted = open_scene(plan.file, plan.display, s.fit_share, job.clock)
    with job.stage("capture RGB-D"):
        rgbd = ground_truth.capture(
            fitted,
            plan.display,
            pixels_per_pitch=s.capture_pixels_per_pitch,
            spp=s.capture_spp,
            seed=seeds["capture"],
            **common,
        )
        rgbd = replace(rgbd, color=job.finite("RGB-D", rgbd.color)[0])
    with job.stage("ground-truth EIA"):
        eia = ground_truth.pickup(fitted, plan.display, spp=s.eia_spp, seed=seeds["eia"], **common)
        eia = ground_truth.Truth(*job.finite("truth/eia", eia.first, eia.second))
    views: dict[str, Any] = {}
    relic: dict[str, np.ndarray] = {}
    for viewpoint in plan.viewpoints:
        with job.stage("ground-truth views"):
            view, relic[viewpoint.name] = ground_truth.true_view(
                fitted,
                plan.display,
                viewpoint,
                pixels_per_lens=s.view_pixels_per_lens,
                spp=s.view_spp,
                seed=seeds["views"],
                **common,
            )
            halves = job.finite(f"truth/{viewpoint.name}", view.first, view.second)
            views[viewpoint.name] = ground_truth.Truth(*halves)
    ceiling = _reconstruct(job, eia.image, "ceiling")
    with job.stage("write pictures"):
        _save_truth(job, rgbd, eia, views)
    _check_truth(job, rgbd, eia, views)
    return _GroundTruth(fitted, rgbd, eia, views, relic, ceiling)


def _reconstruct(job: _Run, eia: np.ndarray, name: str) -> dict[str, np.ndarray]:
    """Look at an EIA from every viewpoint, exposed so that the panel's white looks white."""
    from inim.kernel.reconstruct import DisplayScene
    from inim.lens.thick import on_axis_transmittance

    plan, s = job.plan, job.plan.settings
    exposure = 1.0 if s.lens_model != "thick" else 1 / on_axis_transmittance(plan.display)
    seen: dict[str, np.ndarray] = {}
    with job.stage("reconstruct views"):
        shown = DisplayScene(eia, plan.display, s.lens_model)
        for viewpoint in plan.viewpoints:
            view = shown.view(
                viewpoint,
                pixels_per_lens=s.view_pixels_per_lens,
                spp=s.reconstruction_spp,
                seed=s.seed,
                clock=job.clock,
                progress=job.listener.rays,
            )
            seen[viewpoint.name] = view * np.float32(exposure)
    with job.stage("write pictures"):
        for view_name, view in seen.items():
            job.save(f"views/{name}/{view_name}", view)
    return seen


def _save_truth(job: _Run, rgbd: RGBD, eia: Any, views: dict[str, Any]) -> None:
    low, high = job.plan.display.depth_range_mm
    grey = np.where(rgbd.covered, 0.1 + 0.9 * (rgbd.depth_mm - low) / (high - low), 0.0)
    write_rgbd(job.folder / "rgbd.exr", rgbd, job._attributes())
    write_png(job.folder / "rgbd_color.png", rgbd.color)
    write_png(job.folder / "rgbd_depth.png", np.repeat(grey[..., None], 3, axis=-1))
    job.save("truth/eia", eia.image)
    for name, truth in views.items():
        job.save(f"truth/{name}", truth.image)


def _check_truth(job: _Run, rgbd: RGBD, eia: Any, views: dict[str, Any]) -> None:
    """A ground truth that shows nothing is a failure to report, not a picture to score."""
    job.check("RGB-D: covered share", float(rgbd.covered.mean()), ">=", 1e-6, "the relic is seen")
    pictures = {"truth/eia": eia.image, **{f"truth/{n}": t.image for n, t in views.items()}}
    for name, image in pictures.items():
        job.check(f"{name}: brightest value", float(image.max()), ">=", _BLACK, "not black")
    clipped = {name: float((image > 1).any(axis=-1).mean()) for name, image in pictures.items()}
    worst = max(clipped, key=lambda name: clipped[name])
    if clipped[worst] > _CLIPPED_SHARE:
        job.warnings.append(
            f"{worst}: {clipped[worst]:.1%} of the pixels are brighter than the panel's white and "
            "clipped; dim the scene's lights"
        )


def _algorithms(job: _Run, truth: _GroundTruth) -> dict[str, Any]:
    results: dict[str, Any] = {}
    for name in job.plan.algorithms:
        with job.stage(f"generate {name}"):
            started = time.perf_counter()
            sources = find_sources(truth.rgbd, job.plan.display, name)
            eia = colour_of(sources, truth.rgbd)
            seconds = time.perf_counter() - started
        holes = hole_fraction(sources)
        with job.stage("write pictures"):
            job.save(f"eia/{name}", eia)
        seen = _reconstruct(job, eia, name)
        with job.stage("score"):
            results[name] = _score(truth, eia, seen) | {"seconds": seconds}
        results[name]["eia"]["hole_fraction"] = holes
        job.check(f"{name}: share of pixels shown", 1 - holes, ">=", 1e-6, "not all holes")
        if name in job.plan.ssim_limits:
            for view, scores in results[name]["views"].items():
                job.check(
                    f"{name}/{view}: SSIM to ceiling",
                    scores["ssim_to_ceiling"],
                    ">=",
                    job.plan.ssim_limits[name],
                )
    return results


def _score(truth: _GroundTruth, eia: np.ndarray, seen: dict[str, np.ndarray]) -> dict[str, Any]:
    views = {}
    for name, view in seen.items():
        reference = truth.views[name].image
        to_ceiling = metrics.score(truth.ceiling[name], view)
        views[name] = metrics.score(reference, view, truth.relic[name]) | {
            "ssim_to_ceiling": to_ceiling["ssim"],
            "psnr_to_ceiling_db": to_ceiling["psnr_db"],
            "flip_to_ceiling": to_ceiling["flip"],
        }
    # No FLIP here: an EIA is never looked at as a picture, so its visibility model says nothing.
    reference = truth.eia.image
    return {
        "eia": {"ssim": metrics.ssim(reference, eia), "psnr_db": metrics.psnr_db(reference, eia)},
        "views": views,
    }


def _report_data(
    job: _Run, truth: _GroundTruth, algorithms: dict[str, Any], backend: Any
) -> dict[str, Any]:
    plan, eia = job.plan, truth.eia
    with job.stage("score"):
        noise_floor = {
            "eia": {
                "ssim": metrics.ssim(eia.first, eia.second),
                "psnr_db": metrics.psnr_db(eia.first, eia.second),
            },
            "views": {n: metrics.score(t.first, t.second) for n, t in truth.views.items()},
        }
        ceiling = {n: metrics.score(t.image, truth.ceiling[n]) for n, t in truth.views.items()}
    covered = truth.rgbd.depth_mm[truth.rgbd.covered]
    fit = truth.fitted.fit
    return {
        "schema": SCHEMA,
        "title": plan.settings.title or plan.request.scene.stem,
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "inim_version": __version__,
        "versions": _versions(),
        "command": shlex.join(["python", "-m", "inim.validate", *plan.request.command()]),
        "scene": {
            "path": str(plan.request.scene),
            "sha256": plan.file.sha256,
            "shapes": truth.fitted.shapes,
            "fit": {
                "scale_xy": fit.scale_xy,
                "scale_z": fit.scale_z,
                "display_from_world": fit.display_from_world.tolist(),
            },
        },
        "settings": asdict(plan.settings),
        "display": {"given": plan.display.given(), "derived": plan.display.derived()},
        "backend": {
            "variant": backend.variant,
            "libllvm": backend.libllvm_version,
            "device": backend.device,
        },
        "lens_model": plan.settings.lens_model,
        "viewpoints": [
            {"name": v.name, "position_mm": list(v.position_mm)} for v in plan.viewpoints
        ],
        "rgbd": {
            "rows": truth.rgbd.shape[0],
            "columns": truth.rgbd.shape[1],
            "pixel_mm": truth.rgbd.pixel_mm,
            "covered_fraction": float(truth.rgbd.covered.mean()),
            "depth_min_mm": float(covered.min()) if covered.size else None,
            "depth_max_mm": float(covered.max()) if covered.size else None,
        },
        "noise_floor": noise_floor,
        "ceiling": {"views": ceiling},
        "algorithms": algorithms,
        "timings": job.timings,
        "warnings": job.warnings,
        "verdict": {"passed": all(c["passed"] for c in job.checks), "checks": job.checks},
        "files": _listed_files(job.folder),
    }


def _listed_files(folder: Path) -> list[str]:
    """Every file of the report, so that a later run can tell its own from the user's."""
    pictures = (str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())
    return sorted([*pictures, "report.html", "report.json", "junit.xml", "summary.md"])


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in _VERSIONS:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "unknown"
    return found


def _print_scores(listener: Listener, data: Mapping[str, Any]) -> None:
    width = max(len(name) for name in data["algorithms"])
    for name, result in data["algorithms"].items():
        for view, score in result["views"].items():
            ceiling = data["ceiling"]["views"][view]
            listener.line(
                f"{name:{width}}  {view:8}  SSIM {score['ssim']:.4f} (ceiling "
                f"{ceiling['ssim']:.4f})  to ceiling {score['ssim_to_ceiling']:.4f}  "
                f"PSNR {score['psnr_db']:.2f} dB  FLIP {score['flip']:.4f}"
            )
