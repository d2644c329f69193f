"""Interface of commands, the options that they share, and the lines that they print."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from inim.system.errors import EXIT_CHECK_FAILED, EXIT_PASSED
from inim.system.process.printing import printable

if TYPE_CHECKING:
    from inim.display import Display
    from inim.display.settings import Settings
    from inim.pipeline.request import Request

#: Below the help of every command.
EXIT_CODES = """exit codes:
  0 passed    1 a check failed    2 usage, scene or file error
  3 no usable backend, or out of memory    4 baseline missing or not comparable    5 internal error
"""
# A parser, or a group of one.
_Options = Any


class Command(NamedTuple):
    """A command of `inim`: one line of help, functions, and an example of its use.

    `add_arguments` adds arguments to a parser; `run` runs the command with the parsed arguments and
    returns the exit code. The arguments include `command_line`, the command as typed.
    """

    summary: str
    add_arguments: Callable[[argparse.ArgumentParser], object]
    run: Callable[[argparse.Namespace], int]
    example: str


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
        help="preset (see `inim info displays`), an .xml file with inim.* settings, or the "
        "visual.json of a Looking Glass",
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
        help="axis of a mesh that points up: x, -x, y, ...; write a negative axis as --up=-z; "
        "required, except for glTF (y)",
    ),
    "front": _option(
        "--front",
        metavar="AXIS",
        help="axis of a mesh that faces the viewer (default: z; if z is up, -y)",
    ),
    "allow_folders": _option(
        "--allow-folder",
        action="append",
        default=[],
        type=Path,
        metavar="DIR",
        help="allow the scene to load files from this folder; may be repeated; auto: from the "
        "common folder of all files that it names",
    ),
    "preview": _option(
        "--preview",
        action="store_true",
        help="quick first look: template only, from the centre, few samples, and on lenticulars "
        "only panel pixels that the view needs; other options override these values",
    ),
    "open": _option("--open", action="store_true", help="open the virtual display in the browser"),
    "json": _option("--json", action="store_true", help="print JSON instead of text"),
    "quiet": _option("--quiet", action="store_true", help="print errors only"),
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
    from inim.render.scene_files.file import parse_definitions

    source = str(getattr(args, "scene", None) or _command_name(args))
    parsers: dict[str, Callable[[Any], Any]] = {
        "definitions": lambda items: parse_definitions(items, source),
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
    from inim.render.scene_files.file import choose_display

    chosen = choices_of(args)
    return choose_display(chosen.get("display"), chosen["definitions"], _command_name(args))


def _command_name(args: argparse.Namespace) -> str:
    return " ".join(args.command_line.split()[:2])


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


def default_out(source: Path | None, kind: str) -> Path:
    """Default of -o: in the current folder, named after the first input and the kind of result."""
    return Path(kind if source is None else f"{source.absolute().stem}-{kind}")


def open_page(page: Path, anchor: str = "") -> None:
    """Open a page in the browser."""
    import webbrowser

    webbrowser.open(page.resolve().as_uri() + anchor)


def opens_pages() -> bool:
    """True on a terminal with a screen, where commands may open the browser unasked."""
    has_screen = sys.platform in ("darwin", "win32") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )
    return has_screen and sys.stdout.isatty()


def print_warning(text: str, kind: str = "warning") -> None:
    """Print a warning, an error, or a list of failures as one line of stderr."""
    print(f"inim: {kind}: {printable(text)}", file=sys.stderr)


def print_lines(*lines: object) -> None:
    """Print results, each as one line."""
    for line in lines:
        print(printable(line), flush=True)


def print_outcome(*lines: object) -> None:
    """Print a command's last lines; a closed reader or a full disk changes no exit code."""
    try:
        print_lines(*lines)
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def finish(passed: bool, *lines: str, quiet: bool = False) -> int:
    """Print a command's last lines unless `quiet`, and return its exit code."""
    if not quiet:
        print_outcome(*lines)
    return EXIT_PASSED if passed else EXIT_CHECK_FAILED
