"""Quilt of an EIA or a scene: views from positions across the viewing zone in one image.

Each view shows the lens array as a window, undistorted and as large as fits into the tile; the rest
of the tile is black.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from inim.display import Display, Viewpoint
from inim.display.viewpoint import zone_eyes
from inim.errors import FileError, InimError, UsageError
from inim.files.eia_file import read_eia
from inim.files.light_field import quilt_path, write_quilt
from inim.lens import check_lens_model
from inim.pipeline.stages.reconstruction import Optics
from inim.pipeline.stages.scene import Renderer
from inim.process.observer import Observer
from inim.views.frames import TracedScene, frames
from inim.worker.output import hidden_folder, publish_file
from inim.worker.supervisor import run_in_worker

_MAX_VIEWS = 1000
_MAX_PIXELS = 2**28
_MAX_SAMPLES = 2**16


@dataclass(frozen=True)
class QuiltRequest:
    """Request to render a quilt of an EIA, through the lens array, or of the scene itself.

    `out` becomes the path of `inim.files.light_field.quilt_path`. `design` is the display without
    its misalignment, `distance_mm` the viewing distance of `inim.display.viewpoint.zone_eyes`.
    There are `columns` x `rows` views of `width` x `height` pixels, with `spp` samples per pixel;
    `aspect` is the displayed width of a view over its height.
    """

    out: Path
    source: Path | TracedScene
    design: Display
    misaligned_display: Display
    lens_model: str
    distance_mm: float | None
    columns: int
    rows: int
    width: int
    height: int
    aspect: float
    spp: int

    @property
    def path(self) -> Path:
        """Path of the quilt."""
        return quilt_path(self.out, self.columns, self.rows, self.aspect)

    @property
    def eyes(self) -> list[Viewpoint]:
        """Viewpoints from left to right."""
        return zone_eyes(self.design, self.columns * self.rows, self.distance_mm)

    @property
    def window(self) -> tuple[int, int]:
        """Rows and columns of the lens array within a view."""
        wider = self.design.width_mm / self.design.height_mm / self.aspect
        if wider >= 1:
            return max(1, round(self.height / wider)), self.width
        return self.height, max(1, round(self.width * wider))


def make_quilt(request: QuiltRequest, *, quiet: bool = True, debug: bool = False) -> Path:
    """Render a quilt in a worker process, after checking the request, and return its path."""
    run_in_worker(
        "inim.views.quilt:run_job",
        lambda: check_quilt(request),
        hidden_folder(request.path),
        about=str(request.path),
        quiet=quiet,
        debug=debug,
    )
    return request.path


def check_quilt(request: QuiltRequest) -> QuiltRequest:
    """Return the request after all checks that need no rendering."""
    views = request.columns * request.rows
    pixels = views * request.width * request.height
    if not 1 <= views <= _MAX_VIEWS:
        raise UsageError(f"--tiles: {views} views; a quilt has 1 to {_MAX_VIEWS}")
    if not 1 <= pixels <= _MAX_PIXELS:
        raise UsageError(f"--view-size: {pixels} pixels in all; a quilt has up to {_MAX_PIXELS}")
    if not 0.01 <= request.aspect <= 100:
        raise UsageError(f"--aspect {request.aspect:g}: must be width over height, such as 0.75")
    if not 1 <= request.spp <= _MAX_SAMPLES:
        raise UsageError(f"--view-spp {request.spp}: must be in 1..{_MAX_SAMPLES}")
    if request.path.is_dir():
        raise FileError(f"{request.path}: is a folder; give the path of a file with --quilt")
    assert request.eyes
    if isinstance(request.source, TracedScene):
        request.source.file()
    else:
        try:
            check_lens_model(request.lens_model, request.misaligned_display)
        except InimError as error:
            raise FileError(f"{request.source}: {error}") from None
        read_eia(request.source, request.misaligned_display)
    return request


def run_job(request: QuiltRequest, staging: Path, observer: Observer) -> bool:
    """Entry point in the worker: render all views, write the quilt and publish it."""
    observer.stage("start")
    rows, columns = request.window
    per_lens = rows / request.design.lens_rows, columns / request.design.lens_columns
    optics = Optics(
        request.misaligned_display, request.lens_model, per_lens, 2 * request.spp, seed=0
    )
    source = request.source
    if isinstance(source, Path):
        content: np.ndarray | TracedScene = read_eia(source, request.misaligned_display)[0]
    else:
        content = source
    observer.begin([*["quilt"] * len(request.eyes), "write"])
    renderer = Renderer("auto", observer)
    top, left = (request.height - rows) // 2, (request.width - columns) // 2
    views = np.zeros((len(request.eyes), request.height, request.width, 3), np.uint8)
    view_frames = frames(content, request.eyes, optics, request.design, renderer, "quilt")
    for tile, frame in zip(views, view_frames, strict=True):
        tile[top : top + rows, left : left + columns] = frame
    observer.stage("write")
    quilt = staging / request.path.name
    write_quilt(quilt, views, request.columns, request.rows)
    publish_file(quilt, request.path)
    return True
