"""A quilt, from an EIA or a scene to one file: views from all across the viewing zone.

Each view shows the lens array as a window, undistorted and as large as fits into the tile; what the
tile has beside it is black.
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
from inim.pipeline.stages.reconstruct import Optics
from inim.pipeline.stages.scene import Renderer
from inim.process.observer import Observer
from inim.views.frames import TracedScene, frames
from inim.worker.output import hidden_folder, publish_file
from inim.worker.supervisor import run_in_worker

_MOST_VIEWS = 1000
_MOST_PIXELS = 2**28
_MOST_SAMPLES = 2**16


@dataclass(frozen=True)
class QuiltRequest:
    """What the user asked for.

    Attributes
    ----------
    out : Path
        See `inim.files.light_field.quilt_path`.
    source : Path, or TracedScene
        An EIA to be seen through the lens array, or the scene itself.
    design, mounted : Display
        As designed, and as its array really lies.
    lens_model : str
    distance_mm : float, optional
        Of the eyes; see `inim.display.viewpoint.zone_eyes`.
    columns, rows : int
        Of views.
    width, height : int
        Of a view, in pixels.
    aspect : float
        Width of a view over its height, as seen.
    spp : int
        Samples per pixel of a view.
    """

    out: Path
    source: Path | TracedScene
    design: Display
    mounted: Display
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
        """Of the quilt."""
        return quilt_path(self.out, self.columns, self.rows, self.aspect)

    @property
    def eyes(self) -> list[Viewpoint]:
        """From left to right."""
        return zone_eyes(self.design, self.columns * self.rows, self.distance_mm)

    @property
    def window(self) -> tuple[int, int]:
        """Rows and columns of a view that the array takes."""
        wider = self.design.width_mm / self.design.height_mm / self.aspect
        if wider >= 1:
            return max(1, round(self.height / wider)), self.width
        return self.height, max(1, round(self.width * wider))


def make_quilt(request: QuiltRequest, *, quiet: bool = True, debug: bool = False) -> Path:
    """Render a quilt in a worker process.

    Returns
    -------
    Path
        What was written.

    Raises
    ------
    InimError
        Of the kind that fits; mistakes are found out before anything is rendered.
    """
    run_in_worker(
        "inim.views.quilt:work",
        lambda: check_quilt(request),
        hidden_folder(request.path),
        about=str(request.path),
        quiet=quiet,
        debug=debug,
    )
    return request.path


def check_quilt(request: QuiltRequest) -> QuiltRequest:
    """The request, once all that can go wrong without rendering is checked."""
    views = request.columns * request.rows
    pixels = views * request.width * request.height
    if not 1 <= views <= _MOST_VIEWS:
        raise UsageError(f"--tiles: {views} views; a quilt has 1 to {_MOST_VIEWS}")
    if not 1 <= pixels <= _MOST_PIXELS:
        raise UsageError(f"--view-size: {pixels} pixels in all; a quilt has up to {_MOST_PIXELS}")
    if not 0.01 <= request.aspect <= 100:
        raise UsageError(f"--aspect {request.aspect:g}: width over height, such as 0.75")
    if not 1 <= request.spp <= _MOST_SAMPLES:
        raise UsageError(f"--spp {request.spp}: must lie in 1..{_MOST_SAMPLES}")
    if request.path.is_dir():
        raise FileError(f"{request.path}: is a folder; name a file with --quilt")
    assert request.eyes
    if isinstance(request.source, TracedScene):
        request.source.file()
    else:
        try:
            check_lens_model(request.lens_model, request.mounted)
        except InimError as error:
            raise FileError(f"{request.source}: {error}") from None
        read_eia(request.source, request.mounted)
    return request


def work(request: QuiltRequest, staging: Path, observer: Observer) -> bool:
    """The worker's side: look from every place, write the quilt, put it where it belongs."""
    observer.stage("start")
    rows, columns = request.window
    per_lens = rows / request.design.lens_rows, columns / request.design.lens_columns
    optics = Optics(request.mounted, request.lens_model, per_lens, 2 * request.spp, seed=0)
    source = request.source
    shown = read_eia(source, request.mounted)[0] if isinstance(source, Path) else source
    observer.begin([*["quilt"] * len(request.eyes), "write"])
    renderer = Renderer("auto", observer)
    top, left = (request.height - rows) // 2, (request.width - columns) // 2
    views = np.zeros((len(request.eyes), request.height, request.width, 3), np.uint8)
    frame_of_each = frames(shown, request.eyes, optics, request.design, renderer, "quilt")
    for tile, frame in zip(views, frame_of_each, strict=True):
        tile[top : top + rows, left : left + columns] = frame
    observer.stage("write")
    made = staging / request.path.name
    write_quilt(made, views, request.columns, request.rows)
    publish_file(made, request.path)
    return True
