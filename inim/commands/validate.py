"""`inim validate`: a scene, or a picture of the user's own, becomes a scored report."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from inim.commands.options import (
    Command,
    add_allow_folder,
    add_choices,
    add_exit_codes,
    add_picture,
    add_quiet,
    choices_of,
    picture_of,
    print_outcome,
    print_warning,
)
from inim.errors import EXIT_CHECK_FAILED, EXIT_PASSED, FileError, UsageError

if TYPE_CHECKING:
    from inim.pipeline.request import Request


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Render a scene, generate its elemental image array with each algorithm, "
        "look at it through the lens array, and score every view against the scene."
    )
    add_exit_codes(parser)
    add = parser.add_argument
    add("scene", type=Path, nargs="?", help="Mitsuba scene (.xml) with inim.* settings")
    add("-o", "--out", type=Path, help="folder for the report (default: SCENE-report)")
    add_choices(parser)
    add_allow_folder(parser)
    add(
        "--eia",
        dest="eias",
        action="append",
        default=[],
        metavar="NAME=FILE",
        help="score a finished EIA, .png (sRGB) or .exr (linear), too, or with "
        "`--algorithms none` only; may be repeated",
    )
    add("--backend", default="auto", choices=("auto", "llvm", "cuda"))
    add(
        "--baseline",
        type=Path,
        metavar="DIR",
        help="compare with this baseline, made by `inim baseline accept`; a change fails",
    )
    _add_preview(parser)
    add(
        "--time",
        action="store_true",
        help="time the generators in yardsticks, too; with --baseline, 15 %% slower fails",
    )
    add(
        "--lazy",
        action="store_true",
        help="make and render only the panel pixels that the viewpoints observe: the same scores "
        "of views, none of whole EIAs",
    )
    add(
        "--no-skip",
        action="store_true",
        help="do everything, also what changes no result, and use no store",
    )
    add_quiet(parser)
    picture = parser.add_argument_group(
        "in place of a scene",
        "A picture of your own: what can be scored without ground truth is, the rest says why not. "
        "Colour and depth as for `inim generate`, or what its --rgbd wrote; --display may be an "
        ".xml with inim.* settings.",
    )
    picture.add_argument("--rgbd", type=Path, metavar="FILE", help="fitted colour and depth, .exr")
    picture.add_argument("--photo", type=Path, metavar="FILE", help="a photo with depth inside")
    add_picture(picture)


def _add_preview(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--preview",
        action="store_true",
        help="a first look in seconds: template alone, from the centre, by few samples; -D and "
        "the options above override it",
    )


def _run(args: argparse.Namespace) -> int:
    _check_words(args)
    if args.rgbd or args.color or args.depth or args.photo:
        passed, out = _validate_picture(args)
    elif args.scene is None:
        raise UsageError(
            "validate: name a scene, or a picture with --photo, --rgbd, or --color and --depth"
        )
    else:
        passed, out = _validate_scene(args)
    return _ended(passed, out, args.quiet)


def _ended(passed: bool, out: Path, quiet: bool) -> int:
    """Print the verdict and the report's path; return the exit code."""
    if not quiet:
        print_outcome(f"{_words(passed, out)}; report: {out / 'report.html'}")
    return EXIT_PASSED if passed else EXIT_CHECK_FAILED


def _words(passed: bool, out: Path) -> str:
    """The verdict as its report has it; "FAILED" stands out, below the checks that did."""
    from inim.documents import read_document
    from inim.documents.picture import PictureDocument
    from inim.documents.report import ReportDocument
    from inim.report.wording import check_sentence, verdict_words

    types = ReportDocument, PictureDocument
    data = read_document(out / "report.json", "run it again", *types)
    assert isinstance(data, types)
    if passed:
        return verdict_words(data)
    failed = [check for check in data.verdict.checks if not check.passed]
    lines = [f"failed: {check.name}: {check_sentence(check)}" for check in failed]
    return "\n".join([*lines, "FAILED"])


def _check_words(args: argparse.Namespace) -> None:
    """Bytes that are no text in this locale cannot go into a report."""
    texts = (args.scene, args.out, *args.definitions, args.algorithms, *args.eias, args.viewpoints)
    for word in map(str, texts):
        if not word.isascii() and any("\ud800" <= c <= "\udfff" for c in word):
            raise UsageError(
                f"{word!a}: is no text in this locale ({sys.getfilesystemencoding()}); "
                "rename it, or set PYTHONUTF8=1"
            )


def _validate_scene(args: argparse.Namespace) -> tuple[bool, Path]:
    from inim.files.triangle_mesh import MESH_SUFFIXES
    from inim.worker.output import default_out

    if args.scene.suffix.lower() in MESH_SUFFIXES and args.scene.is_file():
        raise UsageError(
            f"{args.scene}: is a mesh; make a scene of it first: inim new-scene "
            f"{shlex.quote(str(args.scene))}"
        )
    args.out = args.out or default_out(args.scene, "report")
    return _validated(args, _request), args.out


def _request(args: argparse.Namespace) -> Request:
    from inim.pipeline.request import Request
    from inim.pipeline.stages.method import parse_eias

    return Request(
        args.scene,
        args.out,
        parse_eias(args.eias),
        args.backend,
        args.baseline,
        args.preview,
        args.time,
        args.lazy,
        args.no_skip,
        tuple(args.allow_folders),
        **choices_of(args),
    )


def _validated(
    args: argparse.Namespace, request_of: Callable[[argparse.Namespace], Request]
) -> bool:
    """Validate `args.scene` into `args.out`; whether every check passed."""
    from inim.pipeline.launch import validate_in_worker

    return validate_in_worker(
        lambda: request_of(args),
        args.scene,
        args.out,
        backend=args.backend,
        quiet=args.quiet,
        debug=args.debug,
    )


def _validate_picture(args: argparse.Namespace) -> tuple[bool, Path]:
    from inim.views.own_picture import PictureRequest, ignore_message, run_picture

    if args.scene is not None:
        raise UsageError(f"{args.scene}: a scene and a picture; validate one of them")
    if args.rgbd is not None and (args.color or args.depth or args.photo):
        raise UsageError(
            "--rgbd: is a fitted picture; leave --color, --depth and --photo out, or --rgbd"
        )
    for option in ("eias", "misalign", "baseline", "preview", "time", "lazy", "allow_folders"):
        if getattr(args, option):
            option_name = f"--{option.removesuffix('s').replace('_', '-')}"
            raise UsageError(f"{option_name}: needs the ground truth of a scene; leave it out")
    request = PictureRequest(
        picture_of(args), args.rgbd, args.out, args.backend, **choices_of(args)
    )
    on_warning = ignore_message if args.quiet else print_warning
    on_note = ignore_message if args.quiet else print
    return run_picture(
        request, quiet=args.quiet, debug=args.debug, on_warning=on_warning, on_note=on_note
    )


def _add_demo_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = "Validate the amphora that comes with inim, and say where its report lies."
    add_exit_codes(parser)
    parser.add_argument("-o", "--out", type=Path, help="folder for the report (amphora-report)")
    _add_preview(parser)
    add_quiet(parser)


def _demo(args: argparse.Namespace) -> int:
    from inim.worker.output import default_out

    args.scene, args.backend = _demo_scene(), "auto"
    args.out = args.out or default_out(args.scene, "report")
    return _ended(_validated(args, _demo_request), args.out, args.quiet)


def _demo_request(args: argparse.Namespace) -> Request:
    from inim.pipeline.request import Request

    return Request(args.scene, args.out, preview=args.preview)


def _demo_scene() -> Path:
    """Scene of the demo, in an installed package or in a clone."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "demo", package.parent / "scenes"):
        if (folder / "amphora.xml").is_file():
            return folder / "amphora.xml"
    raise FileError(f"{package / 'demo'}: the amphora is not there; install inim again")


COMMANDS = {
    "demo": Command(
        "validate the amphora that comes with inim: the first thing to type",
        _add_demo_arguments,
        _demo,
    ),
    "validate": Command(
        "render a scene, generate its EIA with each algorithm, score every view",
        _add_arguments,
        _run,
    ),
}
