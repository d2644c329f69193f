"""A quilt, from an EIA or a scene to one file: views from all across the viewing zone.

Each view shows the lens array as a window, undistorted and as large as fits into the tile; what the
tile has beside it is black.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from inim.display import Display, Viewpoint
from inim.display.viewpoint import zone_eyes
from inim.errors import FileError, UsageError
from inim.files.eia_file import read_eia
from inim.files.light_field import quilt_path, write_quilt
from inim.image.color import srgb_codes
from inim.lens import check_lens_model
from inim.pipeline.stages.reconstruct import Optics, ShownEIA
from inim.pipeline.stages.scene import Renderer, Scene, seed_of
from inim.process.forecast import Step
from inim.process.observer import Observer
from inim.views.traced_scene import TracedScene
from inim.worker.output import open_beside, publish_file
from inim.worker.supervisor import run_in_worker

# Of a ray, through thick lenses or into a scene, and of writing the tiles: the bar moves by them.
_RAY_S, _WRITE_S = 2e-8, 1.0
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
        request,
        lambda: open_beside(request.path),
        check=lambda: check_quilt(request),
        about=str(request.path),
        quiet=quiet,
        debug=debug,
    )
    return request.path


def check_quilt(request: QuiltRequest) -> None:
    """Raise what can go wrong without rendering."""
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
        check_lens_model(request.lens_model, request.mounted)
        read_eia(request.source, request.mounted)


def work(request: QuiltRequest, staging: Path, observer: Observer) -> bool:
    """The worker's side: look from every place, write the quilt, put it where it belongs."""
    observer.stage("start")
    rows, columns = request.window
    eyes, view = request.eyes, _viewer(request, observer)
    rays = rows * columns * request.spp * len(eyes)
    observer.begin([Step("quilt", rays * _RAY_S, rays), Step("write", _WRITE_S)])
    observer.stage("quilt")
    top, left = (request.height - rows) // 2, (request.width - columns) // 2
    views = np.zeros((len(eyes), request.height, request.width, 3), np.uint8)
    for tile, eye in zip(views, eyes, strict=True):
        tile[top : top + rows, left : left + columns] = srgb_codes(view(eye))
    observer.stage("write")
    made = staging / request.path.name
    write_quilt(made, views, request.columns, request.rows)
    publish_file(made, request.path)
    return True


def _viewer(request: QuiltRequest, observer: Observer) -> Callable[[Viewpoint], np.ndarray]:
    """What shows the window from an eye, (rows, columns, 3) float32 linear RGB."""
    renderer, source, spp = Renderer("auto", observer), request.source, request.spp
    rows, columns = request.window
    per_lens = rows / request.design.lens_rows, columns / request.design.lens_columns
    if isinstance(source, Path):
        # A view is one half of what the optics say.
        optics = Optics(request.mounted, request.lens_model, per_lens, 2 * spp, seed=0)
        shown = ShownEIA(read_eia(source, request.mounted)[0], None, optics, renderer)
        return lambda eye: shown.view(eye, half=0)
    scene = Scene(source.file(), request.design, source.fit_share, renderer)
    fitted, seed = scene.fitted, seed_of("views", 0)
    from inim.render.ground_truth import true_view

    def view(eye: Viewpoint) -> np.ndarray:
        sampled = {"pixels_per_lens": per_lens, "spp": spp, "seed": seed, **scene.effort}
        return true_view(fitted, request.design, eye, **sampled)[0].image

    return view
