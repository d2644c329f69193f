"""Views for people to look at, as films and quilts hold them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from inim.display import Display, Viewpoint
from inim.errors import FileError
from inim.image.color import srgb_codes
from inim.pipeline.stages.ground_truth import render_view
from inim.pipeline.stages.reconstruct import DisplayedEIA, Optics
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
    """Views of an EIA through the lenses or of the scene itself, (rows, columns, 3) uint8 sRGB.

    Parameters
    ----------
    source : (rows, columns, 3) float32, or TracedScene
        An EIA in linear RGB, or the scene.
    eyes : iterable of Viewpoint
    optics : Optics
        A frame has half of its samples: one of its two halves of an EIA's view.
    design : Display
        As designed: the scene is fitted into its depth range.
    renderer : Renderer
    stage : str
        Name of the stage of each frame, for the progress bar.
    """
    if isinstance(source, TracedScene):
        scene = Scene(source.file(), design, source.fit_share, renderer)
    else:
        shown = DisplayedEIA(source, None, optics, renderer)
    for eye in eyes:
        renderer.observer.stage(stage)
        if isinstance(source, TracedScene):
            sampling = (optics.view_pixels_per_lens, optics.half_spp, 0)
            view = render_view(scene, eye, *sampling, run=Run())[0].image
        else:
            view = shown.view(eye, half=0)
        yield srgb_codes(view)


@dataclass(frozen=True)
class TracedScene:
    """The scene of a report, to be traced again.

    Attributes
    ----------
    path : Path
    sha256 : str
        That the report has of it.
    definitions : dict of str to str
        Settings and scene parameters that the report's run overrode.
    allow_folders : tuple of Path
        Where files that it names may lie, too.
    fit_share : float
        Share of the array that the relic fills.
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
        """The scene of a report, with the run's definitions.

        Parameters
        ----------
        report : Report
        path : Path, optional
            Where it is now, if not where the report says.
        allow_folders : sequence of Path
        """
        scene = report.data.scene
        return cls(
            path or Path(scene.path),
            scene.sha256,
            scene.definitions,
            tuple(allow_folders),
            report.data.settings.fit_share,
        )

    def file(self) -> SceneFile:
        """The scene file, scanned.

        Raises
        ------
        InimError
            It cannot be read, or is no longer what the report was made of.
        """
        file = read_scene_file(self.path, self.definitions, self.allow_folders)
        if file.sha256 != self.sha256:
            raise FileError(
                f"{self.path}: is not what the report was made of: another scene, or it or a file "
                "that it names has changed; validate it anew, or name the scene with --scene"
            )
        return file
