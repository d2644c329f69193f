"""Scenes given as Mitsuba dictionaries."""

from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from inim.render import variant
from inim.render.library import mi
from inim.system.errors import SceneError


def write_scene_dict(scene: Mapping[str, Any], path: Path) -> None:
    """Write a scene as XML, with copies of its files in subfolders of the XML's folder.

    * `scene`: as for `mi.load_dict`, of type ``scene``. File names are relative to the current
      folder.

    Raises `SceneError`: not a scene, an unknown plugin, or a loaded Mitsuba object, which no file
    can hold.
    """
    if scene.get("type") != "scene":
        raise SceneError(f"scene: has the type {scene.get('type')!r}; give a dictionary of a scene")
    try:
        # The dictionary may hold values of the active variant.
        with variant.temporary() if mi.variant() is None else nullcontext():
            config = mi.parser.ParserConfig(mi.variant())
            state = mi.parser.parse_dict(config, dict(scene))
            mi.parser.transform_relocate(config, state, str(path.parent))
            mi.parser.write_file(state, str(path))
    except RuntimeError as error:
        raise SceneError(
            f"scene: cannot be written as XML ({' '.join(str(error).split())[:400]}); use "
            "dictionaries and names of files instead of loaded objects, and register own plugins"
        ) from None
