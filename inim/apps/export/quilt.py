"""Quilt of an EIA or a scene: views from positions across the viewing zone in one image.

Each view shows the lens array as a window, undistorted and as large as fits into the tile; the rest
of the tile is black.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from inim.apps.export.tiles import check_aspect
from inim.display import Display, Viewpoint
from inim.display.lens import check_lens_model
from inim.display.pixels import exact_ratio
from inim.display.settings import Placement
from inim.display.viewpoint import zone_eyes
from inim.image.color import to_srgb
from inim.image.files.eia_file import read_eia
from inim.image.files.light_field import quilt_path, write_quilt
from inim.pipeline.stages.ground_truth import render_view
from inim.pipeline.stages.reconstruction import DisplayedEIA, Optics
from inim.pipeline.stages.scene import Renderer, Scene
from inim.pipeline.stages.stage import Run
from inim.render.scene_files.file import SceneFile, read_scene_file
from inim.report import Report
from inim.system.errors import FileError, InimError, UsageError
from inim.system.process.atomic_file import file_errors
from inim.system.process.observer import Observer
from inim.system.worker.output import hidden_folder
from inim.system.worker.supervisor import run_in_worker

_MAX_VIEWS = 1000
_MAX_PIXELS = 2**28
_MAX_SAMPLES = 2**16
#: Stage of each view in the progress bar.
_VIEW = "quilt"


@dataclass(frozen=True)
class TracedScene:
    """The scene of a report, to be traced again.

    `report` is the report's folder, for messages, and `sha256` the scene's digest in it.
    `definitions` are the settings and scene parameters that the report's run overrode,
    `allow_folders` additional folders for files that the scene references, and `placement` is the
    part of the scene that the report shows.
    """

    report: Path
    path: Path
    sha256: str
    definitions: Mapping[str, str]
    allow_folders: tuple[Path, ...]
    placement: Placement

    @classmethod
    def of(
        cls, report: Report, path: Path | None = None, allow_folders: Sequence[Path] = ()
    ) -> TracedScene:
        """The scene of a report with the run's definitions; `path` is its new path if it moved."""
        scene = report.data.scene
        if scene is None:
            raise UsageError(
                f"{report.folder}: is of a picture, which has no ground truth; name an algorithm "
                "with --algorithms"
            )
        return cls(
            report.folder,
            path or Path(scene.path),
            scene.sha256,
            scene.definitions,
            tuple(allow_folders),
            report.data.settings.placement,
        )

    def file(self) -> SceneFile:
        """Read and scan the scene file; raises `InimError` if it is missing or has changed."""
        try:
            file = read_scene_file(self.path, self.definitions, self.allow_folders)
        except UsageError as error:
            raise UsageError(f"{self.report}: the settings of its scene: {error}") from None
        if file.sha256 != self.sha256:
            raise FileError(
                f"{self.path}: differs from the report's scene, or a file that it references has "
                "changed; validate it again, or give the scene with --scene"
            )
        return file


@dataclass(frozen=True, kw_only=True)
class QuiltRequest:
    """Request to render a quilt of an EIA, seen through the lens array, or of a scene.

    There are `columns` x `rows` views of `width` x `height` pixels; `aspect` is the displayed width
    of a view over its height. `distance_mm` is the viewing distance of
    `inim.display.viewpoint.zone_eyes`. `label` is the EIA's or the report's path, for messages.
    `design` is the display without its misalignment, and `spp` are the samples per pixel.
    """

    out: Path
    source: Path | TracedScene
    label: Path
    design: Display
    misaligned_display: Display
    lens_model: str
    spp: int
    distance_mm: float | None
    columns: int
    rows: int
    width: int
    height: int
    aspect: float

    @property
    def eyes(self) -> list[Viewpoint]:
        """Viewpoints from left to right."""
        return zone_eyes(self.design, self.columns * self.rows, self.distance_mm)

    @property
    def file(self) -> Path:
        """Path of the quilt, after `out`."""
        return quilt_path(self.out, self.columns, self.rows, self.aspect)

    @property
    def window(self) -> tuple[int, int]:
        """Rows and columns of the lens array within a view."""
        wider = self.design.width_mm / self.design.height_mm / self.aspect
        if wider >= 1:
            return max(1, round(exact_ratio(self.height / wider))), self.width
        return self.height, max(1, round(exact_ratio(self.width * wider)))

    def check(self) -> None:
        """Raise an `InimError` for mistakes that can be detected without rendering."""
        count = self.columns * self.rows
        pixels = count * self.width * self.height
        if not 1 <= count <= _MAX_VIEWS:
            raise UsageError(f"--tiles: {count} views; a quilt has 1 to {_MAX_VIEWS}")
        if not 1 <= pixels <= _MAX_PIXELS:
            raise UsageError(
                f"--view-size: {pixels} pixels in all; a quilt has up to {_MAX_PIXELS}"
            )
        check_aspect(self.aspect)
        assert self.file and self.eyes  # raise for invalid ones
        if self.out.is_dir():
            raise FileError(f"{self.out}: is a folder; give the path of a file")
        if not 1 <= self.spp <= _MAX_SAMPLES:
            raise UsageError(f"--view-spp {self.spp}: must be in 1..{_MAX_SAMPLES}")
        try:
            check_lens_model(self.lens_model, self.misaligned_display)
        except InimError as error:
            raise FileError(f"{self.label}: {error}") from None
        if isinstance(self.source, TracedScene):
            self.source.file()
        else:
            read_eia(self.source, self.misaligned_display)

    def checked(self) -> QuiltRequest:
        """Return the request after `check`."""
        self.check()
        return self


def render_quilt(request: QuiltRequest, *, quiet: bool = True, debug: bool = False) -> None:
    """Check a request, render its views in a worker process and write its file."""
    run_in_worker(
        f"{__name__}:run_job",
        request.checked,
        hidden_folder(request.file),
        about=str(request.file),
        quiet=quiet,
        debug=debug,
    )


def run_job(request: QuiltRequest, staging: Path, observer: Observer) -> bool:
    """Entry point in the worker: render all views, write the quilt and publish it."""
    observer.stage("start")
    eyes, (rows, columns) = request.eyes, request.window
    observer.begin([*[_VIEW] * len(eyes), "write"])
    top, left = (request.height - rows) // 2, (request.width - columns) // 2
    tiles = np.zeros((len(eyes), request.height, request.width, 3), np.uint8)
    for tile, view in zip(tiles, _views(request, eyes, observer), strict=True):
        tile[top : top + rows, left : left + columns] = to_srgb(view)
    observer.stage("write")
    quilt = staging / request.file.name
    write_quilt(quilt, tiles, request.columns, request.rows)
    with file_errors(request.file):
        quilt.replace(request.file)
    return True


def _views(
    request: QuiltRequest, eyes: Sequence[Viewpoint], observer: Observer
) -> Iterator[np.ndarray]:
    """Render the views of the source, linear RGB: (rows, columns, 3)."""
    source, display = request.source, request.misaligned_display
    (rows, columns), (down, across) = request.window, request.design.layout.grid
    pixels_per_lens = (rows / down, columns / across)
    # Views are half images.
    optics = Optics(display, request.lens_model, pixels_per_lens, 2 * request.spp)
    renderer = Renderer("auto", observer)
    if isinstance(source, TracedScene):
        scene = Scene(source.file(), request.design, source.placement, renderer)
        for eye in eyes:
            observer.stage(_VIEW)
            yield render_view(scene, eye, pixels_per_lens, (request.spp,), 0, run=Run())[0].image
    else:
        eia = DisplayedEIA(read_eia(source, display)[0], None, optics, renderer)
        for eye in eyes:
            observer.stage(_VIEW)
            yield eia.view(eye, half=0)
