"""Validation of one's own picture: without a scene, what can be scored without ground truth."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from inim import metrics
from inim.backend.choice import backend_data, versions
from inim.display.viewpoint import Viewpoint, parse_viewpoints
from inim.documents.parts import Backend, Check, Checks, DisplayRecord, EyePosition
from inim.documents.picture import (
    FittedPicture,
    PictureAlgorithm,
    PictureDocument,
    PictureView,
)
from inim.errors import FileError
from inim.files.eia_file import write_eia
from inim.files.image import read_rgbd, write_png, write_rgbd
from inim.from_camera.fit import empty_share
from inim.from_camera.picture import MOST, CameraPicture
from inim.generators import (
    SourceGenerator,
    algorithm_items,
    check_algorithm,
    foreign_errors,
    generate,
)
from inim.generators.base import MOST_OUTSIDE, outside_depth_range
from inim.generators.oracle import ExactHits, exact_hits, why_no_oracle
from inim.generators.registry import properties
from inim.image.noisy_image import NoisyImage, replace_nonfinite
from inim.image.rgbd import RGBD
from inim.lens import check_lens_model
from inim.metrics.headline import MAIN
from inim.pipeline.output.images import write_rgbd_pngs
from inim.pipeline.request import Choices, option_words
from inim.pipeline.stages.checks import BLACK, check
from inim.pipeline.stages.generate import GeneratorHandle, hole_fraction
from inim.pipeline.stages.method import parse_methods
from inim.pipeline.stages.reconstruct import Optics, reconstruct_views
from inim.pipeline.stages.scene import Renderer
from inim.pipeline.stages.stage import Run
from inim.process.observer import Observer
from inim.report.without_scene import write_picture_report
from inim.scene.file import choose_display
from inim.version import __version__
from inim.views.warp import warped
from inim.worker.output import default_out, publish, staging_folder
from inim.worker.supervisor import run_in_worker

if TYPE_CHECKING:
    from inim.display import Display
    from inim.settings import Settings

#: Its EIA shows just what the picture says: all that can be asked for without a ground truth.
EXACT = "template:samples=4"
_FILES = ("report.json", "report.html", "summary.md", "eia/", "views/")
_VERSIONS = ("drjit", "mitsuba", "numba", "numpy", "scikit-image")
_NOT_SCORED = (
    "Views against the scene, and to the ceiling: there is no scene, only its picture.",
    "The EIA against the true one, and its noise floor: nobody knows what the camera did not see.",
)


@dataclass(frozen=True)
class PictureRequest(Choices):
    """A validation of a picture.

    Attributes
    ----------
    picture : CameraPicture
        Colour and depth to fit to the display.
    rgbd : Path, optional
        A fitted picture in its place.
    out : Path, optional
        `PICTURE-report` otherwise.
    backend : {"auto", "llvm", "cuda"}
    """

    picture: CameraPicture
    rgbd: Path | None = None
    out: Path | None = None
    backend: str = "auto"

    @property
    def named(self) -> Path:
        """The file that it is called after."""
        named = self.rgbd or self.picture.shown
        assert named is not None
        return named

    @property
    def folder(self) -> Path:
        """Of the report."""
        return self.out or default_out(self.named, "report")

    def command(self, settings: Settings) -> list[str]:
        """The command line that repeats this request, after `inim validate`."""
        values = {f.name: (getattr(self.picture, f.name), f.default) for f in fields(self.picture)}
        picture = {
            f"--{name.replace('_', '-')}": value
            for name, (value, default) in values.items()
            if value != default
        }
        return option_words(
            {"-o": self.folder, **picture, "--rgbd": self.rgbd, **self.options(settings)}
        )


def no_warning(_: str) -> None:
    """What takes warnings that nobody wants to hear."""


def run_picture(
    request: PictureRequest,
    *,
    quiet: bool = True,
    debug: bool = False,
    warn: Callable[[str], object] = no_warning,
    say: Callable[[str], object] = no_warning,
) -> tuple[bool, Path]:
    """Validate a picture in a worker process; whether every check passed, and the folder.

    `warn` is told what the report warns of, before anything is rendered; `say`, how a photograph
    was taken and framed.

    Raises
    ------
    InimError
        Every mistake in the arguments and pictures is found out before a worker is started.
    """
    display, settings = _chosen(request)
    _algorithms(settings.algorithms)
    _viewpoints(display, settings)
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    if request.rgbd is not None:
        rgbd = read_rgbd(request.rgbd)
        warnings = _fitted_warnings(rgbd, display, str(request.rgbd))
    else:
        pixels_per_pitch = settings.capture_pixels_per_pitch
        rgbd, warnings, notes = request.picture.fitted(display, pixels_per_pitch)
    _check_picture(rgbd, display, str(request.named))
    for note in notes:
        say(note)
    for warning in warnings:
        warn(warning)
    passed = run_in_worker(
        "inim.views.own_picture:work",
        lambda: (request, warnings, notes),
        staging_folder(request.folder, _FILES),
        fill=lambda staging: write_rgbd(staging / "rgbd.exr", rgbd),
        backend=request.backend,
        quiet=quiet,
        debug=debug,
    )
    return passed, request.folder


def _fitted_warnings(rgbd: RGBD, display: Display, name: str) -> tuple[str, ...]:
    """What to know of a fitted picture: of another display's size, or hardly there."""
    empty = empty_share(rgbd.covered, display, rgbd.pixel_mm)
    if empty <= MOST:
        return _made_for_another(rgbd, display, name)
    return (
        *_made_for_another(rgbd, display, name),
        f"{name}: {empty:.1%} of the lens array show nothing: fit it anew with `inim generate "
        "--rgbd` and --fit cover, --orthographic or --fill-depth",
    )


def _made_for_another(rgbd: RGBD, display: Display, name: str) -> tuple[str, ...]:
    """A sentence where a fitted picture has not the size of one for this display."""
    per_pitch = max(1, round(display.pitch_mm / rgbd.pixel_mm))
    wanted = display.capture_shape(per_pitch)
    if all(abs(a - b) <= per_pitch for a, b in zip(rgbd.shape, wanted, strict=True)):
        return ()
    high, wide = (n * display.capture_pixel_mm(per_pitch) for n in wanted)
    return (
        f"{name}: is {rgbd.width_mm:.4g} x {rgbd.height_mm:.4g} mm; a picture for display "
        f"{display.name} is {wide:.4g} x {high:.4g} mm: name the display it was made for "
        "with --display",
    )


def _chosen(request: PictureRequest) -> tuple[Display, Settings]:
    """The display, and the settings with the request's choices."""
    display, settings = choose_display(request.display, request.definitions, "inim validate")
    settings = replace(settings, **request.overrides())
    check_lens_model(settings.lens_model, display)
    return display, settings


def _algorithms(text: str) -> list[str]:
    names = [method.name for method in parse_methods(algorithm_items(text), {})]
    for name in names:
        check_algorithm(name)
    return names


def _viewpoints(display: Display, settings: Settings) -> tuple[Viewpoint, ...]:
    distance = settings.viewing_distance_mm
    return parse_viewpoints(settings.viewpoints, display, distance)


def _check_picture(rgbd: RGBD, display: Display, named: str) -> None:
    low, high = display.depth_range_mm
    if not rgbd.covered.any():
        raise FileError(f"{named}: covers nothing; there is nothing to validate with")
    outside = outside_depth_range(rgbd, display)
    if outside > MOST_OUTSIDE:
        raise FileError(
            f"{named}: {outside:.0%} of it lie outside the display's depth range, {low:.4g} to "
            f"{high:.4g} mm; fit it to this display with `inim generate --rgbd`"
        )
    if not np.isfinite(rgbd.palette).all():
        raise FileError(f"{named}: has colours that are not finite; mend them")


def work(
    requested: tuple[PictureRequest, tuple[str, ...], tuple[str, ...]],
    staging: Path,
    observer: Observer,
) -> bool:
    """The worker's side: make, look, score, write, publish."""
    request, warnings, notes = requested
    observer.stage("start")
    renderer = Renderer(request.backend, observer)
    display, settings = _chosen(request)
    rgbd = read_rgbd(staging / "rgbd.exr")
    scored = _scored(staging, rgbd, display, settings, renderer)
    observer.stage("write")
    write_rgbd_pngs(staging, rgbd, display)
    data = PictureDocument(
        title=request.named.stem,
        created=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        inim_version=__version__,
        versions=versions(_VERSIONS),
        command=shlex.join(["inim", "validate", *request.command(settings)]),
        display=DisplayRecord.of(display),
        lens_model=settings.lens_model,
        picture=_fitted(rgbd, notes),
        warnings=[*warnings],
        backend=Backend(**backend_data(renderer.backend)),
        **scored,
    )
    write_picture_report(data, staging)
    publish(staging, request.folder)
    return data.verdict.passed


def _fitted(rgbd: RGBD, notes: Sequence[str]) -> FittedPicture:
    depth = rgbd.depth_mm[rgbd.covered]
    return FittedPicture(
        rows=rgbd.shape[0],
        columns=rgbd.shape[1],
        pixel_mm=rgbd.pixel_mm,
        layers=len(rgbd.layers),
        covered_fraction=float(rgbd.covered.mean()),
        depth_min_mm=float(depth.min()),
        depth_max_mm=float(depth.max()),
        notes=[": ".join(note.split(maxsplit=1)) for note in notes],
    )


def _scored(
    folder: Path,
    rgbd: RGBD,
    display: Display,
    settings: Settings,
    renderer: Renderer,
) -> dict[str, Any]:
    """Scores, checks and pictures; `not_scored` says what is missing and why."""
    s, viewpoints, run = settings, _viewpoints(display, settings), Run(observer=renderer.observer)
    optics = Optics(display, s.lens_model, s.view_pixels_per_lens, s.reconstruction_spp, s.seed)

    def views_of(name: str, eia: np.ndarray) -> dict[str, np.ndarray]:
        seen = reconstruct_views(
            name, NoisyImage.from_image(eia), viewpoints, optics, renderer, run=run
        )
        for viewpoint, view in seen.items():
            write_png(folder / "views" / name / f"{viewpoint}.png", view.image)
        return {viewpoint: view.image for viewpoint, view in seen.items()}

    names = _algorithms(s.algorithms)
    eyes = ["reconstruct views"] * len(viewpoints)
    each = [stage for name in names for stage in (name, *eyes)]
    run.observer.begin(["exact oracle", "views", *eyes, *each, "write"])
    run.observer.stage("exact oracle")
    why = why_no_oracle(rgbd, display)
    # Of algorithms that are no first hits in columns of their own: those of the surface.
    rules = {p.columns if p.exact else "surface" for p in map(properties, names)}
    exact = {rule: exact_hits(rgbd, display, rule) for rule in rules if why is None}
    run.observer.stage("views")
    front = RGBD(rgbd.color, rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm)
    direct = {v.name: warped(front, display, v, s.view_pixels_per_lens) for v in viewpoints}
    # What the picture covers, seen from each eye: known without any algorithm.
    regions = {name: metrics.relic_region(met > 0) for name, (_, met) in direct.items()}
    for viewpoint, (picture, _) in direct.items():
        write_png(folder / "views" / "picture" / f"{viewpoint}.png", picture)
    exact_eia = generate(front, display, EXACT)
    write_eia(folder / "eia" / "exact.png", exact_eia, None, display.pixel_pitch_mm)
    best = views_of("exact", exact_eia)
    viewing = {v.name: optics.viewing(v, s.luminance_cd_m2) for v in viewpoints}

    def scores(eye: str, reference: np.ndarray, view: np.ndarray) -> dict[str, float | None]:
        return {**metrics.score(reference, view, regions[eye], viewing[eye])}

    algorithms, checks = {}, []
    for name in names:
        run.observer.stage(name)
        generator = GeneratorHandle(name, display, rgbd.shape, rgbd.pixel_mm)
        eia, facts = _made(generator, rgbd, exact, folder)
        scored = {
            viewpoint: PictureView(
                to_picture=scores(viewpoint, direct[viewpoint][0], view),
                to_exact=scores(viewpoint, best[viewpoint], view),
            )
            for viewpoint, view in views_of(name, eia).items()
        }
        result = algorithms[name] = PictureAlgorithm(**facts, views=scored)
        checks += _checks(generator, result)
        run.observer.line(_line(name, result))
    return {
        "viewpoints": [EyePosition(name=v.name, position_mm=v.position_mm) for v in viewpoints],
        "oracle_pixels": max((len(hits.sources) for hits in exact.values()), default=0),
        "exact": {name: scores(name, direct[name][0], view) for name, view in best.items()},
        "met_fraction": {name: float(met.mean()) for name, (_, met) in direct.items()},
        "algorithms": algorithms,
        "not_scored": [*_NOT_SCORED, *([] if why is None else [f"Wrong sources: {why}."])],
        "verdict": Checks(passed=all(check.passed for check in checks), checks=checks),
    }


def _made(
    generator: GeneratorHandle, rgbd: RGBD, exact: Mapping[str, ExactHits], folder: Path
) -> tuple[np.ndarray, dict[str, Any]]:
    """A generator's EIA, finite and written, and what can be said of it by itself."""
    display, algorithm = generator.display, generator.algorithm
    eia, seconds, empty = generator.run(rgbd)
    wrong, known = None, generator.properties
    if exact and isinstance(generator.generator, SourceGenerator):
        hits = exact[known.columns if known.exact else "surface"]
        with foreign_errors(algorithm):
            wrong = hits.wrong_share(generator.generator.sources(rgbd))
    bad = float((~np.isfinite(eia).all(axis=-1)).mean())
    (eia,), _ = replace_nonfinite(eia)
    write_eia(folder / "eia" / f"{algorithm}.png", eia, empty, display.pixel_pitch_mm)
    return eia, {
        "seconds": generator.seconds + seconds,
        "wrong_source": wrong,
        "hole_fraction": hole_fraction(empty, display, None),
        "not_finite": bad,
        "brightest": float(eia.max()),
    }


def _checks(generator: GeneratorHandle, result: PictureAlgorithm) -> list[Check]:
    """What must hold of any EIA, and of one that is exact by definition."""
    name = generator.algorithm
    checks = [
        check(f"{name}: brightest value", result.brightest, ">=", BLACK, "not black"),
        check(f"{name}: values not finite", result.not_finite, "<=", 0.0, "all are numbers"),
    ]
    if generator.properties.exact and result.wrong_source is not None:
        detail = "the exact first hits, by its definition"
        checks.append(check(f"{name}: wrong sources", result.wrong_source, "<=", 0.0, detail))
    return checks


def _line(name: str, result: PictureAlgorithm) -> str:
    wrong = "     –" if result.wrong_source is None else f"{result.wrong_source:6.2%}"
    references = ("to_picture", "to_exact")
    pairs = [
        [getattr(v, to)[MAIN.on_relic_key] for v in result.views.values()] for to in references
    ]
    ssim = [np.mean(values) for values in pairs]
    return (
        f"{name:24}  wrong source {wrong}  SSIM on what the picture covers {ssim[0]:.4f} to it, "
        f"{ssim[1]:.4f} to the exact EIA's view"
    )
