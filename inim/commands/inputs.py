"""Preparation of inputs: `inim pickup` for raw pictures, `inim new-scene` for relics."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from inim.commands import Command, add_shared, choices_of, finish, print_warning

if TYPE_CHECKING:
    import argparse


def _add_scene_arguments(parser: argparse.ArgumentParser) -> None:
    from inim.scene.new_scene import UNITS

    add = parser.add_argument
    add(
        "mesh",
        type=Path,
        metavar="MESH",
        help="mesh (PLY, OBJ, OFF, STL, GLB or glTF) or Gaussian splats (PLY), or a folder with "
        "one of these",
    )
    add("-o", "--out", type=Path, metavar="XML", help="scene to write (default: MESH-scene.xml)")
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
    add("--title", help="name of the scene in reports (default: the mesh file's name)")
    add("--display", help="display preset to write into the scene: nominal, fine or phone")
    add("--force", action="store_true", help="replace existing files")


def _new_scene(args: argparse.Namespace) -> int:
    from inim.scene.new_scene import new_scene

    options = ("unit", "up", "front", "crop", "title", "display", "force")
    choices = {name: getattr(args, name) for name in options}
    path = new_scene(args.mesh, args.out, **choices, warn=print_warning, say=print)
    print(f"wrote {path}; next: inim validate {shlex.quote(str(path))}")
    return 0


def _add_pickup_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Convert a plenoptic camera's raw picture, or a photograph through a lens array, to an EIA "
        "(.png, .exr) and a display file (.xml). Print the lattice with 95 % intervals."
    )
    add = parser.add_argument
    add("picture", type=Path, metavar="PICTURE", help="PNG, TIFF, JPEG or EXR")
    add("--white", type=Path, metavar="FILE", help="picture of a uniform bright surface")
    pitch = "without --white: pitch of the elemental images, within 2.5 %%"
    add("--pitch-px", dest="about_px", type=float, metavar="PIXELS", help=pitch)
    add("--dark", type=Path, metavar="FILE", help="picture without light, to subtract")
    add("--raw", action="store_true", help="codes are proportional to light (default: sRGB)")
    add("--orthoscopic", action="store_true", help="do not rotate elemental images by 180 degrees")
    out = "display file to write (PICTURE-eia.xml); the EIA gets the same name"
    display = "lens pitch, focal length and gap: preset (nominal or phone) or an .xml file"
    add_shared(parser, "definitions", "debug", out=out, display=display)


def _pickup(args: argparse.Namespace) -> int:
    from inim.from_camera.elemental_images import pickup

    options = ("white", "about_px", "dark", "raw", "orthoscopic")
    choices = choices_of(args) | {name: getattr(args, name) for name in options}
    capture = pickup(args.picture, out=args.out or f"{args.picture.stem}-eia.xml", **choices)
    lattice = capture.lattice
    if args.white is None:
        print_warning(
            f"{args.picture}: outlines of the object displace seams; intervals are approximate, "
            "a white picture with --white is better"
        )
    print(f"lattice    {lattice.kind}, {lattice.columns} x {lattice.rows} elemental images")
    print(f"pitch      {lattice.pitch_px} px")
    print(f"row pitch  {lattice.row_pitch_px} px{', as in a regular lattice' * lattice.is_regular}")
    print(f"rotation   {lattice.rotation_deg} degrees")
    print(f"centre     {lattice.x_px} px from the left, {lattice.y_px} px from the top")
    print(f"residuals  {lattice.rms_px:.2g} px rms, in {lattice.used_count} elemental images")
    return finish(True, f"written    {', '.join(map(str, capture.files))}")


COMMANDS = {
    "pickup": Command(
        "convert a picture of elemental images to an EIA", _add_pickup_arguments, _pickup
    ),
    "new-scene": Command(
        "create a lit scene from a mesh or Gaussian splats", _add_scene_arguments, _new_scene
    ),
}
