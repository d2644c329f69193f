"""Views of EIAs and scenes as frames of films and tiles of quilts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from inim.display import Display, Viewpoint
from inim.errors import FileError, InimError, UsageError
from inim.files.eia_file import read_eia
from inim.image.color import to_srgb
from inim.lens import check_lens_model
from inim.pipeline.stages.ground_truth import render_view
from inim.pipeline.stages.reconstruction import DisplayedEIA, Optics
from inim.pipeline.stages.scene import Renderer, Scene
from inim.pipeline.stages.stage import Run
from inim.process.observer import Observer
from inim.report import Report
from inim.scene.file import SceneFile, read_scene_file
from inim.worker.output import hidden_folder
from inim.worker.supervisor import run_in_worker

_MAX_SAMPLES = 2**16


@dataclass(frozen=True)
class TracedScene:
    """The scene of a report, to be traced again.

    `sha256` is its digest in the report, `definitions` are the settings and scene parameters that
    the report's run overrode, `allow_folders` additional folders for files that the scene
    references, `fit_share` is the share of the lens array that the relic fills, and `turn_deg` its
    turn.
    """

    path: Path
    sha256: str
    definitions: Mapping[str, str]
    allow_folders: tuple[Path, ...]
    fit_share: float
    turn_deg: float | None

    @classmethod
    def of(
        cls, report: Report, path: Path | None = None, allow_folders: Sequence[Path] = ()
    ) -> TracedScene:
        """The scene of a report with the run's definitions; `path` is its new path if it moved."""
        scene = report.data.scene
        return cls(
            path or Path(scene.path),
            scene.sha256,
            scene.definitions,
            tuple(allow_folders),
            report.data.settings.fit_share,
            report.data.settings.turn_deg,
        )

    def file(self) -> SceneFile:
        """Read and scan the scene file; raises `InimError` if it is missing or has changed."""
        file = read_scene_file(self.path, self.definitions, self.allow_folders)
        if file.sha256 != self.sha256:
            raise FileError(
                f"{self.path}: differs from the report's scene, or a file that it references has "
                "changed; validate it again, or give the scene with --scene"
            )
        return file


#: An EIA, an EIA for each view, or a scene.
Source = Path | tuple[Path, ...] | TracedScene


@dataclass(frozen=True, kw_only=True)
class ViewsRequest:
    """Request to render views into a file.

    `sources` are EIAs to show through the lens array, and scenes, by name; `label` is their report
    or file, for messages. `design` is the display without its misalignment, and `spp` are the
    samples per pixel.
    """

    out: Path
    sources: Mapping[str, Source]
    label: Path
    design: Display
    misaligned_display: Display
    lens_model: str
    spp: int

    def check(self) -> None:
        """Raise an `InimError` for mistakes that can be detected without rendering."""
        if self.out.is_dir():
            raise FileError(f"{self.out}: is a folder; give the path of a file")
        if not 1 <= self.spp <= _MAX_SAMPLES:
            raise UsageError(f"--view-spp {self.spp}: must be in 1..{_MAX_SAMPLES}")
        try:
            check_lens_model(self.lens_model, self.misaligned_display)
        except InimError as error:
            raise FileError(f"{self.label}: {error}") from None
        for source in self.sources.values():
            if isinstance(source, TracedScene):
                source.file()
            else:  # of many EIAs, the others are checked when they are shown
                eia = source[0] if isinstance(source, tuple) else source
                read_eia(eia, self.misaligned_display)

    @property
    def file(self) -> Path:
        """Path of the file to write."""
        return self.out

    def checked(self) -> ViewsRequest:
        """Return the request after `check`."""
        self.check()
        return self

    def optics(self, pixels_per_lens: int | tuple[float, float]) -> Optics:
        """Optics of the views, which are half images."""
        display, spp = self.misaligned_display, 2 * self.spp
        return Optics(display, self.lens_model, pixels_per_lens, spp, seed=0)


def render_in_worker(request: ViewsRequest, *, quiet: bool = True, debug: bool = False) -> None:
    """Check a request, render its views in a worker process and write its file."""
    run_in_worker(
        f"{type(request).__module__}:run_job",
        request.checked,
        hidden_folder(request.file),
        about=str(request.file),
        quiet=quiet,
        debug=debug,
    )


def views(
    request: ViewsRequest, optics: Optics, eyes: Sequence[Viewpoint], observer: Observer
) -> Iterator[tuple[str, Iterator[np.ndarray]]]:
    """Render the views of each source, by its name: (rows, columns, 3) uint8 sRGB.

    The name is also the stage of each view in the progress bar.
    """
    renderer = Renderer("auto", observer)
    for name, source in request.sources.items():
        yield name, _views_of(name, source, request.design, optics, eyes, renderer)


def _views_of(
    name: str,
    source: Source,
    design: Display,
    optics: Optics,
    eyes: Sequence[Viewpoint],
    renderer: Renderer,
) -> Iterator[np.ndarray]:
    if isinstance(source, TracedScene):
        scene = Scene(source.file(), design, source.fit_share, renderer, source.turn_deg)
    displayed_path, eia_on_display = None, None
    for number, eye in enumerate(eyes):
        renderer.observer.stage(name)
        if isinstance(source, TracedScene):
            sampling = (optics.view_pixels_per_lens, optics.half_spp, 0)
            view = render_view(scene, eye, *sampling, run=Run())[0].image
        else:
            path = source[number] if isinstance(source, tuple) else source
            if eia_on_display is None or path != displayed_path:
                eia, displayed_path = read_eia(path, optics.display)[0], path
                eia_on_display = DisplayedEIA(eia, None, optics, renderer)
            view = eia_on_display.view(eye, half=0)
        yield to_srgb(view)
