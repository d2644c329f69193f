"""Frames of films and quilts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from inim.display import Display, Viewpoint
from inim.errors import FileError
from inim.image.color import srgb_codes
from inim.pipeline.stages.ground_truth import render_view
from inim.pipeline.stages.reconstruction import DisplayedEIA, Optics
from inim.pipeline.stages.scene import Renderer, Scene
from inim.pipeline.stages.stage import Run
from inim.report import Report
from inim.scene.file import SceneFile, read_scene_file


def frames(
    source: np.ndarray | TracedScene,
    eyes: Iterable[Viewpoint],
    optics: Optics,
    design: Display,
    renderer: Renderer,
    stage: str,
) -> Iterator[np.ndarray]:
    """Render views of an EIA through the lenses, or of the scene, (rows, columns, 3) uint8 sRGB.

    An EIA is (rows, columns, 3) float32, linear RGB. A frame has half of the samples of `optics`,
    as a half image of a view. A scene is fitted into the depth range of `design`. `stage` names
    each frame in the progress bar.
    """
    if isinstance(source, TracedScene):
        scene = Scene(source.file(), design, source.fit_share, renderer)
    else:
        eia_on_display = DisplayedEIA(source, None, optics, renderer)
    for eye in eyes:
        renderer.observer.stage(stage)
        if isinstance(source, TracedScene):
            sampling = (optics.view_pixels_per_lens, optics.half_spp, 0)
            view = render_view(scene, eye, *sampling, run=Run())[0].image
        else:
            view = eia_on_display.view(eye, half=0)
        yield srgb_codes(view)


@dataclass(frozen=True)
class TracedScene:
    """The scene of a report, to be traced again.

    `sha256` is its digest in the report, `definitions` are the settings and scene parameters that
    the report's run overrode, `allow_folders` additional folders for files that the scene
    references, and `fit_share` is the share of the lens array that the relic fills.
    """

    path: Path
    sha256: str
    definitions: Mapping[str, str]
    allow_folders: tuple[Path, ...]
    fit_share: float

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
