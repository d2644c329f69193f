"""The run: fit the picture, make each EIA, look at it, score what can be scored, write."""

from __future__ import annotations

import argparse
import shlex
import shutil
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from inim import backend as backends
from inim import metrics
from inim.commands.display_choice import chosen_display
from inim.display.viewpoint import Viewpoint, parse_viewpoints
from inim.errors import FileError, UsageError
from inim.files.image import read_rgbd, write_png, write_rgbd
from inim.files.true_size import write_eia
from inim.generators import SourceGenerator, check_algorithm, generate, prepare
from inim.lens import check_lens_model
from inim.pipeline.checks import BLACK
from inim.pipeline.method import parse_methods
from inim.pipeline.picture_oracle import ExactHits, exact_hits, why_no_oracle
from inim.pipeline.plugin_guard import blamed, run_generator
from inim.pipeline.warp import warped
from inim.provenance import backend_data, versions
from inim.report.without_scene import SCHEMA, write_picture_report
from inim.rgbd import RGBD, LayeredRGBD
from inim.version import __version__
from inim.worker.output import open_staging, publish
from inim.worker.supervisor import outcome_of, supervise

if TYPE_CHECKING:
    from inim.display import Display
    from inim.settings import Settings

__all__ = ["EXACT", "run_picture", "work"]

#: Its EIA shows just what the picture says: all that can be asked for without a ground truth.
EXACT = "template:samples=4"
# What the worker needs of the arguments.
_SETTINGS = ("display", "definitions", "algorithms", "viewpoints", "lens_model", "backend")
_VERSIONS = ("drjit", "mitsuba", "numba", "numpy", "scikit-image")
# Algorithms that show the exact first hits by definition.
_EXACT_KINDS = ("template", "layered")
_NOT_SCORED = (
    "Views against the scene, on the relic, to the ceiling: there is no scene, only its picture.",
    "The EIA against ground truth, and its noise floor: nobody knows what the camera did not see.",
)


def run_picture(args: argparse.Namespace) -> tuple[bool, Path]:
    """Carry out `inim validate` on a picture; whether every check passed, and the folder.

    Raises
    ------
    InimError
        Every mistake in the arguments and pictures is found out before a worker is started.
    """
    from inim.commands.generate import fitted_picture

    _check(args)
    display, settings = _chosen(args)
    names = _algorithms(settings.algorithms)
    _viewpoints(display, settings)
    warnings: tuple[str, ...] = ()
    if args.rgbd is not None:
        rgbd = read_rgbd(args.rgbd)
    else:
        rgbd, warnings = fitted_picture(args, display, settings)
    named = args.rgbd or args.color
    _check_picture(rgbd, display, str(named))
    out = args.out or Path(f"{named.stem}-report")
    backend = backends.choose_backend(args.backend)
    staging = open_staging(out)
    try:
        write_rgbd(staging / "rgbd.exr", rgbd)
        job = {
            "args": {name: getattr(args, name) for name in _SETTINGS},
            "names": names,
            "warnings": warnings,
            "title": named.stem,
            "command": shlex.join(["inim", "validate", *_command(args, out)]),
            "out": str(out),
            "staging": str(staging),
            "quiet": args.quiet,
            "debug": args.debug,
        }
        return outcome_of(supervise("inim.pipeline.own_picture:work", job, backend)), out
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _check(args: argparse.Namespace) -> None:
    """What belongs to a scene, or to the other kind of picture."""
    if args.scene is not None:
        raise UsageError(f"{args.scene}: a scene and a picture; validate one of them")
    if args.rgbd is not None and (args.color is not None or args.depth is not None):
        raise UsageError("--rgbd: is a fitted picture; leave --color and --depth out, or --rgbd")
    for option in ("eias", "misalign", "baseline", "time", "lazy"):
        if getattr(args, option, None):
            shown = f"--{option.removesuffix('s')}"
            raise UsageError(f"{shown}: needs the ground truth of a scene; leave it out")


def _command(args: argparse.Namespace, out: Path) -> list[str]:
    """The command line that repeats this, after `inim validate`."""
    from inim.commands.generate import add_picture_arguments

    parser = argparse.ArgumentParser()
    add_picture_arguments(parser)
    unsaid = vars(parser.parse_args([]))
    unsaid |= dict.fromkeys(("rgbd", "display", "algorithms", "viewpoints", "lens_model"))
    words = ["-o", str(out)]
    for item in args.definitions:
        words += ["-D", item]
    for name, default in unsaid.items():
        value = getattr(args, name)
        if value != default:
            words += [f"--{name.replace('_', '-')}", *([] if value is True else [str(value)])]
    return words


def _chosen(args: argparse.Namespace) -> tuple[Display, Settings]:
    """The display, and the settings with what the command line says of them."""
    display, settings = chosen_display(args.display, args.definitions, "inim validate")
    said = {name: getattr(args, name) for name in ("algorithms", "viewpoints", "lens_model")}
    settings = replace(settings, **{k: v for k, v in said.items() if v is not None})
    check_lens_model(settings.lens_model, display)
    return display, settings


def _algorithms(text: str) -> list[str]:
    names = [contender.name for contender in parse_methods(text, ())]
    for name in names:
        check_algorithm(name)
    return names


def _viewpoints(display: Display, settings: Settings) -> tuple[Viewpoint, ...]:
    distance = settings.viewing_distance_mm
    return parse_viewpoints(settings.viewpoints, display, distance)


def _check_picture(rgbd: RGBD, display: Display, named: str) -> None:
    low, high = display.depth_range_mm
    depth = rgbd.depth_mm[rgbd.covered]
    if not len(depth):
        raise FileError(f"{named}: covers nothing; there is nothing to validate with")
    outside = float(((depth < low) | (depth > high)).mean())
    if outside > 0.5:
        raise FileError(
            f"{named}: {outside:.0%} of it lie outside the display's depth range, {low:.4g} to "
            f"{high:.4g} mm; fit it to this display with `inim generate --rgbd`"
        )
    if not np.isfinite(rgbd.palette).all():
        raise FileError(f"{named}: has colours that are not finite; mend them")


def work(job: dict[str, Any], listener: Any) -> bool:
    """The worker's side: make, look, score, write, publish."""
    staging = Path(job["staging"])
    listener.stage("start")
    from inim.render import variant

    backend = variant.use(job["args"]["backend"])
    display, settings = _chosen(argparse.Namespace(**job["args"]))
    rgbd = read_rgbd(staging / "rgbd.exr")
    scored = _scored(job, rgbd, display, settings, listener)
    listener.stage("write")
    write_png(staging / "picture.png", rgbd.color)
    data = _record(job, display, settings, rgbd) | {"backend": backend_data(backend)} | scored
    write_picture_report(data, staging)
    publish(staging, Path(job["out"]))
    return bool(data["verdict"]["passed"])


def _record(
    job: dict[str, Any], display: Display, settings: Settings, rgbd: RGBD
) -> dict[str, Any]:
    """What made it and how to make it again."""
    depth = rgbd.depth_mm[rgbd.covered]
    return {
        "schema": SCHEMA,
        "title": job["title"],
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "inim_version": __version__,
        "versions": versions(_VERSIONS),
        "command": job["command"],
        "display": {"given": display.given(), "derived": display.derived()},
        "lens_model": settings.lens_model,
        "picture": {
            "rows": rgbd.shape[0],
            "columns": rgbd.shape[1],
            "pixel_mm": rgbd.pixel_mm,
            "layers": len(rgbd.layers) if isinstance(rgbd, LayeredRGBD) else 1,
            "covered_fraction": float(rgbd.covered.mean()),
            "depth_min_mm": float(depth.min()),
            "depth_max_mm": float(depth.max()),
        },
        "warnings": job["warnings"],
    }


def _scored(
    job: dict[str, Any], rgbd: RGBD, display: Display, settings: Settings, listener: Any
) -> dict[str, Any]:
    """Scores, checks and pictures; `not_scored` says what is missing and why."""
    from inim.render.reconstruct import exposed_views

    folder = Path(job["staging"])
    viewpoints = _viewpoints(display, settings)
    views_of = partial(
        exposed_views,
        display=display,
        viewpoints=viewpoints,
        lens_model=settings.lens_model,
        pixels_per_lens=settings.view_pixels_per_lens,
        spp=settings.reconstruction_spp,
        seed=settings.seed,
    )
    listener.stage("exact oracle")
    why = why_no_oracle(rgbd, display)
    exact = exact_hits(rgbd, display) if why is None else None
    listener.stage("views")
    front = RGBD(rgbd.color, rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm)
    direct = {v.name: warped(front, display, v, settings.view_pixels_per_lens) for v in viewpoints}
    best = views_of(generate(front, display, EXACT))
    for viewpoint, view in zip(viewpoints, best, strict=True):
        write_png(folder / "views" / "picture" / f"{viewpoint.name}.png", direct[viewpoint.name][0])
        write_png(folder / "views" / "exact" / f"{viewpoint.name}.png", view)
    algorithms = {}
    for name in job["names"]:
        listener.stage(name)
        made = _made(name, rgbd, display, exact, folder)
        seen = views_of(made.pop("eia"))
        made["views"] = {}
        for viewpoint, view, reference in zip(viewpoints, seen, best, strict=True):
            write_png(folder / "views" / name / f"{viewpoint.name}.png", view)
            made["views"][viewpoint.name] = {
                "to_picture": metrics.score(direct[viewpoint.name][0], view),
                "to_exact": metrics.score(reference, view),
            }
        algorithms[name] = made
        listener.line(_line(name, made))
    checks = _checks(algorithms)
    return {
        "viewpoints": [{"name": v.name, "position_mm": list(v.position_mm)} for v in viewpoints],
        "oracle_pixels": 0 if exact is None else len(exact.sources),
        "exact": {
            v.name: metrics.score(direct[v.name][0], view)
            for v, view in zip(viewpoints, best, strict=True)
        },
        "met_fraction": {name: float(met.mean()) for name, (_, met) in direct.items()},
        "algorithms": algorithms,
        "not_scored": [*_NOT_SCORED, *([] if why is None else [f"Wrong sources: {why}."])],
        "verdict": {"passed": all(c["passed"] for c in checks), "checks": checks},
    }


def _made(
    name: str, rgbd: RGBD, display: Display, exact: ExactHits | None, folder: Path
) -> dict[str, Any]:
    """An algorithm's EIA, written, and what can be said of it by itself."""
    with blamed(name, "prepare"):
        generator = prepare(display, name, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm)
    eia, seconds, empty = run_generator(name, generator, rgbd, display)
    wrong = None
    if exact is not None and isinstance(generator, SourceGenerator):
        with blamed(name, "sources"):
            wrong = exact.wrong_share(generator.sources(rgbd))
    lensed = display.lensed
    finite = np.isfinite(eia).all(axis=-1)
    eia = np.where(finite[..., None], eia, np.float32(0))
    write_eia(folder / "eia" / f"{name}.png", eia, empty, display.pixel_pitch_mm)
    return {
        "eia": eia,
        "seconds": seconds,
        "wrong_source": wrong,
        "hole_fraction": None if empty is None else float(empty[lensed].mean()),
        "not_finite": float((~finite).mean()),
        "brightest": float(eia.max()),
    }


def _checks(algorithms: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """What must hold of any EIA, and of those that are exact by definition."""
    checks = []
    for name, made in algorithms.items():
        rows = [
            ("brightest value", made["brightest"], ">=", BLACK, "not black"),
            ("values not finite", made["not_finite"], "<=", 0.0, "all are numbers"),
        ]
        if name.partition(":")[0] in _EXACT_KINDS and made["wrong_source"] is not None:
            detail = "the exact first hits, by its definition"
            rows.append(("wrong sources", made["wrong_source"], "<=", 0.0, detail))
        for what, value, relation, limit, detail in rows:
            passed = value >= limit if relation == ">=" else value <= limit
            check = {"value": value, "relation": relation, "limit": limit, "detail": detail}
            checks.append({"name": f"{name}: {what}", **check, "passed": passed})
    return checks


def _line(name: str, made: Mapping[str, Any]) -> str:
    wrong = "     –" if made["wrong_source"] is None else f"{made['wrong_source']:6.2%}"
    views = made["views"].values()
    ssim = [np.mean([v[to]["ssim"] for v in views]) for to in ("to_picture", "to_exact")]
    return (
        f"{name:24}  wrong source {wrong}  view SSIM to the picture {ssim[0]:.4f}, to the exact "
        f"EIA's view {ssim[1]:.4f}"
    )
