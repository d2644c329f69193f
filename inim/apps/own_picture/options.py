"""Options of a user's own pictures: depth and projection of a camera."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from inim.apps.own_picture.picture import CameraPicture

# A parser, or a group of one.
_Options = Any


def add_picture(parser: _Options) -> None:
    """Add options for a camera's depth and projection; `picture_of` collects them."""
    add = parser.add_argument
    add(
        "--depth",
        type=Path,
        metavar="FILE",
        help="depth of the colour picture INPUT: .png, .pgm, .tif, .exr, .pfm or .npy",
    )
    add(
        "--estimate-depth",
        metavar="MODEL",
        help="estimate the depth of the photograph INPUT with this depth-estimation model of "
        "transformers, a folder or a name on huggingface.co; needs pip install 'inim[depth]'",
    )
    add(
        "--depth-unit",
        metavar="UNIT",
        help="unit of --depth, required: mm, cm, m, none, or a number of units per metre, such as "
        "5000",
    )
    add(
        "--intrinsics",
        metavar="FX,FY,CX,CY",
        help="camera parameters in pixels of the colour picture; or `photo`: read them from the "
        "photograph",
    )
    add("--orthographic", action="store_true", help="treat the picture as taken with parallel rays")
    add(
        "--depth-map",
        default="linear",
        help="mapping of depth to the display: linear, reciprocal (Li 2012), or printed (Eq. 4 of "
        "Wang 2024 as printed)",
    )
    direction = parser.add_mutually_exclusive_group()
    direction.add_argument("--near-is-large", action="store_true", help="larger values are nearer")
    direction.add_argument(
        "--far-is-large",
        action="store_true",
        help="larger values are farther (default of depths with a unit)",
    )
    add(
        "--near",
        type=float,
        metavar="D",
        help="nearest depth to map, in mm, or in raw values with --depth-unit none",
    )
    add(
        "--far",
        type=float,
        metavar="D",
        help="farthest depth to map (defaults of both: 0.5 %% and 99.5 %% quantiles)",
    )
    add(
        "--out-of-range",
        default="clip",
        help="what to do with depths beyond --near and --far: clip or drop (default: %(default)s)",
    )
    add(
        "--missing",
        default="",
        metavar="N,...",
        help="values in the file that stand for missing depth",
    )
    add(
        "--missing-depth",
        default="none",
        help="how to fill missing depth: none, nearest, behind or far (default: %(default)s)",
    )
    add(
        "--fit",
        help="cover: fill the array; contain: show the whole picture; auto: fill it with the "
        "subject (default: cover, or auto for a photograph that contains depth)",
    )
    add(
        "--frame-at",
        type=float,
        metavar="D",
        help="distance at which the picture fits the array (default: the median depth)",
    )
    add(
        "--max-slope",
        type=float,
        default=10.0,
        help="steepest slope within one surface; steeper steps are edges (default: %(default)g)",
    )
    add("--swap-bytes", action="store_true", help="swap the two bytes of each 16-bit depth")


def picture_of(args: argparse.Namespace) -> CameraPicture:
    """Picture defined by the options of `add_picture`."""
    from dataclasses import fields

    from inim.apps.own_picture.picture import CameraPicture

    return CameraPicture(**{f.name: getattr(args, f.name) for f in fields(CameraPicture)})


def classify_input(args: argparse.Namespace) -> None:
    """Set the kind of the positional argument INPUT, by its content and --depth.

    Exactly one of these becomes the path: `scene` (.xml); `mesh`, or splats; `fitted`, an RGB-D
    picture (.exr); `cameras_file`, pictures of several cameras (.json); `light_field`, the folder
    of an HCI light field; `color`, the colour picture of --depth; or `photo`, a photograph with
    depth inside or to be estimated (or a folder of them).
    """
    from inim.render.meshes.triangle_mesh import MESH_SUFFIXES

    kinds = ("scene", "mesh", "fitted", "cameras_file", "light_field", "color", "photo")
    vars(args).update(dict.fromkeys(kinds))
    suffix = args.input.suffix.lower()
    if args.estimate_depth is not None:
        kind = "photo"
    elif args.depth is not None:
        kind = "color"
    elif args.input.is_dir() and any(
        path.name == "parameters.cfg" or path.name.startswith("input_Cam")
        for path in args.input.iterdir()
    ):
        kind = "light_field"
    elif suffix == ".xml":
        kind = "scene"
    elif suffix in MESH_SUFFIXES:
        kind = "mesh"
    else:
        kind = {".exr": "fitted", ".json": "cameras_file"}.get(suffix, "photo")
    setattr(args, kind, args.input)
