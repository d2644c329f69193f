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
from inim.backend.kernels import compiled, prange
from inim.display import Display, Viewpoint
from inim.display.viewpoint import parse_viewpoints
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
from inim.generators.base import HOLE, MOST_OUTSIDE, outside_depth_range
from inim.generators.oracle import ExactHits, exact_hits, why_no_oracle
from inim.generators.raycast.columns import SURFACE, columns_of
from inim.generators.raycast.ray_by_ray import first_hit
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
from inim.worker.output import default_out, publish, staging_folder
from inim.worker.supervisor import run_in_worker

if TYPE_CHECKING:
    from inim.settings import Settings


#: Its EIA shows just what the picture says: all that can be asked for without a ground truth.
EXACT = "template:samples=4"
# Rays along each side of a view pixel.
_RAYS = 4
_FILES = ("report.json", "report.html", "summary.md", "eia/", "views/")
_VERSIONS = ("drjit", "mitsuba", "numba", "numpy", "scikit-image")
_NOT_SCORED = (
    "Views against the scene, and to the reference: there is no scene, only its picture.",
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


@dataclass(frozen=True)
class _Plan:
    """A request, checked: what the worker carries out."""

    request: PictureRequest
    display: Display
    settings: Settings
    algorithms: list[str]
    viewpoints: tuple[Viewpoint, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]


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
    display, settings = choose_display(request.display, request.definitions, "inim validate")
    settings = replace(settings, **request.overrides())
    check_lens_model(settings.lens_model, display)
    algorithms = [m.name for m in parse_methods(algorithm_items(settings.algorithms), {})]
    for name in algorithms:
        check_algorithm(name)
    viewpoints = parse_viewpoints(settings.viewpoints, display, settings.viewing_distance_mm)
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
        lambda: _Plan(request, display, settings, algorithms, viewpoints, warnings, notes),
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


def work(plan: _Plan, staging: Path, observer: Observer) -> bool:
    """The worker's side: make, look, score, write, publish."""
    request, display, settings = plan.request, plan.display, plan.settings
    observer.stage("start")
    renderer = Renderer(request.backend, observer)
    rgbd = read_rgbd(staging / "rgbd.exr")
    scored = _scored(plan, rgbd, staging, renderer)
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
        picture=_fitted(rgbd, plan.notes),
        warnings=[*plan.warnings],
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


def _scored(plan: _Plan, rgbd: RGBD, folder: Path, renderer: Renderer) -> dict[str, Any]:
    """Scores, checks and pictures; `not_scored` says what is missing and why."""
    s, display, viewpoints = plan.settings, plan.display, plan.viewpoints
    names, run = plan.algorithms, Run(observer=renderer.observer)
    optics = Optics(display, s.lens_model, s.view_pixels_per_lens, s.reconstruction_spp, s.seed)

    def views_of(name: str, eia: np.ndarray) -> dict[str, np.ndarray]:
        seen = reconstruct_views(
            name, NoisyImage.from_image(eia), viewpoints, optics, renderer, run=run
        )
        for viewpoint, view in seen.items():
            write_png(folder / "views" / name / f"{viewpoint}.png", view.image)
        return {viewpoint: view.image for viewpoint, view in seen.items()}

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


def warped(
    rgbd: RGBD, display: Display, eye: Viewpoint, pixels_per_lens: int
) -> tuple[np.ndarray, np.ndarray]:
    """What an eye sees of a picture through the window of the array.

    Each ray shows the first of the picture's columns that it meets, as thick as the surface that
    each pixel shows: what `template` takes the picture for, from another place.

    Parameters
    ----------
    rgbd : RGBD
        Linear float32.
    display : Display
    eye : Viewpoint
        As a point.
    pixels_per_lens : int
        Of the view, along each side.

    Returns
    -------
    view : (rows, columns, 3) float32, linear RGB
        Black where nothing is met.
    met : (rows, columns) float32
        Share of each pixel's rays that meet something.
    """
    rows, columns = (n * pixels_per_lens for n in (display.lens_rows, display.lens_columns))
    x = _places(columns, display.width_mm)
    y = -_places(rows, display.height_mm)
    slope_x, slope_y = (eye.x_mm - x) / eye.z_mm, (eye.y_mm - y) / eye.z_mm
    columns_met = columns_of(rgbd, SURFACE)
    met_by_rays = (columns_met.fronts(), columns_met.backs(), columns_met.continue_behind)
    view = np.zeros((rows, columns, 3), np.float32)
    met = np.zeros((rows, columns), np.float32)
    # In cells from the picture's left and upper border; rows count downwards.
    across = (x / rgbd.pixel_mm + rgbd.shape[1] / 2, slope_x / rgbd.pixel_mm)
    down = (rgbd.shape[0] / 2 - y / rgbd.pixel_mm, -slope_y / rgbd.pixel_mm)
    _see(*met_by_rays, rgbd.color, *across, *down, *display.depth_range_mm, view, met)
    return view, met


def _places(pixels: int, size_mm: float) -> np.ndarray:
    """Centres of a view's rays across the window, mm from its middle."""
    rays = pixels * _RAYS
    centres: np.ndarray = ((np.arange(rays) + 0.5) / rays - 0.5) * size_mm
    return centres


@compiled(parallel=True)
def _see(fronts, backs, continue_behind, color, u0, du, v0, dv, z_min, z_max, view, met):  # type: ignore[no-untyped-def]
    """Mean colour of what each pixel's rays meet, and how many do."""
    columns = fronts.shape[2]
    share = np.float32(1 / (_RAYS * _RAYS))
    for row in prange(view.shape[0]):
        for column in range(view.shape[1]):
            for i in range(row * _RAYS, (row + 1) * _RAYS):
                for j in range(column * _RAYS, (column + 1) * _RAYS):
                    hit = first_hit(
                        fronts, backs, continue_behind,
                        u0[j], du[j], 1.0, v0[i], dv[i], 1.0, z_min, z_max,
                    )  # fmt: skip
                    if hit != HOLE:
                        met[row, column] += share
                        for c in range(3):
                            view[row, column, c] += share * color[hit // columns, hit % columns, c]
