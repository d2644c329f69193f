"""`inim validate`, `demo`, `accept`, `compare` and `figure`: scored reports and their figures."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path

from inim.apps.own_picture.options import add_picture, classify_input, picture_of
from inim.pipeline.options import (
    Command,
    add_shared,
    choices_of,
    finish,
    print_lines,
    print_outcome,
    print_warning,
    request_of,
)
from inim.system.errors import EXIT_PASSED, FileError, UsageError
from inim.system.files import check_file


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Render a scene, generate its elemental image array (EIA) with each algorithm, simulate "
        "the views through the lens array, and score every view against the ground truth."
    )
    add = parser.add_argument
    add(
        "input",
        type=Path,
        metavar="INPUT",
        help="Mitsuba scene (.xml) with inim.* settings, or a picture of your own (see below)",
    )
    choices = ("definitions", "display", "algorithms", "cameras", "viewpoints", "lens_model")
    add_shared(
        parser, *choices, "allow_folders", out="folder for the report (default: INPUT-report)"
    )
    add(
        "--eia",
        dest="eias",
        action="append",
        default=[],
        metavar="NAME=FILE",
        help="also score an existing EIA, .png (sRGB) or .exr (linear); add `--algorithms none` to "
        "score nothing else; may be repeated",
    )
    add(
        "--backend",
        default="auto",
        choices=("auto", "llvm", "cuda"),
        help="renderer backend (auto: CUDA if it works, otherwise LLVM)",
    )
    add(
        "--baseline",
        type=Path,
        metavar="DIR",
        help="compare with this baseline from `inim accept`; a significant change fails the run",
    )
    add(
        "--plugin",
        dest="plugins",
        action="append",
        default=[],
        metavar="MODULE",
        help="import this module, a name or a .py file, which registers Mitsuba plugins of the "
        "scene; may be repeated",
    )
    add_shared(parser, "preview")
    add(
        "--time",
        action="store_true",
        help="also time the algorithms, as multiples of the reference kernel's time",
    )
    add(
        "--lazy",
        action="store_true",
        help="generate only the panel pixels that the viewpoints see; the scores of views do not "
        "change, and EIAs get none",
    )
    add(
        "--no-skip",
        action="store_true",
        help="ignore the cache, and also run steps that cannot change a result",
    )
    add_shared(parser, "quiet", "debug")
    picture = parser.add_argument_group(
        "pictures of your own",
        "INPUT is a colour picture with --depth, a photograph that contains depth, or the output\n"
        "of `inim generate --save-rgbd` (.exr). Scores that need a scene are omitted; the report\n"
        "lists them with the reason.",
    )
    add_picture(picture)


def _run(args: argparse.Namespace) -> int:
    _check_encoding(args)
    classify_input(args)
    if args.light_field is not None or (args.photo is not None and args.photo.is_dir()):
        raise UsageError(f"{args.input}: is a folder; give a scene (.xml) or a picture")
    if args.cameras_file is not None:
        raise UsageError(
            f"{args.input}: has several cameras; merge them first: inim generate {args.input} "
            "--save-rgbd merged.exr, then inim validate merged.exr -a layered"
        )
    if args.mesh is not None:
        check_file(args.mesh)
        raise UsageError(
            f"{args.mesh}: is a mesh; create a scene from it first: inim new-scene "
            f"{shlex.quote(str(args.mesh))}"
        )
    return _validate_scene(args) if args.scene else _validate_picture(args)


# Warnings on the terminal; the report has all.
_MOST_WARNINGS = 3


def _finish(passed: bool, out: Path, quiet: bool) -> int:
    """Print warnings, failed checks, the verdict and the report's path; return the exit code."""
    from inim.report.document import ReportDocument
    from inim.report.labels import check_sentence, verdict_words
    from inim.report.picture_document import PictureDocument
    from inim.system.document import read_document

    lines, verdict = [], "FAILED"
    if not quiet:
        types = ReportDocument, PictureDocument
        data = read_document(out / "report.json", "run it again", *types)
        assert isinstance(data, types)
        if passed:
            verdict = verdict_words(data)
        failed = [check for check in data.verdict.checks if not (passed or check.passed)]
        lines = [f"warning: {text}" for text in data.warnings[:_MOST_WARNINGS]]
        if len(data.warnings) > _MOST_WARNINGS:
            lines.append(f"and {len(data.warnings) - _MOST_WARNINGS} more warnings in the report")
        lines += [f"failed: {check.name}: {check_sentence(check)}" for check in failed]
    lines.append(f"{verdict}; report: {out / 'report.html'}")
    return finish(passed, *lines, quiet=quiet)


def _check_encoding(args: argparse.Namespace) -> None:
    """Reject names that cannot be encoded in this locale."""
    texts = (args.input, args.out, *args.definitions, args.algorithms, *args.eias, args.viewpoints)
    for word in map(str, texts):
        if not word.isascii() and any("\ud800" <= c <= "\udfff" for c in word):
            raise UsageError(
                f"{word!a}: cannot be encoded in this locale ({sys.getfilesystemencoding()}); "
                "rename it, or set PYTHONUTF8=1"
            )


def _validate_scene(args: argparse.Namespace) -> int:
    from inim.pipeline.launch import validate_in_worker
    from inim.system.worker.output import default_out

    args.out = args.out or default_out(args.scene, "report")
    passed = validate_in_worker(
        lambda: request_of(args),
        args.scene,
        args.out,
        quiet=args.quiet,
        debug=args.debug,
    )
    return _finish(passed, args.out, args.quiet)


def _validate_picture(args: argparse.Namespace) -> int:
    from inim.apps.own_picture.validate_picture import PictureRequest, run_picture
    from inim.system.worker.output import default_out

    for option in ("eias", "baseline", "preview", "time", "lazy", "allow_folders", "plugins"):
        if getattr(args, option):
            option_name = f"--{option.removesuffix('s').replace('_', '-')}"
            raise UsageError(f"{option_name}: needs the ground truth of a scene; leave it out")
    request = PictureRequest(
        args.input,
        args.out or default_out(args.input, "report"),
        None if args.fitted else picture_of(args),
        args.backend,
        args.command_line,
        **choices_of(args),
    )
    passed = run_picture(
        request,
        quiet=args.quiet,
        debug=args.debug,
        on_warning=None if args.quiet else print_warning,
        on_note=None if args.quiet else print_lines,
    )
    return _finish(passed, request.out, args.quiet)


#: Fine lenses, and room for the head: a better first look than the display of the scene.
_DEMO_DISPLAY = "fine"


def _add_demo_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Validate the bundled amphora scene on the display `fine`, and print the addresses of its "
        "report and live display. In a terminal, the latter opens in the browser, if there is one."
    )
    add_shared(parser, "preview", "quiet", "debug", out="folder for the report (amphora-report)")


def _demo(args: argparse.Namespace) -> int:
    package = Path(__file__).resolve().parents[1]
    # In an installed package, or in a clone.
    scenes = [folder / "amphora.xml" for folder in (package / "demo", package.parent / "scenes")]
    args.scene, args.backend = next(filter(Path.is_file, scenes), None), "auto"
    args.display = _DEMO_DISPLAY
    if args.scene is None:
        raise FileError(f"{package / 'demo'}: missing; install inim again")
    code = _validate_scene(args)
    if not args.quiet:
        from inim.report.virtual_display import ANCHOR

        page = f"{(args.out / 'report.html').resolve().as_uri()}#{ANCHOR}"
        print_outcome(f"live display, to open in a browser: {page}")
        if sys.stdout.isatty():
            import webbrowser

            webbrowser.open(page)
    return code


def _add_accept_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = "Make a report the baseline of its scene."
    add = parser.add_argument
    add("out", type=Path, metavar="OUT", help="folder of a report")
    add("--reason", default="", help="reason in one line, stored in the baseline; required")
    add(
        "--to",
        type=Path,
        metavar="DIR",
        help="folder of the baseline (default: that of the comparison, or reports/baselines/TITLE)",
    )


def _accept(args: argparse.Namespace) -> int:
    from inim.pipeline.baseline import accept

    print_lines(f"baseline: {accept(args.out, args.reason, args.to)}")
    return EXIT_PASSED


def _add_compare_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("baseline", type=Path, metavar="OUT_A", help="folder of the earlier report")
    add("candidate", type=Path, metavar="OUT_B", help="folder of the later report")
    add_shared(parser, "quiet", out="folder (default: compare)")


def _compare(args: argparse.Namespace) -> int:
    from inim.pipeline.baseline import compare_reports

    out = args.out or Path("compare")
    passed, lines = compare_reports(args.baseline, args.candidate, out)
    lines.append(f"{'passed' if passed else 'FAILED'}; comparison: {out / 'compare.html'}")
    return finish(passed, *lines, quiet=args.quiet)


def _add_figure_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Draw a figure of a report: views of one viewpoint with magnified insets, error maps, "
        "scores with 95 % intervals, and run time against error."
    )
    parser.add_argument("report", type=Path, metavar="REPORT", help="folder of a report")
    add_shared(parser, out="file to write: .pdf, .svg, .png or .eps (default: figure.pdf)")
    parser.add_argument(
        "--parts",
        default="views,errors,scores,time",
        help="parts to draw, separated by commas (default: %(default)s)",
    )
    parser.add_argument("--viewpoint", default="", help="viewpoint of the views (default: centre)")
    add_shared(parser, algorithms="algorithms of the report, separated by commas (default: all)")
    parser.add_argument(
        "--inset",
        action="append",
        default=[],
        metavar="X,Y,SIDE",
        help="square to magnify: centre and side as fractions of the view's width; may be repeated",
    )
    parser.add_argument(
        "--width",
        type=float,
        default=180.0,
        help="width of the figure in mm (default: %(default)g)",
    )
    parser.add_argument(
        "--maps", type=Path, metavar="DIR", help="also write the error maps of all views as EXR"
    )


def _figure(args: argparse.Namespace) -> int:
    from inim.generators import algorithm_items
    from inim.report import Report
    from inim.report.figure import FigureRequest, Inset, write_error_maps, write_figure
    from inim.system.process.atomic_file import published_together

    insets = []
    for text in args.inset:
        try:
            insets.append(Inset(*map(float, text.split(","))))
        except (TypeError, ValueError):
            raise UsageError(f"--inset {text}: write X,Y,SIDE, such as 0.5,0.4,0.2") from None
    report = Report.load(args.report)
    request = FigureRequest(
        tuple(part.strip() for part in args.parts.split(",") if part.strip()),
        args.viewpoint,
        algorithm_items(args.algorithms or ""),
        tuple(insets),
        args.width,
    )
    path = args.out or Path("figure.pdf")
    with published_together():
        write_figure(report, request, path)
        maps = write_error_maps(report, request, args.maps) if args.maps else []
    print_outcome(f"figure: {path}")
    if maps:
        print_outcome(f"{len(maps)} error maps: {args.maps}")
    return EXIT_PASSED


COMMANDS = {
    "accept": Command(
        "accept a report as the baseline for later runs", _add_accept_arguments, _accept
    ),
    "compare": Command("compare two reports statistically", _add_compare_arguments, _compare),
    "demo": Command("validate the bundled amphora scene: start here", _add_demo_arguments, _demo),
    "validate": Command(
        "render a scene, generate EIAs, and score every view", _add_arguments, _run
    ),
    "figure": Command("draw a figure of a report for a paper", _add_figure_arguments, _figure),
}
