"""EIA of a scene: its RGB-D picture is captured in a worker process."""

import json
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from inim.display import Display
from inim.display.settings import Settings
from inim.generators.registry import Input
from inim.image.files.eia_file import shows_holes
from inim.image.files.image import read_rgbd, write_rgbd
from inim.image.rgbd import RGBD
from inim.pipeline.stages.capture import DepthCamera, capture_nonempty
from inim.pipeline.stages.generation import GeneratorHandle, GeneratorRun
from inim.pipeline.stages.scene import Renderer, Scene
from inim.pipeline.stages.stage import Run
from inim.render.scene_files.file import SceneFile, choose_display, read_scene_file
from inim.system.errors import naming
from inim.system.process.observer import Observer
from inim.system.worker.supervisor import run_in_worker

_PICTURE, _NOTES = "rgbd.exr", "notes.json"


@dataclass(frozen=True)
class CaptureRequest:
    """Request to capture a scene for a display; `input` is that of the generator."""

    file: SceneFile
    display: Display
    settings: Settings
    input: Input


class SceneNotes(NamedTuple):
    """Lines on the files of a scene, and warnings."""

    imports: Sequence[str]
    warnings: Sequence[str]


def generate_from_scene(
    path: Path,
    display: Display | str | Path | None,
    definitions: Mapping[str, Any],
    algorithm: str,
    *,
    debug: bool = False,
) -> tuple[RGBD, Display, GeneratorRun, SceneNotes]:
    """Capture a scene with the settings in its file and generate its EIA.

    * `display`, `definitions`: see `inim.render.scene_files.file.choose_display`.

    Also returns the picture, the display as designed, and what was read. The generator's kernels
    are loaded or compiled while the worker renders.

    Raises `InimError`: an unreadable scene, impossible settings, or no usable backend.
    """
    file = read_scene_file(path, definitions)
    design, settings = choose_display(display, definitions, str(path), file)
    per_pitch = settings.capture_pixels_per_pitch
    shape, pixel_mm = design.capture_shape(per_pitch), design.capture_pixel_mm(per_pitch)
    generator = GeneratorHandle(algorithm, design, shape, pixel_mm)
    place = Path(tempfile.gettempdir())
    from inim.system.process.locked_folder import locked_folder  # POSIX only, as the renderer

    with naming(path):
        with locked_folder(place, "inim-capture-") as folder, ThreadPoolExecutor(1) as thread:

            def make_request() -> CaptureRequest:
                _ = generator.generator  # checks the algorithm's options
                if generator.algorithm.own:
                    thread.submit(generator.run, _dot(design, shape, pixel_mm))
                return CaptureRequest(file, design, settings, generator.algorithm.input)

            job = f"{__name__}:run_job"
            run_in_worker(job, make_request, nullcontext(folder), about=str(path), debug=debug)
            rgbd = read_rgbd(folder / _PICTURE)
            notes = SceneNotes(**json.loads((folder / _NOTES).read_text("utf-8")))
        # The thread has ended: a generator's buffers hold one picture at a time.
        return rgbd, design, generator.run(rgbd, holes=shows_holes(design)), notes


def _dot(display: Display, shape: tuple[int, int], pixel_mm: float) -> RGBD:
    """Picture with a single covered pixel, in the middle of the display."""
    color, covered = np.ones((*shape, 3), np.float32), np.zeros(shape, bool)
    covered[shape[0] // 2, shape[1] // 2] = True
    depth = np.full(shape, sum(display.depth_range_mm) / 2, np.float32)
    return RGBD(color, depth, covered, pixel_mm)


def run_job(request: CaptureRequest, staging: Path, observer: Observer) -> bool:
    """Entry point in the worker: capture the scene and write the picture."""
    observer.begin(["start", "open scene", "capture RGB-D"])
    settings = request.settings
    renderer = Renderer("auto", observer)
    scene = Scene(request.file, request.display, settings.placement, renderer)
    spp = settings.with_samples(request.display).capture_spp
    assert spp is not None
    camera = DepthCamera(scene, settings.capture_pixels_per_pitch, (spp,), settings.seed)
    capture = capture_nonempty(camera, {request.input}, run=Run(observer=observer))
    write_rgbd(staging / _PICTURE, capture.inputs[request.input].rgbd)
    notes = {"imports": scene.fitted.imports, "warnings": scene.fitted.warnings}
    (staging / _NOTES).write_text(json.dumps(notes), "utf-8")
    return True
