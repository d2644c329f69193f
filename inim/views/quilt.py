"""Quilt of an EIA or a scene: views from positions across the viewing zone in one image.

Each view shows the lens array as a window, undistorted and as large as fits into the tile; the rest
of the tile is black.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from inim.display import Viewpoint
from inim.display.viewpoint import zone_eyes
from inim.errors import UsageError
from inim.files.light_field import quilt_path, write_quilt
from inim.process.observer import Observer
from inim.views.frames import ViewsRequest, views
from inim.worker.output import publish_file

_MAX_VIEWS = 1000
_MAX_PIXELS = 2**28


@dataclass(frozen=True, kw_only=True)
class QuiltRequest(ViewsRequest):
    """Request to render a quilt of one source.

    There are `columns` x `rows` views of `width` x `height` pixels; `aspect` is the displayed width
    of a view over its height. `distance_mm` is the viewing distance of
    `inim.display.viewpoint.zone_eyes`.
    """

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
            return max(1, round(self.height / wider)), self.width
        return self.height, max(1, round(self.width * wider))

    def check(self) -> None:
        """See `ViewsRequest`."""
        count = self.columns * self.rows
        pixels = count * self.width * self.height
        if not 1 <= count <= _MAX_VIEWS:
            raise UsageError(f"--tiles: {count} views; a quilt has 1 to {_MAX_VIEWS}")
        if not 1 <= pixels <= _MAX_PIXELS:
            raise UsageError(
                f"--view-size: {pixels} pixels in all; a quilt has up to {_MAX_PIXELS}"
            )
        if not 0.01 <= self.aspect <= 100:
            raise UsageError(f"--aspect {self.aspect:g}: must be width over height, such as 0.75")
        assert self.file and self.eyes  # raise for invalid ones
        super().check()


def run_job(request: QuiltRequest, staging: Path, observer: Observer) -> bool:
    """Entry point in the worker: render all views, write the quilt and publish it."""
    observer.stage("start")
    eyes, (rows, columns) = request.eyes, request.window
    observer.begin([*[*request.sources] * len(eyes), "write"])
    down, across = request.design.layout.grid
    optics = request.optics((rows / down, columns / across))
    top, left = (request.height - rows) // 2, (request.width - columns) // 2
    tiles = np.zeros((len(eyes), request.height, request.width, 3), np.uint8)
    for _, source_views in views(request, optics, eyes, observer):
        for tile, view in zip(tiles, source_views, strict=True):
            tile[top : top + rows, left : left + columns] = view
    observer.stage("write")
    quilt = staging / request.file.name
    write_quilt(quilt, tiles, request.columns, request.rows)
    publish_file(quilt, request.file)
    return True
