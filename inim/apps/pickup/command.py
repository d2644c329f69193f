"""Command `inim pickup`, for raw pictures."""

import argparse
from pathlib import Path

from inim.pipeline.options import (
    Command,
    add_shared,
    choices_of,
    default_out,
    finish,
    print_warning,
)


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
    out = "display file to write (default: PICTURE-eia.xml); the EIA gets the same name"
    display = "lens pitch, focal length and gap: preset (nominal or phone) or an .xml file"
    add_shared(parser, "definitions", out=out, display=display)


def _pickup(args: argparse.Namespace) -> int:
    from inim.apps.pickup.elemental_images import pickup

    options = ("white", "about_px", "dark", "raw", "orthoscopic")
    choices = choices_of(args) | {name: getattr(args, name) for name in options}
    out = args.out or default_out(args.picture, "eia.xml")
    capture = pickup(args.picture, out=out, **choices)
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


_SUMMARY = "convert a picture of elemental images to an EIA"
_EXAMPLE = "inim pickup raw.png --white white.png --raw -o letters.xml"
COMMANDS = {"pickup": Command(_SUMMARY, _add_pickup_arguments, _pickup, _EXAMPLE)}
