"""Options of `inim generate` for a user's own pictures, declared once."""

import argparse
import types
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from inim.system.field_comments import field_comments

DepthMapName = Literal["linear", "reciprocal", "printed"]
FillRule = Literal["none", "nearest", "behind", "far"]


@dataclass(frozen=True)
class PictureOptions:
    """Options for reading and fitting a camera's picture; each field is the option of that name."""

    #: depth of the colour picture INPUT: .png, .pgm, .tif, .exr, .pfm, .npy or .npz; or right,
    #: left, top or bottom: the half of INPUT that holds it
    depth: Path | None = None
    #: estimate the depth of the photograph INPUT with this depth-estimation model of transformers,
    #: a folder or a name on huggingface.co; needs pip install 'inim[depth]'
    estimate_depth: str | None = None
    #: unit of --depth, required: mm, cm, m, none, or a number of units per metre, such as 5000
    depth_unit: str | None = None
    #: move every pixel to its position in space by the camera parameters fx,fy,cx,cy, in pixels of
    #: the colour picture; or `photo`: by those in the photograph
    intrinsics: str | None = None
    orthographic: bool = False  #: treat the picture as taken with parallel rays
    #: mapping of depth to the display: linear, reciprocal (Li 2012), or printed (Eq. 4 of Wang 2024
    #: as printed)
    depth_map: DepthMapName = "linear"
    near_is_large: bool = False  #: larger values are nearer
    far_is_large: bool = False  #: larger values are farther (default of depths with a unit)
    #: nearest depth to map, in mm, or in raw values with --depth-unit none
    near: float | None = None
    #: farthest depth to map (defaults of both: 0.5 % and 99.5 % quantiles)
    far: float | None = None
    #: what to do with depths beyond --near and --far
    out_of_range: Literal["clip", "drop"] = "clip"
    missing: str = ""  #: values in the file that stand for missing depth, separated by commas
    missing_depth: FillRule = "none"  #: how to fill missing depth
    #: cover: fill the array; contain: show the whole picture; auto: fill it with the subject
    #: (default: cover, or auto for a photograph that contains depth)
    fit: Literal["contain", "cover", "auto"] | None = None
    #: distance at which the picture fits the array (default: the median depth)
    frame_at: float | None = None
    #: steepest slope within one surface; steeper steps are edges
    max_slope: float = 10.0
    swap_bytes: bool = False  #: swap the two bytes of each 16-bit depth


_METAVARS = {Path: "FILE", float: "NUMBER", str: "TEXT"}


def add_picture(parser: argparse.ArgumentParser) -> None:
    """Add `PictureOptions` to a parser."""
    direction = parser.add_mutually_exclusive_group()
    hints, texts = get_type_hints(PictureOptions), field_comments(PictureOptions)
    for field in fields(PictureOptions):
        kind = hints[field.name]
        settings: dict[str, Any] = {"default": field.default}
        if get_origin(kind) is types.UnionType or type(None) in get_args(kind):
            kind = get_args(kind)[0]
        if kind is bool:
            settings["action"] = "store_true"
        elif words := get_args(kind):
            settings["choices"] = words
        else:
            settings |= {"type": kind, "metavar": _METAVARS[kind]}
        settings["help"] = texts[field.name].replace("%", "%%")
        if field.default:
            settings["help"] += f" (default: {field.default})"
        group = direction if field.name.endswith("_is_large") else parser
        group.add_argument(f"--{field.name.replace('_', '-')}", **settings)


def option_defaults() -> dict[str, Any]:
    """Defaults of `PictureOptions` by name."""
    return {field.name: field.default for field in fields(PictureOptions)}
