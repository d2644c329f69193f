"""Entry points of a validation in a worker process, without heavy imports."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from inim.pipeline.options import default_out
from inim.system.errors import UsageError
from inim.system.plugins import PluginModule
from inim.system.process.observer import OnStage, shown_progress
from inim.system.worker.output import output_files, staging_folder
from inim.system.worker.supervisor import run_in_worker

if TYPE_CHECKING:
    import trimesh

    from inim.display import Display
    from inim.display.lens import LensModel, LensModelName
    from inim.display.viewpoint import Viewpoint
    from inim.pipeline.plan import Plan
    from inim.pipeline.request import Request
    from inim.report import Report

    Trimesh: TypeAlias = trimesh.Trimesh | trimesh.Scene


def validate_in_worker(
    make_request: Callable[[], Request],
    scene: Path,
    out: Path,
    *,
    quiet: bool = True,
    debug: bool = False,
    on_stage: OnStage | None = None,
) -> bool:
    """Validate in a worker process, which writes the report to `out`; True if every check passed.

    `make_request` returns the request for this scene and folder; it is called while the worker
    loads. `quiet` suppresses result lines and the progress bar, and `debug` prints the
    traceback of an internal error. `on_stage` receives the progress. Raises an `InimError` as
    `run_in_worker` does.
    """

    def plan() -> Plan:
        from inim.pipeline.plan import make_plan

        return make_plan(make_request())

    return run_in_worker(
        "inim.pipeline.job:run_job",
        plan,
        staging_folder(out),
        about=str(scene),
        quiet=quiet,
        debug=debug,
        on_stage=on_stage,
    )


def validate(
    scene: str | Path | Mapping[str, Any] | Trimesh,
    out: str | Path | None = None,
    *,
    definitions: Mapping[str, Any] | None = None,
    display: str | Path | Display | None = None,
    algorithms: str | Sequence[str | Mapping[str, Any]] | Mapping[str, Any] | None = None,
    cameras: str | int | None = None,
    viewpoints: str | Viewpoint | Sequence[str | Viewpoint | Sequence[float]] | None = None,
    lens_model: LensModelName | LensModel | None = None,
    misalign: str | Mapping[str, float] | None = None,
    eias: Mapping[str, str | Path] | None = None,
    backend: str = "auto",
    baseline: str | Path | None = None,
    preview: bool = False,
    time: bool = False,
    lazy: bool = False,
    no_skip: bool = False,
    allow_folders: str | Path | Sequence[str | Path] = (),
    new_scene: Mapping[str, Any] | None = None,
    plugins: str | Sequence[str] = (),
    allow_changed_inputs: bool = False,
    progress: Callable[[str, float], object] | bool | None = None,
) -> Report:
    """Validate a scene in a worker process, as `python -m inim.validate` does.

    Options accept the command's text or Python values. The report's `command` repeats the run.

    Parameters
    ----------
    scene : path, dictionary or trimesh
        Mitsuba XML with `inim.*` settings, a dictionary as for `mi.load_dict`, or a mesh: a file or
        a `trimesh` object. The scene of a dictionary or a mesh is written into `<out>-scene`, with
        copies of the files that it references.
    out : path, optional
        Folder for the report; default: `<scene>-report` in the current folder.
    definitions : mapping, optional
        Settings and scene parameters to override, as text or numbers: ``{"inim.pitch_mm": 0.5}``.
    display : str, path or Display, optional
        Preset, display file or display; replaces the scene's display.
        Reports name a display that is not a preset after the nearest one: "nominal, changed".
    algorithms : str, sequence or mapping, optional
        Text as after ``--algorithms``; names with or without options (``"template:samples=2"``);
        or options by name: ``{"template": {"samples": 2}, "wang2024": {}}``.
    cameras : str or int, optional
        Also score RGB-D from several cameras, as after ``--cameras``: ``5`` or ``"3x3"``.
    viewpoints : str, Viewpoint or sequence, optional
        Text as after ``--viewpoints``; or names (``"left"``), texts, `Viewpoint` objects and
        positions ``(x, y, z)`` in mm, of eyes without a pupil.
        All `Viewpoint` objects must have the same pupil and focus, which apply to every viewpoint.
    lens_model : {"pinhole", "thin", "thick", "full"} or LensModel, optional
        Of another package, pass the registered `inim.display.lens.LensModel`; its name works, too.
    misalign : str or mapping, optional
        Misalignment of the lens array: ``"rotation_deg=0.5"``, or ``{"rotation_deg": 0.5}``.
    eias : mapping, optional
        Finished EIAs to score with the algorithms, by name: ``{"mine": "mine.png"}``.
    backend : {"auto", "llvm", "cuda"}
    baseline : path, optional
        Folder of a baseline from `inim accept`, to compare with.
    preview : bool
        Quick preview: one algorithm, one viewpoint, few samples. It cannot become a baseline.
    time : bool
        Time the generators in kernel times.
    lazy : bool
        Generate and render only the panel pixels that the viewpoints observe: the views and their
        scores are the same, and whole EIAs are not scored.
    no_skip : bool
        Run every step, even if it cannot change a result, and ignore the result cache.
    allow_folders : path or sequence of path
        Additional folders for files that the scene references.
    new_scene : mapping, optional
        Options of `inim.new_scene` for a mesh: ``{"unit": "mm", "up": "y"}``.
    plugins : str or sequence of str, optional
        Modules to import in the worker that register Mitsuba plugins of the scene, by name or by
        the path of a .py file.
    allow_changed_inputs : bool
        If inputs differ from the baseline's, scores may change.
    progress : callable or bool, optional
        Receives the name of each stage and the finished share of the stages, 0..1; an exception
        from it ends the run. Or whether to draw a progress bar; by default in notebooks only.

    Returns
    -------
    Report
        Its `passed` is False if a check failed; a failed check raises no error.

    Raises
    ------
    InimError
        The error that the command would print; a `UsageError` for values of a wrong type.
    """
    from inim.display.lens import lens_model_name
    from inim.display.misalignment import parse_misalignment
    from inim.display.viewpoint import viewpoint_items
    from inim.generators import algorithm_items
    from inim.pipeline.request import Request

    path, folder = scene_and_out(scene, None if out is None else path_of("out", out), new_scene)
    if eias is not None and not isinstance(eias, Mapping):
        raise UsageError(f"eias: is a {type(eias).__name__}; give a mapping of names to paths")
    request = Request(
        path,
        folder,
        {str(name): path_of(f"eias[{name!r}]", eia) for name, eia in (eias or {}).items()},
        backend,
        None if baseline is None else path_of("baseline", baseline),
        preview,
        time,
        lazy,
        no_skip,
        paths_of("allow_folders", allow_folders),
        tuple(PluginModule.of(str(name)).text for name in paths_of("plugins", plugins)),
        allow_changed_inputs,
        definitions={} if definitions is None else definitions,
        display=display,
        algorithms=None if algorithms is None else algorithm_items(algorithms),
        cameras=None if cameras is None else str(cameras),
        viewpoints=None if viewpoints is None else viewpoint_items(viewpoints),
        lens_model=None if lens_model is None else lens_model_name(lens_model),
        misalign=None if misalign is None else parse_misalignment(misalign),
    )
    with shown_progress(progress) as on_stage:
        validate_in_worker(lambda: request, path, folder, on_stage=on_stage)
        if on_stage is not None:
            on_stage("finished", 1.0)
    from inim.report import Report

    return Report.load(request.out)


def paths_of(name: str, value: object) -> tuple[Path, ...]:
    """Paths in an argument, a path or several; raises `UsageError` for another type."""
    if isinstance(value, list | tuple):
        return tuple(path_of(name, item) for item in value)
    return (path_of(name, value),)


def path_of(name: str, value: object) -> Path:
    """Path in an argument; raises `UsageError` for another type."""
    if not isinstance(value, str | PathLike):
        raise UsageError(f"{name}: is a {type(value).__name__}; give a path")
    return Path(value)


def scene_and_out(
    scene: object,
    out: Path | None,
    options: Mapping[str, Any] | None,
    warn: Callable[[str], object] = warnings.warn,
) -> tuple[Path, Path]:
    """Path of the scene's XML, and the report's folder.

    A dictionary or a mesh becomes a scene in the folder `OUT-scene`, which remains: the report's
    command, and later quilts and views of the ground truth, read it.
    """
    from inim.render.meshes.triangle_mesh import MESH_SUFFIXES

    if isinstance(scene, str | PathLike):
        source = Path(scene)
        out = out or default_out(source, "report")
        if source.suffix.lower() not in MESH_SUFFIXES:
            if options is not None:
                raise UsageError(f"new_scene: {source} is a scene already; leave it out")
            return source, out
        name = source.stem
    else:
        name, out = "scene", out or Path("scene-report")
    folder = out.with_name(f"{out.name}-scene")
    with output_files(folder, (f"{name}.xml",)) as staging:
        _write_scene(scene, staging / f"{name}.xml", {"warn": warn, **(options or {})})
    return folder / f"{name}.xml", out


def _write_scene(scene: object, path: Path, options: dict[str, Any]) -> None:
    if isinstance(scene, Mapping):
        from inim.render.scene_dict import write_scene_dict

        if options.keys() - {"warn"}:
            raise UsageError("new_scene: the scene is a dictionary already; leave it out")
        write_scene_dict(scene, path)
        return
    from inim.render.scene_files.new_scene import ANY_UNIT, new_scene

    if isinstance(scene, str | PathLike):
        new_scene(Path(scene), path, **{"title": path.stem, "unit": ANY_UNIT, **options})
        return
    trimesh = sys.modules.get("trimesh")
    if trimesh is None or not isinstance(scene, trimesh.Trimesh | trimesh.Scene):
        raise UsageError(
            f"scene: is a {type(scene).__name__}; give a path, a Mitsuba dictionary or a trimesh"
        )
    if not {"unit", "up"} <= options.keys():
        raise UsageError(
            "new_scene: a trimesh has no unit and no up axis; give them, such as "
            "new_scene={'unit': 'mm', 'up': 'y'}"
        )
    mesh = path.with_suffix(".glb")  # holds textures and vertex colours
    scene.export(mesh)
    new_scene(mesh, path, **options)
    mesh.unlink()
