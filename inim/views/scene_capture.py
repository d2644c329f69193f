"""RGB-D picture of a scene, captured in a worker process for a generator."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from inim.display import Display
from inim.files.image import read_rgbd, write_rgbd
from inim.generators.registry import Input
from inim.image.rgbd import RGBD
from inim.pipeline.stages.capture import DepthCamera, capture_nonempty
from inim.pipeline.stages.scene import Renderer, Scene
from inim.pipeline.stages.stage import Run
from inim.process.observer import Observer
from inim.scene.file import SceneFile, choose_display, read_scene_file
from inim.settings import Settings
from inim.worker.output import hidden_folder, publish_file
from inim.worker.supervisor import run_in_worker


@dataclass(frozen=True)
class CaptureRequest:
    """Request to capture a scene for a display; `input` is that of the generator."""

    out: Path
    file: SceneFile
    display: Display
    settings: Settings
    input: Input

    def checked(self) -> CaptureRequest:
        """Return the request; reading the scene has checked it."""
        return self


def capture_scene(
    path: Path,
    display: Display | str | Path | None,
    definitions: Mapping[str, str],
    input_type: Input,
    *,
    debug: bool = False,
) -> tuple[RGBD, Display]:
    """Capture a scene with the settings in its file; also return the display as designed.

    * `display`, `definitions`: see `inim.scene.file.choose_display`.
    * `input_type`: input of the generator: `RGBD`, or `LayeredRGBD` for all layers.

    Raises `InimError`: an unreadable scene, impossible settings, or no usable backend.
    """
    file = read_scene_file(path, definitions)
    design, settings = choose_display(display, definitions, str(path), file)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "rgbd.exr"
        request = CaptureRequest(out, file, design, settings, input_type)
        run_in_worker(
            f"{__name__}:run_job", request.checked, hidden_folder(out), about=str(path), debug=debug
        )
        return read_rgbd(out), design


def run_job(request: CaptureRequest, staging: Path, observer: Observer) -> bool:
    """Entry point in the worker: capture the scene and write the picture."""
    observer.begin(["start", "open scene", "capture RGB-D"])
    settings = request.settings
    renderer = Renderer("auto", observer)
    scene = Scene(request.file, request.display, settings.fit_share, renderer, settings.turn_deg)
    camera = DepthCamera(
        scene, settings.capture_pixels_per_pitch, settings.capture_spp, settings.seed
    )
    capture = capture_nonempty(camera, {request.input}, run=Run(observer=observer))
    picture = staging / request.out.name
    write_rgbd(picture, capture.inputs[request.input].rgbd)
    publish_file(picture, request.out)
    return True
