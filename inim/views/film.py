"""Film of a report's views: an animated GIF or WebP, or an MP4 if its encoder is installed.

If the scene is one of the panes, the others are scored against it by a video metric, in which
flips and crosstalk count as jumps in time.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from inim.display import Display
from inim.display.misalignment import misaligned
from inim.display.viewpoint import Viewpoint, eye_path
from inim.errors import FileError, InimError, UsageError
from inim.lens import check_lens_model
from inim.metrics import Viewing, cvvdp
from inim.pipeline.stages.reconstruction import Optics
from inim.pipeline.stages.scene import Renderer
from inim.process.observer import Observer
from inim.report import Report
from inim.views.frames import TracedScene, frames
from inim.worker.output import hidden_folder, publish_file
from inim.worker.supervisor import run_in_worker

_KINDS = (".gif", ".webp", ".mp4")
_ENCODER = "imageio_ffmpeg"
_WEBP_QUALITY = 90
#: Name of the ground-truth EIA's pane in `show`.
REFERENCE = "reference"
_SCENE = "scene"
# Smaller frames are magnified to about this size, by whole numbers to keep the lenses' edges.
_MIN_ROWS_PX = 384
_SPACE_BETWEEN_PX = 8
_LABEL_ROWS_PX = 28
_MAX_FRAMES = 2000


@dataclass(frozen=True)
class FilmRequest:
    """Request to render a film of the report in `folder`, with panes side by side.

    `show` are the panes: "reference" or names of the report's algorithms. `scene` adds the report's
    scene as the first pane, against which the others are scored. `path` is that of
    `inim.display.viewpoint.eye_path`, which may leave the viewing zone with `allow_flips`. `spp`
    are the samples per view pixel.
    """

    folder: str
    out: str
    show: tuple[str, ...]
    path: str
    lens_model: str
    frames: int
    frames_per_second: float
    spp: int
    pixels_per_lens: int
    allow_flips: bool = False
    scene: TracedScene | None = None


def make_film(request: FilmRequest, *, quiet: bool = True, debug: bool = False) -> None:
    """Render a film in a worker process, after checking the request; raises `InimError`."""
    run_in_worker(
        "inim.views.film:run_job",
        lambda: _check_request(request),
        hidden_folder(Path(request.out)),
        about=request.out,
        quiet=quiet,
        debug=debug,
    )


def _check_request(request: FilmRequest) -> FilmRequest:
    """Return the request after all checks that need no rendering."""
    out = Path(request.out)
    _check_kind(out)
    if out.is_dir():
        raise FileError(f"{out}: is a folder; give the path of a film with -o")
    for name, value, high in (
        ("--frames", request.frames, _MAX_FRAMES),
        ("--rate", request.frames_per_second, 100),
        ("--view-spp", request.spp, 2**16),
    ):
        if not 1 <= value <= high:
            raise UsageError(f"{name} {value:g}: must be in 1..{high}")
    report = Report.load(request.folder)
    display, design = _displays(request, report)
    eye_path(request.path, design, request.frames, allow_flips=request.allow_flips)
    _read_eias(request, report, display)
    if request.scene is not None:
        request.scene.file()
    return request


def _displays(request: FilmRequest, report: Report) -> tuple[Display, Display]:
    """The report's display with its misalignment, and as designed."""
    design = report.display
    try:
        display = misaligned(design, report.data.misalign)
        check_lens_model(request.lens_model, display)
    except InimError as error:
        raise FileError(f"{request.folder}: {error}") from None
    return display, design


def _read_eias(request: FilmRequest, report: Report, display: Display) -> list[np.ndarray]:
    """Read the EIAs of the panes, (rows, columns, 3) float32 linear."""
    from inim.files.eia_file import read_eia

    paths = [report.eia_path(name, "--algorithms", true=REFERENCE) for name in request.show]
    return [read_eia(path, display)[0] for path in paths]


def run_job(request: FilmRequest, staging: Path, observer: Observer) -> bool:
    """Entry point in the worker: render all views, write the film and publish it."""
    observer.stage("start")
    out = Path(request.out)
    film = staging / f"film{out.suffix.lower()}"
    report = Report.load(request.folder)
    display, design = _displays(request, report)
    eyes = eye_path(request.path, design, request.frames, allow_flips=request.allow_flips)
    # A frame is a half image of a view.
    optics = Optics(display, request.lens_model, request.pixels_per_lens, 2 * request.spp, seed=0)
    panes = _panes(request, report, optics, eyes, observer)
    names, views = zip(*panes, strict=True)
    observer.stage("write")
    film_frames = [_frame(row, names) for row in zip(*views, strict=True)]
    write_film(film, film_frames, request.frames_per_second)
    publish_file(film, out)
    if request.scene is not None:
        observer.stage("score")
        luminance = report.data.settings.luminance_cd_m2
        for line in _score_lines(panes, optics.viewing(eyes[0], luminance), request):
            observer.line(line)
    return True


#: A pane's name, and its views, (rows, columns, 3) uint8 sRGB.
_Pane = tuple[str, list[np.ndarray]]


def _panes(
    request: FilmRequest,
    report: Report,
    optics: Optics,
    eyes: Sequence[Viewpoint],
    observer: Observer,
) -> list[_Pane]:
    """Render the panes, the scene first."""
    design = report.display
    sources: list[tuple[str, str, np.ndarray | TracedScene]] = [
        (name, "film", eia)
        for name, eia in zip(request.show, _read_eias(request, report, optics.display), strict=True)
    ]
    if request.scene is not None:
        sources.insert(0, (_SCENE, _SCENE, request.scene))
    stages = [stage for _, stage, _ in sources for _ in eyes]
    observer.begin([*stages, "write", *([] if request.scene is None else ["score"])])
    renderer = Renderer("auto", observer)
    return [
        (name, [*frames(source, eyes, optics, design, renderer, stage)])
        for name, stage, source in sources
    ]


def _score_lines(panes: Sequence[_Pane], viewing: Viewing, request: FilmRequest) -> list[str]:
    """Score each pane against the scene as a video, one line each."""
    if not cvvdp.is_installed():
        return ["not scored: pip install 'inim[perception]'"]
    (_, scene), *others = panes
    return [
        f"{name}: {cvvdp.film_jod(scene, frames, viewing, request.frames_per_second):.2f} JOD "
        f"as a film, at {viewing.pixels_per_degree:.3g} pixels per degree and "
        f"{viewing.luminance_cd_m2:g} cd/m^2"
        for name, frames in others
    ]


def _frame(views: Sequence[np.ndarray], names: Sequence[str]) -> np.ndarray:
    """Arrange views side by side under their names, magnified to an even size."""
    rows = views[0].shape[0]
    factor = max(1, math.ceil(_MIN_ROWS_PX / rows))
    large = [
        np.concatenate(
            [_label(name, factor * view.shape[1]), view.repeat(factor, 0).repeat(factor, 1)]
        )
        for name, view in zip(names, views, strict=True)
    ]
    space = np.zeros((large[0].shape[0], _SPACE_BETWEEN_PX, 3), np.uint8)
    parts = [large[0], *(part for view in large[1:] for part in (space, view))]
    frame = np.concatenate(parts, axis=1)
    return np.pad(frame, [(0, frame.shape[0] % 2), (0, frame.shape[1] % 2), (0, 0)])


def _label(name: str, columns: int) -> np.ndarray:
    """A pane's name in white on black, (rows, columns, 3) uint8."""
    from matplotlib import get_data_path
    from PIL import Image, ImageDraw, ImageFont

    band = Image.new("RGB", (columns, _LABEL_ROWS_PX))
    font = ImageFont.truetype(Path(get_data_path(), "fonts/ttf/DejaVuSans.ttf"), 16)
    middle = (columns / 2, _LABEL_ROWS_PX / 2)
    ImageDraw.Draw(band).text(middle, name, "white", font, anchor="mm")
    return np.asarray(band)


def _check_kind(path: Path) -> None:
    """Raise `UsageError` for an unknown file type, or for MP4 without its encoder."""
    kind = path.suffix.lower()
    if kind not in _KINDS:
        raise UsageError(f"{path}: unknown film type; use {', '.join(_KINDS[:-1])} or {_KINDS[-1]}")
    if kind == ".mp4" and importlib.util.find_spec(_ENCODER) is None:
        raise UsageError(
            f"{path}: .mp4 needs imageio-ffmpeg; pip install imageio-ffmpeg, or use .webp or .gif"
        )


def write_film(path: Path, frames: Sequence[np.ndarray], frames_per_second: float) -> None:
    """Write frames, (rows, columns, 3) uint8 sRGB, as a film that loops (GIF, WebP) or not (MP4).

    The suffix of the path is the type. Frames of an MP4 have even numbers of rows and columns.
    Raises `UsageError` for an unknown type or a missing MP4 encoder, and `FileError` if the file
    cannot be written.
    """
    _check_kind(path)
    try:
        if path.suffix.lower() == ".mp4":
            _write_mp4(path, frames, frames_per_second)
        else:
            _write_animation(path, frames, frames_per_second)
    except OSError as error:
        raise FileError(f"{path}: cannot be written ({error.strerror or error})") from error


def _write_animation(path: Path, frames: Sequence[np.ndarray], frames_per_second: float) -> None:
    from PIL import Image

    gif = path.suffix.lower() == ".gif"
    options = {} if gif else {"quality": _WEBP_QUALITY, "method": 4}
    # GIF counts in hundredths of a second, and players treat 1/100 as a mistake.
    minimum, unit = (20, 10) if gif else (1, 1)
    duration_ms = max(minimum, unit * round(1000 / frames_per_second / unit))
    first, *rest = map(Image.fromarray, frames)
    first.save(path, save_all=True, append_images=rest, duration=duration_ms, loop=0, **options)


def _write_mp4(path: Path, frames: Sequence[np.ndarray], frames_per_second: float) -> None:
    encoder = importlib.import_module(_ENCODER)
    rows, columns = frames[0].shape[:2]
    writer = encoder.write_frames(
        str(path), (columns, rows), fps=frames_per_second, quality=8, macro_block_size=2
    )
    writer.send(None)  # starts the encoder
    for frame in frames:
        writer.send(np.ascontiguousarray(frame))
    writer.close()
