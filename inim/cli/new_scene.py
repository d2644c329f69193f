"""Command `inim new-scene`."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from inim.pipeline.options import (
    Command,
    add_shared,
    print_lines,
    print_warning,
)

if TYPE_CHECKING:
    import argparse


def _add_scene_arguments(parser: argparse.ArgumentParser) -> None:
    from inim.render.scene_files.new_scene import UNITS

    add = parser.add_argument
    add(
        "mesh",
        type=Path,
        metavar="MESH",
        help="mesh (PLY, OBJ, OFF, STL, GLB or glTF) or Gaussian splats (PLY), or a folder with "
        "one of these",
    )
    add_shared(parser, out="scene to write, .xml (default: MESH-scene.xml)")
    add(
        "--unit",
        choices=UNITS,
        help="length of one unit of the mesh; required, except for glTF (m) and splats",
    )
    add_shared(parser, "up", "front")
    add(
        "--crop",
        metavar="BOX",
        help="splats: keep only this box, x0,x1,y0,y1,z0,z1 (default: a box of nearly all)",
    )
    add("--force", action="store_true", help="replace existing files")


def _new_scene(args: argparse.Namespace) -> int:
    from inim.render.scene_files.new_scene import new_scene

    options = ("unit", "up", "front", "crop", "force")
    choices = {name: getattr(args, name) for name in options}
    path = new_scene(args.mesh, args.out, **choices, warn=print_warning, say=print_lines)
    print_lines(f"wrote {path}; next: inim validate {shlex.quote(str(path))}")
    return 0


COMMANDS = {
    "new-scene": Command(
        "create a lit scene from a mesh or Gaussian splats",
        _add_scene_arguments,
        _new_scene,
        "inim new-scene goblet.ply --unit mm --up y -o relic.xml",
    ),
}
