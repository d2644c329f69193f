"""`inim validate`, `demo`, `accept`, `compare` and `figure`: scored reports and their figures."""

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from inim.pipeline.options import (
    Command,
    add_shared,
    default_out,
    finish,
    open_page,
    opens_pages,
    print_lines,
    print_outcome,
    print_warning,
    request_of,
)
from inim.system.errors import EXIT_BASELINE, EXIT_PASSED, FileError, UsageError

if TYPE_CHECKING:
    from inim.report.document import ReportDocument
    from inim.scores.regression.document import CompareDocument


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Render a scene, generate its elemental image array (EIA) with each algorithm, simulate "
        "the views through the lens array, and score every view against the ground truth. A "
        "picture has no ground truth: the report omits these scores and lists the reason."
    )
    add = parser.add_argument
    add(
        "scene",
        type=Path,
        metavar="INPUT",
        help="Mitsuba scene (.xml) with inim.* settings, a mesh, or the fitted picture (.exr) of "
        "`inim generate --save-rgbd`",
    )
    choices = ("definitions", "display", "algorithms", "cameras", "viewpoints", "lens_model")
    add_shared(
        parser,
        *choices,
        "up",
        "front",
        "allow_folders",
        out="folder for the report (default: INPUT-report)",
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
        "--allow-changed-inputs",
        action="store_true",
        help="if inputs differ from the baseline's, scores may change",
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
    add_shared(parser, "json", "quiet", open="open the report in the browser")
    parser.set_defaults(explain_unknown=_check_kind)


def _run(args: argparse.Namespace) -> int:
    _check_encoding(args)
    _check_kind(args)
    args.quiet |= args.json
    code = _validate(args)
    if args.json:
        import json

        document = json.loads((args.out / "report.json").read_text("utf-8"))
        print_outcome(*json.dumps(document, indent=1).split("\n"))
    if args.open:
        open_page(args.out / "report.html")
    return code


def _check_kind(args: argparse.Namespace, unknown: Sequence[str] = ()) -> None:
    """Reject inputs that another command must convert to a scene or to an RGB-D picture.

    `unknown` are the unrecognized arguments, which may be options of a picture.
    """
    from inim.pipeline.plan import PICTURE_SUFFIX
    from inim.render.meshes.triangle_mesh import MESH_SUFFIXES

    is_read = args.scene.suffix.lower() in (".xml", PICTURE_SUFFIX, *MESH_SUFFIXES)
    if not is_read or any(word.startswith("--depth") for word in unknown):
        fitted = f"fitted{PICTURE_SUFFIX}"
        display = [word for text in args.definitions for word in ("-D", text)]
        display += ["--display", args.display] if args.display else []
        raise UsageError(
            f"{args.scene}: is not a scene (.xml) and not fitted to a display; fit it first: inim "
            f"generate {shlex.join([str(args.scene), *unknown, *display])} --save-rgbd {fitted}, "
            f"then inim validate {shlex.join([fitted, *display])}"
        )


# Warnings on the terminal; the report has all.
_MOST_WARNINGS = 3
_MOST_FILES = 3


def _finish(passed: bool, out: Path, quiet: bool) -> int:
    """Print warnings, failed checks, the verdict and the report's path; return the exit code."""
    from inim.report.comparison_text import comparison_lines
    from inim.report.document import ReportDocument
    from inim.report.labels import check_sentence, verdict_words
    from inim.system.document import read_document

    if passed and quiet:
        return EXIT_PASSED
    data = read_document(out / "report.json", "run it again", ReportDocument)
    failed = [check for check in data.verdict.failures if check.kind is None]
    lines = [] if data.scene is None else read_lines(data.scene.imports)
    lines += [f"warning: {text}" for text in data.warnings[:_MOST_WARNINGS]]
    if len(data.warnings) > _MOST_WARNINGS:
        lines.append(f"and {len(data.warnings) - _MOST_WARNINGS} more warnings in the report")
    lines += [f"failed: {check.name}: {check_sentence(check)}" for check in failed]
    lines += comparison_lines(data, out)
    lines.append(f"{verdict_words(data)}; report: {out / 'report.html'}")
    return _exit_code(data, finish(passed, *lines, quiet=quiet))


def read_lines(imports: Sequence[str]) -> list[str]:
    """A line on the files that a scene was read from, if it has any."""
    more = f" and {len(imports) - _MOST_FILES} more" * (len(imports) > _MOST_FILES)
    return [f"read {'; '.join(imports[:_MOST_FILES])}{more}"] if imports else []


def _exit_code(data: "ReportDocument | CompareDocument", code: int) -> int:
    """The exit code of a run, or that of a comparison in which nothing can be compared."""
    comparison = data.regression
    is_comparable = comparison is None or comparison.verdict != "not comparable"
    return code if is_comparable else EXIT_BASELINE


def _check_encoding(args: argparse.Namespace) -> None:
    """Reject names that cannot be encoded in this locale."""
    texts = (args.scene, args.out, *args.definitions, args.algorithms, *args.eias, args.viewpoints)
    for word in map(str, texts):
        if not word.isascii() and any("\ud800" <= c <= "\udfff" for c in word):
            raise UsageError(
                f"{word!a}: cannot be encoded in this locale ({sys.getfilesystemencoding()}); "
                "rename it, or set PYTHONUTF8=1"
            )


def _validate(args: argparse.Namespace) -> int:
    from inim.pipeline.launch import scene_and_out, validate_in_worker
    from inim.render.meshes.triangle_mesh import MESH_SUFFIXES

    axes = {name: getattr(args, name, None) for name in ("up", "front")}
    options: dict[str, Any] = {name: axis for name, axis in axes.items() if axis}
    if args.scene.suffix.lower() in MESH_SUFFIXES and not args.quiet:
        options["say"] = print_lines
    args.scene, args.out = scene_and_out(args.scene, args.out, options or None, print_warning)
    passed = validate_in_worker(
        lambda: request_of(args),
        args.scene,
        args.out,
        quiet=args.quiet,
        debug=args.debug,
    )
    return _finish(passed, args.out, args.quiet)


#: Fine lenses, and room for the head: a better first look than the display of the scene.
_DEMO_DISPLAY = "fine"


def _add_demo_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Validate the bundled amphora scene on the display `fine`, and print the addresses of its "
        "report and live display. On a terminal with a screen, the latter opens in the browser."
    )
    add_shared(parser, out="folder for the report (default: amphora-report)")


def _demo(args: argparse.Namespace) -> int:
    package = Path(__file__).resolve().parents[1]
    # In an installed package, or in a clone.
    scenes = [folder / "amphora.xml" for folder in (package / "demo", package.parent / "scenes")]
    args.scene, args.backend = next(filter(Path.is_file, scenes), None), "auto"
    args.display, args.quiet = _DEMO_DISPLAY, False
    if args.scene is None:
        raise FileError(f"{package / 'demo'}: missing; install inim again")
    code = _validate(args)
    from inim.report.virtual_display import ANCHOR

    page, anchor = args.out / "report.html", f"#{ANCHOR}"
    print_outcome(f"live display, to open in a browser: {page.resolve().as_uri()}{anchor}")
    if opens_pages():
        open_page(page, anchor)
    return code


def _add_accept_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = "Make a report the baseline of its scene."
    add = parser.add_argument
    add("report", type=Path, metavar="OUT", help="folder of a report")
    add("--reason", default="", help="reason in one line, stored in the baseline; required")
    out = "folder of the baseline (default: that of the comparison, or reports/baselines/TITLE)"
    add_shared(parser, out=out)


def _accept(args: argparse.Namespace) -> int:
    from inim.pipeline.baseline import accept
    from inim.report.comparison_text import accepted_lines

    lines = accepted_lines(args.report)
    print_lines(*lines, f"baseline: {accept(args.report, args.reason, args.out)}")
    return EXIT_PASSED


def _add_compare_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    parser.description = (
        "Compare reports. Each is compared with the first report of its title, or with the first "
        "of all if its title has no other. Several relics have a paired test."
    )
    add("baseline", type=Path, metavar="OUT_A", help="folder of the earlier report")
    add("candidates", type=Path, nargs="+", metavar="OUT_B", help="folders of later reports")
    add_shared(parser, "quiet", out="folder (default: OUT_A-compare)")


def _compare(args: argparse.Namespace) -> int:
    from inim.pipeline.compare import all_lines, compare_all

    out = args.out or default_out(args.baseline, "compare")
    pairs = compare_all([args.baseline, *args.candidates], out)
    place = out / "compare.html" if len(pairs) == 1 else out / "summary.md"
    passed = all(pair.data.verdict.passed for pair in pairs)
    code = finish(passed, *all_lines(pairs), f"comparison: {place}", quiet=args.quiet)
    return max(_exit_code(pair.data, code) for pair in pairs)


def _add_figure_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Draw a figure of reports: views of one viewpoint with magnified insets, error maps, "
        "scores with 95 % intervals, and run time against error."
    )
    parser.add_argument(
        "reports", nargs="+", type=Path, metavar="REPORT", help="folder of a report"
    )
    add_shared(parser, out="file to write: .pdf, .svg, .png or .eps (default: REPORT-figure.pdf)")
    parser.add_argument(
        "--parts",
        default="views,errors,scores,time",
        help="parts to draw, separated by commas (default: %(default)s)",
    )
    add_shared(
        parser,
        viewpoints="viewpoint of the views (default: centre)",
        algorithms="algorithms of the report, separated by commas (default: all)",
    )
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
    reports = [Report.load(folder) for folder in args.reports]
    if args.maps and len(reports) > 1:
        raise UsageError("--maps: give a single report, because the files are named by viewpoint")
    request = FigureRequest(
        tuple(part.strip() for part in args.parts.split(",") if part.strip()),
        args.viewpoints or "",
        algorithm_items(args.algorithms or ""),
        tuple(insets),
        args.width,
    )
    path = args.out or default_out(args.reports[0], "figure.pdf")
    with published_together():
        write_figure(reports, request, path)
        maps = write_error_maps(reports[0], request, args.maps) if args.maps else []
    print_outcome(f"figure: {path}")
    if maps:
        print_outcome(f"{len(maps)} error maps: {args.maps}")
    return EXIT_PASSED


COMMANDS = {
    "accept": Command(
        "accept a report as the baseline for later runs",
        _add_accept_arguments,
        _accept,
        "inim accept out/jade --reason 'first version'",
    ),
    "compare": Command(
        "compare reports statistically",
        _add_compare_arguments,
        _compare,
        "inim compare out/before out/after -o out/difference",
    ),
    "demo": Command(
        "validate the bundled amphora scene: start here",
        _add_demo_arguments,
        _demo,
        "inim demo -o out/amphora",
    ),
    "validate": Command(
        "render a scene, generate EIAs, and score every view",
        _add_arguments,
        _run,
        "inim validate scenes/jade.xml -o out/jade",
    ),
    "figure": Command(
        "draw a figure of a report for a paper",
        _add_figure_arguments,
        _figure,
        "inim figure out/jade -o jade.pdf --inset 0.45,0.4,0.15",
    ),
}
