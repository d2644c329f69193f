"""The command line. Imports nothing heavy: `--help` answers at once."""

from __future__ import annotations

import argparse
import io
import json
import os
import signal
import sys
import traceback
from pathlib import Path
from typing import Any, NoReturn

from inim.errors import (
    EXIT_CHECK_FAILED,
    EXIT_INTERNAL,
    EXIT_PASSED,
    EXIT_USAGE,
    InimError,
    UsageError,
)
from inim.version import __version__

__all__ = ["main"]

_EXIT_CODES = """exit codes:
  0 passed    1 a check failed    2 usage, scene or file error
  3 no usable backend, or out of memory    4 baseline missing or incomparable    5 internal error
"""


Commands = Any  # argparse keeps the type of what add_subparsers returns to itself


class _Parser(argparse.ArgumentParser):
    """One line per mistake instead of a page of usage."""

    def error(self, message: str) -> NoReturn:
        self.exit(EXIT_USAGE, f"inim: error: {message}; see {self.prog} --help\n")


def main(argv: list[str] | None = None) -> int:
    """Run one command and return its exit code.

    Parameters
    ----------
    argv : list of str, optional
        Arguments after the program's name; the process's own otherwise.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a name must not fail for the terminal's encoding
            stream.reconfigure(errors="backslashreplace")
    for number in range(3):  # closed ones would be handed out again, to pipes and files
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    args = _parser().parse_args(argv)
    try:
        return int(args.run(args))
    except InimError as error:
        if getattr(args, "debug", False) and error.__cause__:
            traceback.print_exception(error.__cause__)
        print(f"inim: error: {_one_line(str(error))}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("inim: interrupted; nothing was written", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of our output left; that is its right
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_PASSED
    except Exception as error:
        if getattr(args, "debug", False):
            raise
        text = f"internal error: {type(error).__name__}: {error}"
        print(f"inim: error: {_one_line(text)}; run again with --debug", file=sys.stderr)
        return EXIT_INTERNAL


def _one_line(text: str) -> str:
    """Control characters in file names must not break the one-line promise."""
    return "".join(c if c.isprintable() else " " for c in text)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="inim",
        description="A virtual bench for integral-imaging displays.",
        epilog=_EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"inim {__version__}")
    commands: Commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_validate(commands)
    _add_baseline(commands)
    _add_compare(commands)
    _add_new_scene(commands)
    _add_bench(commands)
    _add_stress(commands)
    _add_sweep(commands)
    _add_view(commands)
    _add_film(commands)
    _add_inspect(commands)
    _add_generate(commands)
    _add_export(commands)
    _add_depth(commands)
    _add_cache(commands)
    _add_backend_commands(commands)
    algorithms = commands.add_parser("algorithms", help="list the algorithms and their options")
    algorithms.set_defaults(run=_algorithms)
    settings = commands.add_parser("settings", help="list the inim.* settings of scene files")
    settings.set_defaults(run=_settings)
    return parser


def _add_validate(commands: Commands) -> None:
    parser = commands.add_parser(
        "validate",
        help="render a scene, generate its EIA with each algorithm, score every view",
        description="Render a scene, generate its elemental image array with each algorithm, "
        "look at it through the lens array, and score every view against the scene.",
        epilog=_EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "scene", type=Path, nargs="?", help="Mitsuba scene (.xml) with inim.* settings"
    )
    parser.add_argument(
        "-o", "--out", type=Path, help="folder for the report (default: SCENE-report)"
    )
    parser.add_argument(
        "-D",
        dest="definitions",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override an inim.* setting or a scene parameter; may be repeated",
    )
    parser.add_argument("--display", help="display preset: nominal or phone")
    parser.add_argument(
        "--algorithms",
        help="algorithms with options, separated by commas; see `inim algorithms`; "
        "'none' to score finished EIAs only",
    )
    parser.add_argument(
        "--eia",
        dest="eias",
        action="append",
        default=[],
        metavar="NAME=FILE",
        help="score a finished EIA, .png (sRGB) or .exr (linear), too; may be repeated",
    )
    parser.add_argument("--viewpoints", help="names, or 'name=x y [z]' in mm, separated by commas")
    parser.add_argument("--lens-model", help="lens model: pinhole, thin, thick or full")
    parser.add_argument(
        "--misalign",
        metavar="KEY=NUMBER,...",
        help="how far the array lies off what generators know, such as 'rotation_deg=0.5'",
    )
    parser.add_argument("--backend", default="auto", choices=("auto", "llvm", "cuda"))
    parser.add_argument(
        "--baseline",
        type=Path,
        metavar="DIR",
        help="compare with this baseline, made by `inim baseline accept`; a change fails",
    )
    parser.add_argument(
        "--time",
        action="store_true",
        help="time the generators in yardsticks, too; with --baseline, 15 %% slower fails",
    )
    parser.add_argument(
        "--lazy",
        action="store_true",
        help="make and render only the panel pixels that the viewpoints observe: the same scores "
        "of views, none of whole EIAs",
    )
    parser.add_argument(
        "--no-skip",
        action="store_true",
        help="do everything, also what changes no result, and use no store",
    )
    parser.add_argument("--quiet", action="store_true", help="print errors only")
    parser.add_argument("--debug", action="store_true", help="show tracebacks of internal errors")
    _add_picture(parser)
    parser.set_defaults(run=_validate)


def _add_picture(parser: argparse.ArgumentParser) -> None:
    from inim.commands.generate import add_picture_arguments

    picture = parser.add_argument_group(
        "in place of a scene",
        "A picture of your own: what can be scored without ground truth is, the rest says why not. "
        "Colour and depth as for `inim generate`, or what its --rgbd wrote; --display may be an "
        ".xml with inim.* settings.",
    )
    picture.add_argument("--rgbd", type=Path, metavar="FILE", help="fitted colour and depth, .exr")
    add_picture_arguments(picture)


def _validate_picture(args: argparse.Namespace) -> int:
    from inim.pipeline.own_picture import run_picture

    passed, out = run_picture(args)
    if not args.quiet:
        print(f"{'passed' if passed else 'FAILED'}; report: {out / 'report.html'}")
    return EXIT_PASSED if passed else EXIT_CHECK_FAILED


def _validate(args: argparse.Namespace) -> int:
    from inim.pipeline.request import Request, default_out
    from inim.worker.supervisor import run_in_worker

    # An asked-for end takes the worker and its half-written files along, as Ctrl-C does.
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    texts = (args.scene, args.out, *args.definitions, args.algorithms, *args.eias, args.viewpoints)
    for word in map(str, texts):
        if not word.isascii() and any("\ud800" <= c <= "\udfff" for c in word):
            raise UsageError(
                f"{word!a}: is no text in this locale ({sys.getfilesystemencoding()}); "
                "rename it, or set PYTHONUTF8=1"
            )
    if args.rgbd or args.color or args.depth:
        return _validate_picture(args)
    if args.scene is None:
        raise UsageError("validate: name a scene, or a picture with --rgbd, or --color and --depth")
    request = Request(
        scene=args.scene,
        out=args.out or default_out(args.scene),
        definitions=tuple(args.definitions),
        display=args.display,
        algorithms=args.algorithms,
        viewpoints=args.viewpoints,
        lens_model=args.lens_model,
        misalign=args.misalign,
        eias=tuple(args.eias),
        backend=args.backend,
        baseline=args.baseline,
        time=args.time,
        lazy=args.lazy,
        no_skip=args.no_skip,
    )
    passed = run_in_worker(request, quiet=args.quiet, debug=args.debug)
    if not args.quiet:
        verdict = f"{'passed' if passed else 'FAILED'}; report: {request.out / 'report.html'}"
        try:
            print(verdict, flush=True)
        except OSError:  # the reader left, or its disk is full; the verdict stands
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return EXIT_PASSED if passed else EXIT_CHECK_FAILED


def _add_baseline(commands: Commands) -> None:
    parser = commands.add_parser(
        "baseline",
        help="accept a report as what later runs are compared with",
        epilog=_EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    actions: Commands = parser.add_subparsers(required=True, metavar="accept")
    accept = actions.add_parser("accept", help="make a report the baseline of its scene")
    accept.add_argument("out", type=Path, metavar="OUT", help="folder of a report")
    accept.add_argument("--reason", required=True, help="why, in a line; kept in the baseline")
    accept.add_argument(
        "--to",
        type=Path,
        metavar="DIR",
        help="folder of the baseline (default: the one compared with, or reports/baselines/TITLE)",
    )
    accept.set_defaults(run=_accept)


def _accept(args: argparse.Namespace) -> int:
    from inim.pipeline.baseline import accept

    print(f"baseline: {accept(args.out, args.reason, args.to)}")
    return EXIT_PASSED


def _add_compare(commands: Commands) -> None:
    parser = commands.add_parser(
        "compare",
        help="compare two reports by statistics, as with a baseline",
        epilog=_EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("baseline", type=Path, metavar="OUT_A", help="folder of the report before")
    parser.add_argument("candidate", type=Path, metavar="OUT_B", help="folder of the report after")
    parser.add_argument("-o", "--out", type=Path, help="folder (default: compare)")
    parser.add_argument("--quiet", action="store_true", help="print errors only")
    parser.set_defaults(run=_compare)


def _compare(args: argparse.Namespace) -> int:
    from inim.commands.compare import compare_reports

    out = args.out or Path("compare")
    passed, lines = compare_reports(args.baseline, args.candidate, out)
    if not args.quiet:
        print("\n".join(lines))
        print(f"{'passed' if passed else 'FAILED'}; comparison: {out / 'compare.html'}")
    return EXIT_PASSED if passed else EXIT_CHECK_FAILED


def _add_new_scene(commands: Commands) -> None:
    from inim.commands import new_scene

    parser = commands.add_parser("new-scene", help="write a lit, fitted scene for a mesh")
    new_scene.add_arguments(parser)
    parser.set_defaults(run=new_scene.run)


def _add_bench(commands: Commands) -> None:
    from inim.commands import bench as command

    parser = commands.add_parser(
        "bench",
        help="time the algorithms against their error, in yardsticks",
        epilog=_EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_arguments(parser)
    parser.set_defaults(run=command.run)


def _add_inspect(commands: Commands) -> None:
    from inim.commands import inspect as command

    parser = commands.add_parser(
        "inspect",
        help="say what a display can do, before anything is rendered",
        epilog=_EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_arguments(parser)
    parser.set_defaults(run=command.run)


def _add_view(commands: Commands) -> None:
    from inim.commands import view

    parser = commands.add_parser(
        "view", help="see a report's panels, or any EIA, through the lens array in a browser"
    )
    view.add_arguments(parser)
    parser.set_defaults(run=view.run)


def _add_film(commands: Commands) -> None:
    from inim.commands import film as command

    parser = commands.add_parser("film", help="film a report's display with an eye that moves")
    command.add_arguments(parser)
    parser.set_defaults(run=command.run)


def _add_generate(commands: Commands) -> None:
    from inim.commands import generate

    parser = commands.add_parser(
        "generate", help="make an EIA of your own colour and depth picture"
    )
    generate.add_arguments(parser)
    parser.set_defaults(run=generate.run)


def _add_stress(commands: Commands) -> None:
    from inim.commands import stress as command

    parser = commands.add_parser(
        "stress",
        help="find where the numbers stop being trustworthy",
        epilog=_EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_arguments(parser)
    parser.set_defaults(run=command.run)


def _add_sweep(commands: Commands) -> None:
    from inim.commands import sweep as command

    parser = commands.add_parser(
        "sweep",
        help="validate a whole study: scenes x displays x algorithms x viewpoints x settings",
        epilog=_EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_arguments(parser)
    parser.set_defaults(run=command.run)


def _add_export(commands: Commands) -> None:
    from inim.commands import export

    parser = commands.add_parser("export", help="write an EIA's views: pictures, HCI, quilt")
    export.add_arguments(parser)
    parser.set_defaults(run=export.run)


def _add_depth(commands: Commands) -> None:
    from inim.commands import depth

    parser = commands.add_parser("depth", help="estimate the depth of a photograph")
    depth.add_arguments(parser)
    parser.set_defaults(run=depth.run)


def _add_cache(commands: Commands) -> None:
    from inim.commands import cache

    parser = commands.add_parser("cache", help="what the store of results holds; empty it")
    cache.add_arguments(parser)
    parser.set_defaults(run=cache.run)


def _add_backend_commands(commands: Commands) -> None:
    info = commands.add_parser("sys-info", help="what the renderer can run on here")
    info.add_argument("--json", action="store_true", help="as JSON")
    info.set_defaults(run=_sys_info)
    install = commands.add_parser("install-llvm", help="get a usable libLLVM, as root or not")
    install.set_defaults(run=_install_llvm)


def _sys_info(args: argparse.Namespace) -> int:
    from inim import backend

    print(json.dumps(backend.describe(), indent=1) if args.json else backend.sys_info())
    return EXIT_PASSED


def _install_llvm(_: argparse.Namespace) -> int:
    from inim.backend.install_llvm import install_llvm

    install_llvm()
    return EXIT_PASSED


def _algorithms(_: argparse.Namespace) -> int:
    from inim.pipeline.method import algorithm_table

    print(algorithm_table())
    return EXIT_PASSED


def _settings(_: argparse.Namespace) -> int:
    from inim.settings import setting_table

    print(setting_table())
    return EXIT_PASSED
