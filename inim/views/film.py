"""Film of a report's views: an animated GIF or WebP, or an MP4 if its encoder is installed.

If the scene is one of the panes, the others are scored against it by a video metric, in which
flips and crosstalk count as jumps in time.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from inim.display.viewpoint import Viewpoint, eye_path
from inim.errors import UsageError
from inim.metrics import Viewing, cvvdp
from inim.process.atomic_file import file_errors
from inim.process.observer import Observer
from inim.views.frames import ViewsRequest, views
from inim.worker.output import publish_file

_KINDS = (".gif", ".webp", ".mp4")
#: Package that writes MP4.
ENCODER = "imageio_ffmpeg"
_WEBP_QUALITY = 90
#: Name of the ground-truth EIA's pane in `show`.
REFERENCE = "reference"
#: Name of the scene among the sources; it is the first.
SCENE = "scene"
# Smaller frames are magnified to about this size, by whole numbers to keep the lenses' edges.
_MIN_ROWS_PX = 384
_SPACE_BETWEEN_PX = 8
_LABEL_ROWS_PX = 28
_MAX_FRAMES = 2000


@dataclass(frozen=True, kw_only=True)
class FilmRequest(ViewsRequest):
    """Request to render a film of sources side by side; the others are scored against a scene.

    `path` is that of `inim.display.viewpoint.eye_path`, which may leave the viewing zone with
    `allow_flips`. `luminance_cd_m2` is that of the panel's white, for the score.
    """

    path: str
    frames: int
    frames_per_second: float
    pixels_per_lens: int
    luminance_cd_m2: float
    allow_flips: bool = False

    @property
    def eyes(self) -> list[Viewpoint]:
        """Viewpoint of each frame."""
        return eye_path(self.path, self.design, self.frames, allow_flips=self.allow_flips)

    def check(self) -> None:
        """See `ViewsRequest`."""
        _check_kind(self.out)
        for name, value, high in (
            ("--frames", self.frames, _MAX_FRAMES),
            ("--rate", self.frames_per_second, 100),
        ):
            if not 1 <= value <= high:
                raise UsageError(f"{name} {value:g}: must be in 1..{high}")
        assert self.eyes  # raises for an invalid path
        super().check()


def run_job(request: FilmRequest, staging: Path, observer: Observer) -> bool:
    """Entry point in the worker: render all views, write the film and publish it."""
    observer.stage("start")
    has_scene, eyes = SCENE in request.sources, request.eyes
    stages = [name for name in request.sources for _ in eyes]
    observer.begin([*stages, "write", *(["score"] if has_scene else [])])
    optics = request.optics(request.pixels_per_lens)
    panes = {name: [*pane] for name, pane in views(request, optics, eyes, observer)}
    observer.stage("write")
    frames = [_frame(row, [*panes]) for row in zip(*panes.values(), strict=True)]
    film = staging / f"film{request.out.suffix.lower()}"
    write_film(film, frames, request.frames_per_second)
    publish_file(film, request.out)
    if has_scene:
        observer.stage("score")
        viewing = optics.viewing_conditions(eyes[0], request.luminance_cd_m2)
        for line in _score_lines(panes, viewing, request.frames_per_second):
            observer.line(line)
    return True


def _score_lines(
    panes: Mapping[str, Sequence[np.ndarray]], viewing: Viewing, frames_per_second: float
) -> list[str]:
    """Score each pane against the scene as a video, one line each."""
    if not cvvdp.is_installed():
        return ["not scored: pip install 'inim[perception]'"]
    return [
        f"{name}: {cvvdp.film_jod(panes[SCENE], pane, viewing, frames_per_second):.2f} JOD "
        f"as a film, at {viewing.pixels_per_degree:.3g} pixels per degree and "
        f"{viewing.luminance_cd_m2:g} cd/m^2"
        for name, pane in panes.items()
        if name != SCENE
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
    if kind == ".mp4" and importlib.util.find_spec(ENCODER) is None:
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
    write = _write_mp4 if path.suffix.lower() == ".mp4" else _write_animation
    with file_errors(path):
        write(path, frames, frames_per_second)


def _write_animation(path: Path, frames: Sequence[np.ndarray], frames_per_second: float) -> None:
    from PIL import Image

    gif = path.suffix.lower() == ".gif"
    options = {} if gif else {"quality": _WEBP_QUALITY, "method": 4}
    # GIF counts in hundredths of a second, and players treat 1/100 as a mistake.
    minimum, unit = (20, 10) if gif else (1, 1)
    duration_ms = max(minimum, unit * round(1000 / frames_per_second / unit))
    first, *rest = map(Image.fromarray, frames)
    first.save(path, save_all=True, append_images=rest, duration=duration_ms, loop=0, **options)


def _write_mp4(
    path: Path, frames: Iterable[np.ndarray], frames_per_second: float, **options: Any
) -> None:
    encoder = importlib.import_module(ENCODER)
    writer = None
    for frame in frames:
        if writer is None:
            rows, columns = frame.shape[:2]
            options = {"quality": 8, "macro_block_size": 2} | options
            writer = encoder.write_frames(
                str(path), (columns, rows), fps=frames_per_second, **options
            )
            writer.send(None)  # starts the encoder
        writer.send(np.ascontiguousarray(frame))
    if writer is not None:
        writer.close()


# Adjacent panel pixels belong to different directions, so colours at half resolution (4:2:0), as
# usual in videos, would mix them: 4:4:4. Rate factor 0 is lossless, so that only the rounding of
# YCbCr changes a code. Colours are converted to BT.709, which players assume, and marked so.
_PANEL_VIDEO = {
    "codec": "libx264",
    "pix_fmt_out": "yuv444p",
    "quality": None,
    "macro_block_size": 1,
    "output_params": [
        *("-crf", "0", "-vf", "scale=out_color_matrix=bt709:out_range=tv"),
        *("-colorspace", "bt709", "-color_primaries", "bt709", "-color_range", "tv"),
        *("-color_trc", "iec61966-2-1", "-movflags", "+faststart"),
    ],
}


def write_panel_video(path: Path, frames: Iterable[np.ndarray], frames_per_second: float) -> None:
    """Write EIAs, (rows, columns, 3) uint8 sRGB, as an MP4 for a panel: H.264 in 4:4:4."""
    with file_errors(path):
        _write_mp4(path, frames, frames_per_second, **_PANEL_VIDEO)
