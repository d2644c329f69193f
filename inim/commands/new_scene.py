"""Command `inim new-scene`: a lit scene of a relic, from a mesh or from Gaussian splats."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from inim.commands.options import Command, print_warning

if TYPE_CHECKING:
    import argparse


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    from inim.scene.new_scene import AXES, UNITS

    add = parser.add_argument
    add(
        "mesh",
        type=Path,
        metavar="MESH",
        help="mesh (PLY, OBJ, OFF, STL, GLB or glTF) or Gaussian splats (PLY)",
    )
    add("-o", "--out", type=Path, metavar="XML", help="scene to write (default: MESH-scene.xml)")
    add(
        "--unit",
        choices=UNITS,
        help="length of one unit of the mesh; required, except for glTF (m) and splats",
    )
    axes = f"{', '.join(AXES)}; write a negative axis as --up=-z"
    add(
        "--up",
        metavar="AXIS",
        help=f"axis of the mesh that points up: {axes}; required, except for glTF (y)",
    )
    add(
        "--front",
        metavar="AXIS",
        help="axis of the mesh that faces the viewer (default: z; if z is up, -y)",
    )
    add(
        "--crop",
        metavar="BOX",
        help="splats: keep only this box, x0,x1,y0,y1,z0,z1 (default: a box of nearly all)",
    )
    add("--title", help="name of the scene in reports (default: the mesh file's name)")
    add("--display", help="display preset to write into the scene: nominal or phone")
    add("--force", action="store_true", help="replace existing files")


def _run(args: argparse.Namespace) -> int:
    from inim.scene.new_scene import new_scene

    options = ("unit", "up", "front", "crop", "title", "display", "force")
    choices = {name: getattr(args, name) for name in options}
    path = new_scene(args.mesh, args.out, **choices, warn=print_warning, say=print)
    print(f"wrote {path}; next: inim validate {shlex.quote(str(path))}")
    return 0


COMMANDS = {
    "new-scene": Command("create a lit scene from a mesh or Gaussian splats", _add_arguments, _run)
}
