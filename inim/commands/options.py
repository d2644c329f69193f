"""Interface of commands, shared options, and the last line of output."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from inim.from_camera.picture import CameraPicture

_EXIT_CODES = """exit codes:
  0 passed    1 a check failed    2 usage, scene or file error
  3 no usable backend, or out of memory    4 baseline missing or incomparable    5 internal error
"""
# A parser, or a group of one.
_Options = Any


class Command(NamedTuple):
    """A command of `inim`: one line of help, and functions.

    `add_arguments` adds arguments to a parser; `run` runs the command with the parsed arguments and
    returns the exit code.
    """

    summary: str
    add_arguments: Callable[[argparse.ArgumentParser], object]
    run: Callable[[argparse.Namespace], int]


def add_exit_codes(parser: argparse.ArgumentParser) -> None:
    """Add the exit codes below a command's help."""
    parser.epilog = _EXIT_CODES
    parser.formatter_class = argparse.RawDescriptionHelpFormatter


def add_allow_folder(parser: _Options) -> None:
    """Add `--allow-folder DIR`, stored in `allow_folders`."""
    parser.add_argument(
        "--allow-folder",
        dest="allow_folders",
        action="append",
        default=[],
        type=Path,
        metavar="DIR",
        help="allow files of the scene in this folder; may be repeated",
    )


#: Options for a display, its EIAs and its viewer, as `inim.pipeline.request.Choices` has them.
_CHOICES: dict[str, dict[str, Any]] = {
    "definitions": {
        "action": "append",
        "default": [],
        "metavar": "KEY=VALUE",
        "help": "set an inim.* setting or a scene parameter; may be repeated",
    },
    "display": {"help": "preset (nominal or phone) or an .xml file with inim.* settings"},
    "algorithms": {
        "help": "algorithms with options, separated by commas; see `inim info algorithms`",
    },
    "viewpoints": {"help": "names or 'name=x y [z]' in mm, separated by commas"},
    "lens_model": {"help": "pinhole, thin, thick, full, or a model from another package"},
}


def add_choices(parser: _Options, *names: str) -> None:
    """Add options for a display, its EIAs and its viewer, by default all; see `choices_of`."""
    for name in names or _CHOICES:
        options = [f"--{name.replace('_', '-')}"]
        if name == "definitions":
            options = ["-D"]
        elif name == "algorithms":
            options.insert(0, "-a")
        parser.add_argument(*options, dest=name, **_CHOICES[name])


def choices_of(args: argparse.Namespace) -> dict[str, Any]:
    """Values of the options of `add_choices`, as fields of `Choices`."""
    from inim.display.viewpoint import viewpoint_items
    from inim.generators import algorithm_items
    from inim.scene.file import parse_definitions

    parsers: dict[str, Callable[[Any], Any]] = {
        "definitions": parse_definitions,
        "display": str,
        "algorithms": algorithm_items,
        "viewpoints": viewpoint_items,
        "lens_model": str,
    }
    texts = {name: getattr(args, name, None) for name in parsers}
    return {name: parsers[name](text) for name, text in texts.items() if text is not None}


def add_quiet(parser: _Options) -> None:
    """Add `--quiet` and `--debug`."""
    parser.add_argument("--quiet", action="store_true", help="print errors only")
    add_debug(parser)


def add_debug(parser: _Options) -> None:
    """Add `--debug`."""
    parser.add_argument("--debug", action="store_true", help="show tracebacks of internal errors")


def add_picture(parser: _Options) -> None:
    """Add options for a camera's depth and projection; `picture_of` collects them."""
    add = parser.add_argument
    add(
        "--depth",
        type=Path,
        metavar="FILE",
        help="depth of the colour picture INPUT: .png, .pgm, .tif, .exr, .pfm or .npy",
    )
    add("--depth-unit", metavar="UNIT", help="mm, cm, m, units per metre (5000), or none")
    add(
        "--intrinsics",
        metavar="FX,FY,CX,CY",
        help="camera, in pixels of the colour picture; photo: its own",
    )
    add("--orthographic", action="store_true", help="treat the picture as orthographic")
    add("--depth-map", default="linear", help="linear, reciprocal (Li 2012), or printed (Eq. 4)")
    direction = parser.add_mutually_exclusive_group()
    direction.add_argument("--near-is-large", action="store_true", help="large values are near")
    direction.add_argument(
        "--far-is-large", action="store_true", help="large values are far, as for distances"
    )
    add(
        "--near",
        type=float,
        metavar="D",
        help="nearest depth to map (mm, or raw values if unitless)",
    )
    add(
        "--far",
        type=float,
        metavar="D",
        help="farthest depth to map (defaults: 0.5 and 99.5 %% quantiles)",
    )
    add("--out-of-range", default="clip", help="depths beyond --near and --far: clip or drop")
    add(
        "--missing",
        default="",
        metavar="N,...",
        help="values in the file that stand for missing depth",
    )
    add(
        "--missing-depth",
        default="none",
        help="filling of missing depth: none, nearest, behind or far",
    )
    add(
        "--fit",
        help="contain: the whole picture; cover: the whole array; auto: by the subject's depth",
    )
    add(
        "--frame-at",
        type=float,
        metavar="D",
        help="distance at which the picture fits the array (median)",
    )
    add("--max-slope", type=float, default=10.0, help="largest slope within one surface (10)")
    add("--swap-bytes", action="store_true", help="swap the bytes of 16-bit depth")


def picture_of(args: argparse.Namespace) -> CameraPicture:
    """Picture defined by the options of `add_picture`."""
    from dataclasses import fields

    from inim.from_camera.picture import CameraPicture

    return CameraPicture(**{f.name: getattr(args, f.name) for f in fields(CameraPicture)})


def classify_input(args: argparse.Namespace) -> None:
    """Set the kind of the positional argument INPUT, by its content and --depth.

    Exactly one of `scene`, `fitted`, `light_field`, `color` and `photo` becomes the path: a scene
    (.xml), a fitted RGB-D picture (.exr), a folder of an HCI light field, the colour picture of
    --depth, or a photograph with depth inside (or a folder of them).
    """
    kinds = ("scene", "fitted", "light_field", "color", "photo")
    vars(args).update(dict.fromkeys(kinds))
    suffix = args.input.suffix.lower()
    if args.depth is not None:
        kind = "color"
    elif args.input.is_dir() and any(
        path.name == "parameters.cfg" or path.name.startswith("input_Cam")
        for path in args.input.iterdir()
    ):
        kind = "light_field"
    elif suffix == ".xml":
        kind = "scene"
    else:
        kind = "fitted" if suffix == ".exr" else "photo"
    setattr(args, kind, args.input)


def print_warning(text: str, kind: str = "warning") -> None:
    """Print a warning, an error, or a list of failures as one line of stderr.

    Control characters in file names must not break the promise of one line.
    """
    line = "".join(c if c.isprintable() else " " for c in text)
    print(f"inim: {kind}: {line}", file=sys.stderr)


def print_outcome(text: str) -> None:
    """Print a command's last line; a closed reader or a full disk changes no exit code."""
    try:
        print(text, flush=True)
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
