"""Validation of a user's own picture: scores that need neither a scene nor a ground truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from inim.apps.own_picture.fit import empty_share
from inim.apps.own_picture.page import write_picture_report
from inim.apps.own_picture.picture import MAX_LOST_SHARE, CameraPicture
from inim.display import Display, Viewpoint
from inim.display.lens import check_lens_model
from inim.display.pixels import exact_ratio
from inim.display.viewpoint import parse_viewpoints
from inim.generators import (
    SourceGenerator,
    algorithm_items,
    check_algorithm,
    foreign_errors,
    generate,
    warp_to_viewpoint,
)
from inim.generators.base import MOST_OUTSIDE, outside_depth_range, outside_depth_text
from inim.generators.oracle import ExactHits, exact_hits, why_no_oracle
from inim.generators.registry import properties
from inim.image.files.eia_file import write_eia
from inim.image.files.image import read_rgbd, write_png, write_rgbd
from inim.image.noisy_image import NoisyImage, replace_nonfinite
from inim.image.rgbd import RGBD
from inim.pipeline.output import picture_facts, write_rgbd_pngs
from inim.pipeline.request import Choices
from inim.pipeline.stages.generation import GeneratorHandle, hole_fraction
from inim.pipeline.stages.ground_truth import BLACK
from inim.pipeline.stages.method import parse_methods
from inim.pipeline.stages.reconstruction import Optics, reconstruct_views
from inim.pipeline.stages.scene import Renderer
from inim.pipeline.stages.stage import Run
from inim.render.scene_files.file import choose_display
from inim.report.picture_document import (
    FittedPicture,
    PictureAlgorithm,
    PictureDocument,
    PictureView,
)
from inim.scores import metrics
from inim.scores.document_parts import (
    BackendRecord,
    Check,
    Checks,
    DisplayRecord,
    EyePosition,
    check,
    origin,
)
from inim.scores.metrics import MAIN
from inim.system.errors import FileError, UsageError, naming
from inim.system.process.observer import Observer
from inim.system.worker.output import staging_folder
from inim.system.worker.supervisor import run_in_worker

if TYPE_CHECKING:
    from inim.display.settings import Settings


#: Algorithm whose EIA shows exactly the picture's surface: the best result without a ground truth.
EXACT = "template"
_FILES = ("report.json", "report.html", "summary.md", "eia/", "views/")
_VERSIONS = ("drjit", "mitsuba", "numba", "numpy")
_NOT_SCORED = (
    "Views to the scene and to the reference: there is a picture, but no scene.",
    "The EIA to the ground truth, and its noise floor: hidden surfaces are unknown.",
)


@dataclass(frozen=True)
class PictureRequest(Choices):
    """Request to validate a picture.

    `path` is the picture, `picture` contains its depth and the way to fit it to the display; None
    for a picture that is fitted already. `command` is the command line, for the record.
    """

    path: Path
    out: Path
    picture: CameraPicture | None = None
    backend: str = "auto"
    command: str = ""


@dataclass(frozen=True)
class _PicturePlan:
    """A checked request, for the worker."""

    request: PictureRequest
    display: Display
    settings: Settings
    algorithms: list[str]
    viewpoints: tuple[Viewpoint, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]


def run_picture(
    request: PictureRequest,
    *,
    quiet: bool = True,
    debug: bool = False,
    on_warning: Callable[[str], object] | None = None,
    on_note: Callable[[str], object] | None = None,
) -> bool:
    """Validate a picture in a worker process; True if it passed.

    `on_warning` receives the report's warnings before anything is rendered; `on_note` receives the
    facts about a photograph and its framing. Raises `InimError` before the worker starts if
    arguments or pictures are invalid.
    """
    display, settings = choose_display(request.display, request.definitions, "inim validate")
    settings = replace(settings, **request.overrides())
    check_lens_model(settings.lens_model, display)
    if settings.cameras:
        raise UsageError("--cameras: needs a scene; leave it out")
    algorithms = [m.name for m in parse_methods(algorithm_items(settings.algorithms), {})]
    for name in algorithms:
        check_algorithm(name)
    notes: tuple[str, ...] = ()
    if request.picture is None:
        rgbd = read_rgbd(request.path)
        warnings = _fitted_warnings(rgbd, display, str(request.path))
    else:
        pixels_per_pitch = settings.capture_pixels_per_pitch
        display, rgbd, warnings, notes = request.picture.read_and_fit(display, pixels_per_pitch)
    viewpoints = parse_viewpoints(settings.viewpoints, display, settings.viewing_distance_mm)
    _check_picture(rgbd, display, str(request.path))
    for callback, texts in ((on_note, notes), (on_warning, warnings)):
        if callback is not None:
            for text in texts:
                callback(text)
    return run_in_worker(
        "inim.apps.own_picture.validate_picture:run_job",
        lambda: _PicturePlan(request, display, settings, algorithms, viewpoints, warnings, notes),
        staging_folder(request.out, _FILES),
        fill=lambda staging: write_rgbd(staging / "rgbd.exr", rgbd),
        quiet=quiet,
        debug=debug,
    )


def _fitted_warnings(rgbd: RGBD, display: Display, name: str) -> tuple[str, ...]:
    """Warn of a fitted picture of another display's size, or with a large empty area."""
    warnings = []
    per_pitch = max(1, round(exact_ratio(display.pitch_mm / rgbd.pixel_mm)))
    shape = display.capture_shape(per_pitch)
    if any(abs(a - b) > per_pitch for a, b in zip(rgbd.shape, shape, strict=True)):
        height, width = (n * display.capture_pixel_mm(per_pitch) for n in shape)
        warnings.append(
            f"{name}: is {rgbd.width_mm:.4g} x {rgbd.height_mm:.4g} mm; a picture for display "
            f"{display.name} is {width:.4g} x {height:.4g} mm: give the picture's display with "
            "--display"
        )
    empty = empty_share(rgbd.covered, display, rgbd.pixel_mm)
    if empty > MAX_LOST_SHARE:
        warnings.append(
            f"{name}: {empty:.1%} of the lens array is empty: fit the picture again with `inim "
            "generate --save-rgbd` and --fit cover, --orthographic or --missing-depth"
        )
    return tuple(warnings)


def _check_picture(rgbd: RGBD, display: Display, name: str) -> None:
    if not rgbd.covered.any():
        raise FileError(f"{name}: is empty; give a picture with covered pixels")
    if outside_depth_range(rgbd, display) > MOST_OUTSIDE:
        raise FileError(f"{name}: {outside_depth_text(rgbd, display)}")


def run_job(plan: _PicturePlan, staging: Path, observer: Observer) -> bool:
    """Entry point in the worker: generate, reconstruct, score and write."""
    request, display, settings = plan.request, plan.display, plan.settings
    observer.stage("start")
    renderer = Renderer(request.backend, observer)
    rgbd = read_rgbd(staging / "rgbd.exr")
    with naming(request.path):
        results = _evaluate(plan, rgbd, staging, renderer)
    observer.stage("write")
    write_rgbd_pngs(staging, rgbd, display)
    data = PictureDocument(
        title=request.path.stem,
        **origin(request.command, _VERSIONS),
        display=DisplayRecord.of(display),
        lens_model=settings.lens_model,
        picture=FittedPicture(
            **picture_facts(rgbd),
            layers=len(rgbd.layers),
            notes=[": ".join(note.split(maxsplit=1)) for note in plan.notes],
        ),
        warnings=[*plan.warnings],
        backend=BackendRecord.of(renderer.backend),
        **results,
    )
    write_picture_report(data, staging)
    return data.verdict.passed


def _evaluate(plan: _PicturePlan, rgbd: RGBD, folder: Path, renderer: Renderer) -> dict[str, Any]:
    """Generate and score all EIAs, and write the images; returns fields of `PictureDocument`."""
    s, display, viewpoints = plan.settings, plan.display, plan.viewpoints
    names, run = plan.algorithms, Run(observer=renderer.observer)
    optics = Optics(display, s.lens_model, s.view_pixels_per_lens, s.reconstruction_spp, s.seed)

    def reconstruct(name: str, eia: np.ndarray) -> dict[str, np.ndarray]:
        views = reconstruct_views(
            name, NoisyImage.from_image(eia), viewpoints, optics, renderer, run=run
        )
        for viewpoint, view in views.items():
            write_png(folder / "views" / name / f"{viewpoint}.png", view.image)
        return {viewpoint: view.image for viewpoint, view in views.items()}

    eyes = ["reconstruct views"] * len(viewpoints)
    stages = [stage for name in names for stage in (name, *eyes)]
    run.observer.begin(["exact oracle", "views", *eyes, *stages, "write"])
    run.observer.stage("exact oracle")
    no_oracle = why_no_oracle(rgbd, display)
    # Algorithms without an exact column model are compared with the columns of the surface.
    rules = {p.columns if p.exact else "surface" for p in map(properties, names)}
    exact = {rule: exact_hits(rgbd, display, rule) for rule in rules if no_oracle is None}
    run.observer.stage("views")
    front = RGBD(rgbd.color, rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm)
    warps = {
        v.name: warp_to_viewpoint(front, display, v, s.view_pixels_per_lens) for v in viewpoints
    }
    # The area that the picture covers in each view does not depend on an algorithm.
    regions = {name: metrics.relic_region(share > 0) for name, (_, share) in warps.items()}
    for viewpoint, (view, _) in warps.items():
        write_png(folder / "views" / "picture" / f"{viewpoint}.png", view)
    exact_eia = generate(front, display, EXACT)
    write_eia(folder / "eia" / "exact.png", exact_eia, None, display.pixel_pitch_mm)
    exact_views = reconstruct("exact", exact_eia)
    viewing = {v.name: optics.viewing_conditions(v, s.luminance_cd_m2) for v in viewpoints}

    def score(eye: str, reference: np.ndarray, view: np.ndarray) -> dict[str, float | None]:
        return {**metrics.score(reference, view, regions[eye], viewing[eye])}

    algorithms, checks = {}, []
    for name in names:
        run.observer.stage(name)
        generator = GeneratorHandle(name, display, rgbd.shape, rgbd.pixel_mm)
        eia, properties_of_eia = _generate_eia(generator, rgbd, exact, folder)
        scores = {
            viewpoint: PictureView(
                to_picture=score(viewpoint, warps[viewpoint][0], view),
                to_exact=score(viewpoint, exact_views[viewpoint], view),
            )
            for viewpoint, view in reconstruct(name, eia).items()
        }
        result = algorithms[name] = PictureAlgorithm(**properties_of_eia, views=scores)
        checks += _checks(generator, result)
        run.observer.line(_result_line(name, result))
    oracle_note = [] if no_oracle is None else [f"Wrong sources: {no_oracle}."]
    return {
        "viewpoints": [EyePosition(name=v.name, position_mm=v.position_mm) for v in viewpoints],
        "oracle_pixels": max((len(hits.sources) for hits in exact.values()), default=0),
        "exact": {name: score(name, warps[name][0], view) for name, view in exact_views.items()},
        "met_fraction": {name: float(share.mean()) for name, (_, share) in warps.items()},
        "algorithms": algorithms,
        "not_scored": [*_NOT_SCORED, *oracle_note],
        "verdict": Checks(passed=all(check.passed for check in checks), checks=checks),
    }


def _generate_eia(
    generator: GeneratorHandle, rgbd: RGBD, exact: Mapping[str, ExactHits], folder: Path
) -> tuple[np.ndarray, dict[str, Any]]:
    """Generate and write a finite EIA; returns it with its fields of `PictureAlgorithm`."""
    display, algorithm = generator.display, generator.algorithm
    eia, _, empty, _ = generator.run(rgbd)
    seconds = generator.rerun(rgbd).seconds  # prepared and compiled
    wrong_share = None
    if exact and isinstance(generator.generator, SourceGenerator):
        hits = exact[generator.properties.columns if generator.properties.exact else "surface"]
        with foreign_errors(algorithm):
            wrong_share = hits.wrong_share(generator.generator.sources(rgbd))
    nonfinite_share = float((~np.isfinite(eia).all(axis=-1)).mean())
    (eia,), _ = replace_nonfinite(eia)
    write_eia(folder / "eia" / f"{algorithm}.png", eia, empty, display.pixel_pitch_mm)
    return eia, {
        "seconds": seconds,
        "wrong_source": wrong_share,
        "hole_fraction": hole_fraction(empty, display, None),
        "not_finite": nonfinite_share,
        "brightest": float(eia.max()),
    }


def _checks(generator: GeneratorHandle, result: PictureAlgorithm) -> list[Check]:
    """Check an EIA; an exact algorithm must have no wrong sources."""
    name = generator.algorithm
    checks = [
        check(f"{name}: brightest value", result.brightest, ">=", BLACK, "not black"),
        check(f"{name}: values not finite", result.not_finite, "<=", 0.0, "all are numbers"),
    ]
    if generator.properties.exact and result.wrong_source is not None:
        detail = "exact first hits by definition"
        checks.append(check(f"{name}: wrong sources", result.wrong_source, "<=", 0.0, detail))
    return checks


def _result_line(name: str, result: PictureAlgorithm) -> str:
    wrong = "     –" if result.wrong_source is None else f"{result.wrong_source:6.2%}"
    to_picture = np.mean([v.to_picture[MAIN.on_relic_key] for v in result.views.values()])
    to_exact = np.mean([v.to_exact[MAIN.on_relic_key] for v in result.views.values()])
    return (
        f"{name:24}  wrong source {wrong}  SSIM on the covered area {to_picture:.4f} to the "
        f"picture, {to_exact:.4f} to the exact EIA's view"
    )
