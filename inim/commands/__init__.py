"""Commands of the program, one file per group; `inim.cli` describes such a module.

This module has their interface, shared options, and the last line of output.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from inim.errors import EXIT_CHECK_FAILED, EXIT_PASSED, UsageError

if TYPE_CHECKING:
    from inim.display import Display
    from inim.from_camera.picture import CameraPicture
    from inim.pipeline.request import Request
    from inim.settings import Settings

#: Below the help of every command.
EXIT_CODES = """exit codes:
  0 passed    1 a check failed    2 usage, scene or file error
  3 no usable backend, or out of memory    4 baseline missing or not comparable    5 internal error
"""
# A parser, or a group of one.
_Options = Any


class Command(NamedTuple):
    """A command of `inim`: one line of help, and functions.

    `add_arguments` adds arguments to a parser; `run` runs the command with the parsed arguments and
    returns the exit code. The arguments include `command_line`, the command as typed.
    """

    summary: str
    add_arguments: Callable[[argparse.ArgumentParser], object]
    run: Callable[[argparse.Namespace], int]


def _option(*flags: str, **settings: Any) -> tuple[tuple[str, ...], dict[str, Any]]:
    return flags, settings


# Arguments that several commands share, by the name of their value.
_SHARED = {
    "scene": _option("scene", type=Path, help="Mitsuba scene (.xml)"),
    "source": _option(
        "source", type=Path, metavar="OUT|EIA", help="a report's folder, or an EIA (.png, .exr)"
    ),
    "out": _option("-o", "--out", type=Path),
    "definitions": _option(
        "-D",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="set an inim.* setting or a scene parameter; may be repeated",
    ),
    "display": _option(
        "--display",
        help="preset (nominal, phone, ...), an .xml file with inim.* settings, or the visual.json "
        "of a Looking Glass",
    ),
    "algorithms": _option(
        "-a",
        "--algorithms",
        help="algorithms with options, separated by commas; see `inim info algorithms`",
    ),
    "cameras": _option(
        "--cameras",
        help="also score algorithms on RGB-D pictures from several cameras: 5 (centre and corners "
        "of the viewing zone) or a grid such as 3x3; several of these, separated by commas",
    ),
    "viewpoints": _option(
        "--viewpoints", help="names, such as centre, or 'name=x y [z]' in mm; separated by commas"
    ),
    "lens_model": _option(
        "--lens-model",
        help="pinhole, thin, thick, full (thick lenses as a path-traced mesh, slow), or a model "
        "from another package",
    ),
    "up": _option(
        "--up",
        metavar="AXIS",
        help="axis of the mesh that points up: x, -x, y, ...; write a negative axis as --up=-z; "
        "required, except for glTF (y)",
    ),
    "front": _option(
        "--front",
        metavar="AXIS",
        help="axis of the mesh that faces the viewer (default: z; if z is up, -y)",
    ),
    "allow_folders": _option(
        "--allow-folder",
        action="append",
        default=[],
        type=Path,
        metavar="DIR",
        help="allow the scene to load files from this folder; may be repeated",
    ),
    "preview": _option(
        "--preview",
        action="store_true",
        help="quick first look: template only, from the centre, few samples, and on lenticulars "
        "only panel pixels that the view needs; other options override these values",
    ),
    "open": _option("--open", action="store_true", help="open the virtual display in the browser"),
    "quiet": _option("--quiet", action="store_true", help="print errors only"),
    "debug": _option("--debug", action="store_true", help="show tracebacks of internal errors"),
}


def add_shared(parser: _Options, *names: str, **help_texts: str) -> None:
    """Add arguments that several commands share; a keyword replaces the help text of one."""
    for name in (*help_texts, *names):
        flags, settings = _SHARED[name]
        if flags[0].startswith("-"):
            settings = {**settings, "dest": name}
        if name in help_texts:
            settings = {**settings, "help": help_texts[name]}
        parser.add_argument(*flags, **settings)


def choices_of(args: argparse.Namespace) -> dict[str, Any]:
    """Display, algorithms and viewpoints of the arguments, as fields of `Choices`."""
    from inim.display.viewpoint import viewpoint_items
    from inim.generators import algorithm_items
    from inim.scene.file import parse_definitions

    parsers: dict[str, Callable[[Any], Any]] = {
        "definitions": parse_definitions,
        "display": str,
        "algorithms": algorithm_items,
        "cameras": str,
        "viewpoints": viewpoint_items,
        "lens_model": str,
    }
    texts = {name: getattr(args, name, None) for name in parsers}
    return {name: parsers[name](text) for name, text in texts.items() if text is not None}


def display_and_settings(args: argparse.Namespace) -> tuple[Display, Settings]:
    """Display and settings of a command without a scene, from --display and -D."""
    from inim.scene.file import choose_display

    chosen = choices_of(args)
    source = " ".join(args.command_line.split()[:2])
    return choose_display(chosen.get("display"), chosen["definitions"], source)


def request_of(args: argparse.Namespace) -> Request:
    """Request to validate the scene of the arguments."""
    from dataclasses import fields

    from inim.pipeline.request import Request
    from inim.pipeline.stages.method import parse_eias

    values = {f.name: getattr(args, f.name) for f in fields(Request) if hasattr(args, f.name)}
    if "eias" in values:
        values["eias"] = parse_eias(values["eias"])
    values |= {name: tuple(values.get(name, ())) for name in ("allow_folders", "plugins")}
    return Request(**values | choices_of(args))


def check_report_arguments(args: argparse.Namespace) -> None:
    """Reject a display for a `source` that is a report."""
    if args.display or args.definitions:
        raise UsageError(
            f"{args.source}: is a report, which has its own display; --display and -D are for an "
            "EIA"
        )


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

    from inim.from_camera.picture import CameraPicture

    return CameraPicture(**{f.name: getattr(args, f.name) for f in fields(CameraPicture)})


def open_page(page: Path) -> None:
    """Open a page in the browser."""
    import webbrowser

    webbrowser.open(page.resolve().as_uri())


def classify_input(args: argparse.Namespace) -> None:
    """Set the kind of the positional argument INPUT, by its content and --depth.

    Exactly one of these becomes the path: `scene` (.xml); `mesh`, or splats; `fitted`, an RGB-D
    picture (.exr); `cameras_file`, pictures of several cameras (.json); `light_field`, the folder
    of an HCI light field; `color`, the colour picture of --depth; or `photo`, a photograph with
    depth inside or to be estimated (or a folder of them).
    """
    from inim.files.triangle_mesh import MESH_SUFFIXES

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


def new_scene_options(
    args: argparse.Namespace, source: Path, *, is_mesh: bool
) -> dict[str, Any] | None:
    """Options of `new_scene` for a mesh of any size, from --up and --front; None for others."""
    axes = {"up": args.up, "front": args.front}
    if is_mesh:
        from inim.scene.new_scene import ANY_UNIT

        return {"unit": ANY_UNIT, **axes}
    if any(axis is not None for axis in axes.values()):
        raise UsageError(f"--up, --front: {source} is not a mesh; leave them out")
    return None


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


def finish(passed: bool, text: str, *, quiet: bool = False) -> int:
    """Print a command's last line unless `quiet`, and return its exit code."""
    if not quiet:
        print_outcome(text)
    return EXIT_PASSED if passed else EXIT_CHECK_FAILED
