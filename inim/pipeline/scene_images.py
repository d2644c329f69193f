"""Images of a scene without a validation: its RGB-D picture, ground-truth EIA and views.

Stages of the pipeline render them in a worker process, with the result cache of `inim.validate`.
"""

import json
import tempfile
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from inim.display import Display, Viewpoint
from inim.display.viewpoint import single_viewpoint
from inim.image.files.image import read_rgbd, write_rgbd
from inim.image.rgbd import RGBD
from inim.pipeline.job import open_cache, setup
from inim.pipeline.launch import path_of, paths_of
from inim.pipeline.plan import Plan, make_plan
from inim.pipeline.request import Request
from inim.pipeline.stages import ground_truth
from inim.pipeline.stages.capture import DepthCamera, capture_nonempty
from inim.pipeline.stages.reconstruction import DisplayViews
from inim.pipeline.stages.scene import describe_scene
from inim.pipeline.stages.stage import Run
from inim.system.errors import UsageError, naming
from inim.system.plugins import PluginModule
from inim.system.process.observer import Observer
from inim.system.worker.supervisor import run_in_worker

#: Function that renders an image of a plan's scene.
Render = Callable[[Plan, DepthCamera, Run], Any]
_PICTURE, _IMAGE, _WARNINGS = "rgbd.exr", "image.npy", "warnings.json"


def capture(scene: str | Path, display: Display | str | Path | None = None, **options: Any) -> RGBD:
    """Render the RGB-D picture of a scene, the input of the algorithms.

    It has the same pixels as in `inim.validate` if samples and seed are equal, which the scene or
    `definitions` state: ``{"inim.capture_spp": 64, "inim.seed": 3}``.

    Parameters
    ----------
    scene : path
        Mitsuba XML with `inim.*` settings.
    display : Display, str or Path, optional
        A display, the name of a preset, or a display file; default: the scene's.
    **options
        `definitions`, `backend`, `allow_folders` and `plugins` of `inim.validate`.

    Raises
    ------
    InimError
        The error of `inim.validate`, or the picture is empty.
    """
    picture: RGBD = _render(_capture, scene, display, **options)
    return picture


def _capture(_: Plan, camera: DepthCamera, run: Run) -> RGBD:
    return capture_nonempty(camera, {RGBD}, run=run).rgbd


def render_eia(
    scene: str | Path, display: Display | str | Path | None = None, **options: Any
) -> np.ndarray:
    """Render the ground-truth EIA of a scene: path traced through every lens centre.

    With equal samples, seed and viewpoints (``"inim.viewpoints"``), panel pixels that a viewpoint
    observes are those of `inim.validate`, which may take fewer samples in the others.

    Parameters
    ----------
    scene, display, **options
        As for `inim.capture`; the lens array is misaligned as `inim.misalign` states.

    Returns
    -------
    (rows, columns, 3) float32, linear RGB.
    """
    eia: np.ndarray = _render(_eia, scene, display, **options)
    return eia


def _eia(plan: Plan, camera: DepthCamera, run: Run) -> np.ndarray:
    # Panel pixels that views observe have random numbers of their own.
    views = DisplayViews(plan.viewpoints, plan.optics, camera.scene.renderer, run=run)
    display, rounds = plan.misaligned_display, (plan.samples["eia_spp"],)
    return ground_truth.render_ground_truth_eia(
        camera.scene, display, rounds, plan.settings.seed, None, views.observed, run=run
    ).image


def render_view(
    scene: str | Path,
    display: Display | str | Path | None = None,
    viewpoint: Viewpoint | str | Sequence[float] = "centre",
    **options: Any,
) -> np.ndarray:
    """Render the ground-truth view of a scene, through the window of the lens array.

    Parameters
    ----------
    scene, display, **options
        As for `inim.capture`.
    viewpoint : Viewpoint, str or (x, y, z)
        As for `inim.reconstruct`, inside the viewing zone.

    Returns
    -------
    (rows, columns, 3) float32, linear RGB, of the shape of a reconstructed view.
    """
    eye = single_viewpoint(viewpoint)
    view: np.ndarray = _render(_view, scene, display, (eye,), **options)
    return view


def _view(plan: Plan, camera: DepthCamera, run: Run) -> np.ndarray:
    (eye,), settings, rounds = plan.viewpoints, plan.settings, (plan.samples["view_spp"],)
    return ground_truth.render_view(
        camera.scene, eye, settings.view_pixels_per_lens, rounds, settings.seed, run=run
    )[0].replace_nonfinite().image  # fmt: skip


def _render(
    render: Render,
    scene: str | Path,
    display: Display | str | Path | None,
    viewpoints: tuple[str | Viewpoint, ...] | None = None,
    *,
    definitions: Mapping[str, Any] | None = None,
    backend: str = "auto",
    allow_folders: str | Path | Sequence[str | Path] = (),
    plugins: str | Sequence[str] = (),
    **unknown: Any,
) -> Any:
    from inim.system.process.locked_folder import locked_folder  # POSIX only, as the renderer

    for name in unknown:
        raise UsageError(
            f"{name}: is no argument; give definitions, backend, allow_folders or plugins. "
            'definitions contain settings: definitions={"inim.seed": 3}'
        )
    path = path_of("scene", scene)

    def make_request() -> tuple[Plan, Render]:
        request = Request(
            path,
            Path(),
            backend=backend,
            allow_folders=paths_of("allow_folders", allow_folders),
            plugins=tuple(PluginModule.of(str(p)).text for p in paths_of("plugins", plugins)),
            definitions=definitions or {},
            display=display,
            viewpoints=viewpoints,
        )
        return make_plan(request, of_scene=True), render

    with locked_folder(Path(tempfile.gettempdir()), "inim-image-") as folder:
        job = f"{__name__}:run_job"
        run_in_worker(job, make_request, nullcontext(folder), about=str(path))
        for text in json.loads((folder / _WARNINGS).read_text("utf-8")):
            warnings.warn(text, stacklevel=3)
        is_picture = (folder / _PICTURE).exists()
        return read_rgbd(folder / _PICTURE) if is_picture else np.load(folder / _IMAGE)


def run_job(request: tuple[Plan, Render], staging: Path, observer: Observer) -> bool:
    """Entry point in the worker: render the image and write it, with the scene's warnings."""
    plan, render = request
    run, renderer, _ = setup(plan, staging, observer, open_cache(plan), data_only=True)
    camera = plan.camera(renderer)
    with naming(plan.request.scene):
        scene_warnings = describe_scene(camera.scene, run=run)["warnings"]
        image = render(plan, camera, run)
    if isinstance(image, RGBD):
        write_rgbd(staging / _PICTURE, image)
    else:
        np.save(staging / _IMAGE, image)
    (staging / _WARNINGS).write_text(json.dumps(scene_warnings), "utf-8")
    return True
