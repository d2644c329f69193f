"""Scenes given as a dictionary or a mesh, written as files."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from inim.errors import UsageError
from inim.worker.output import default_out, output_files


def scene_and_out(
    scene: object, out: Path | None, options: Mapping[str, Any] | None
) -> tuple[Path, Path]:
    """Path of the scene's XML, and the report's folder.

    A dictionary or a mesh becomes a scene in the folder `OUT-scene`, which remains: the report's
    command, and later quilts and views of the ground truth, read it.
    """
    from inim.files.triangle_mesh import MESH_SUFFIXES

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
        _write(scene, staging / f"{name}.xml", dict(options or {}))
    return folder / f"{name}.xml", out


def _write(scene: object, path: Path, options: dict[str, Any]) -> None:
    if isinstance(scene, Mapping):
        from inim.render.scene_dict import write_scene_dict

        if options:
            raise UsageError("new_scene: the scene is a dictionary already; leave it out")
        write_scene_dict(scene, path)
        return
    from inim.scene.new_scene import new_scene

    if isinstance(scene, str | PathLike):
        new_scene(Path(scene), path, **{"title": path.stem, **options})
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
