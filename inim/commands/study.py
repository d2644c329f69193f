"""Commands `inim bench`, `stress`, `sweep` and `tolerate`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from inim.commands.options import (
    Command,
    add_allow_folder,
    add_choices,
    add_exit_codes,
    add_quiet,
    choices_of,
    print_outcome,
    print_warning,
)
from inim.errors import EXIT_CHECK_FAILED, EXIT_PASSED

if TYPE_CHECKING:
    from inim.sweep.run import SweepPlace


from inim.errors import UsageError

_KEPT = "results are kept; run it again to continue"


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    add_exit_codes(parser)
    parser.description = (
        "Validate all combinations of a study's scenes, displays, settings and algorithms, and "
        "write one table. Existing results are reused: run it again after a kill, or with a larger "
        "study."
    )
    parser.add_argument("study", type=Path, help="the study (.toml), see docs/how-to/sweep.md")
    parser.add_argument("-o", "--out", type=Path, help="folder (default: STUDY-sweep)")
    _add_place(parser)
    add_quiet(parser)


def _add_place(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--scheduler",
        metavar="tcp://HOST:PORT",
        help="run on the workers of this dask scheduler, which share the folder",
    )
    parser.add_argument(
        "--workers",
        type=int,
        metavar="N",
        help="simultaneous validations on this machine (one per core)",
    )
    parser.add_argument(
        "--threads", type=int, metavar="T", help="threads of each (its share of the cores)"
    )
    parser.add_argument(
        "--dry-run", action="store_true", help="list finished and remaining validations, and stop"
    )
    add_allow_folder(parser)


def _place(args: argparse.Namespace, scene: Path, kind: str) -> SweepPlace:
    from inim.sweep.run import SweepPlace
    from inim.worker.output import default_out

    return SweepPlace(
        args.out or default_out(scene, kind),
        args.scheduler,
        args.workers,
        args.threads,
        tuple(args.allow_folders),
    )


def _sweep(args: argparse.Namespace) -> int:
    from inim.report.sweep import PAGE
    from inim.sweep.run import SweepRequest, plan_study, run_sweep
    from inim.sweep.study import read_study

    request = SweepRequest(args.study, _place(args, args.study, "sweep"))
    if args.dry_run:
        print("\n".join(plan_study(read_study(request.study), request.place).lines()))
        return EXIT_PASSED
    with _results_kept():
        outcome = run_sweep(request, quiet=args.quiet, debug=args.debug)
    if args.quiet:  # otherwise each was printed immediately
        _print_failed(outcome.failed)
    else:
        words = f"{outcome.computed} of {outcome.units} validations run, {len(outcome.rows)} rows"
        verdict = "passed" if outcome.passed else "FAILED"
        print_outcome(f"{verdict}; {words}; sweep: {request.place.out / PAGE}")
    return EXIT_PASSED if outcome.passed else EXIT_CHECK_FAILED


@contextmanager
def _results_kept() -> Iterator[None]:
    """Add to the message of an interrupt that finished validations are kept."""
    try:
        yield
    except KeyboardInterrupt as interrupt:
        interrupt.args += (_KEPT,)
        raise


def _print_failed(failed: Mapping[str, str]) -> None:
    for label, error in failed.items():
        print_warning(f"{label}: {error}", "failed")


def _add_tolerance_arguments(parser: argparse.ArgumentParser) -> None:
    add_exit_codes(parser)
    parser.description = (
        "Compute the tolerances of pitch, gap, rotation, shift and tilt: draw misaligned displays "
        "at random, and show the EIA of the design on each. Existing results are reused."
    )
    parser.add_argument("scene", type=Path, help="Mitsuba scene (.xml)")
    parser.add_argument("-o", "--out", type=Path, help="folder (default: SCENE-tolerate)")
    parser.add_argument(
        "--study",
        type=Path,
        metavar="FILE",
        help="distributions of the errors (.toml), see docs/how-to/tolerate.md",
    )
    add_choices(parser, "definitions", "display", "viewpoints")
    parser.add_argument(
        "-a",
        "--algorithms",
        default="pickup",
        help="one algorithm for the EIA (pickup: the ray-traced EIA)",
    )
    parser.add_argument(
        "--criterion",
        type=float,
        default=0.01,
        metavar="LOSS",
        help="largest tolerated loss of SSIM on the relic to the reference (0.01)",
    )
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="FILE",
        help="calibration.json whose accuracy is compared with the tolerances",
    )
    _add_place(parser)
    add_quiet(parser)


def _tolerate(args: argparse.Namespace) -> int:
    from inim.pipeline.request import Request
    from inim.report.tolerate import PAGE, sentences
    from inim.tolerate.run import ToleranceRequest, plan_tolerance, run_tolerance

    place = _place(args, args.scene, "tolerate")
    validation = Request(
        args.scene, place.out, allow_folders=place.allow_folders, **choices_of(args)
    )
    request = ToleranceRequest(validation, place, args.study, args.criterion, args.calibration)
    if args.dry_run:
        print("\n".join(plan_tolerance(request).lines()))
        return EXIT_PASSED
    with _results_kept():
        document = run_tolerance(request, quiet=args.quiet, debug=args.debug)
    failed = {display.display: display.error for display in document.failed}
    if args.quiet:
        _print_failed(failed)
    else:
        print("\n".join(sentences(document)))
        print_outcome(f"tolerances: {request.place.out / PAGE}")
    return EXIT_CHECK_FAILED if failed else EXIT_PASSED


def _add_bench_arguments(parser: argparse.ArgumentParser) -> None:
    add_exit_codes(parser)
    parser.description = (
        "Time each algorithm on a scene's display-ready picture and compare time with error. All "
        "run alternately with a reference kernel of one 4-byte gather per display pixel; times are "
        "also given as multiples of its time."
    )
    parser.add_argument("scene", type=Path, help="Mitsuba scene (.xml)")
    parser.add_argument("-o", "--out", type=Path, help="folder (default: SCENE-bench)")
    add_choices(parser, "definitions", "display", "algorithms")
    add_allow_folder(parser)
    parser.add_argument("--runs", type=int, default=9, metavar="N", help="timed runs (9)")
    parser.add_argument("--warmups", type=int, default=2, metavar="N", help="runs before (2)")
    parser.add_argument("--threads", type=int, metavar="T", help="threads to time with (all)")
    add_quiet(parser)


def _bench(args: argparse.Namespace) -> int:
    from inim.bench.job import BenchRequest, run_bench
    from inim.pipeline.request import Request
    from inim.timing import Rounds
    from inim.worker.output import default_out

    validation = Request(
        args.scene,
        args.out or default_out(args.scene, "bench"),
        allow_folders=tuple(args.allow_folders),
        **choices_of(args),
    )
    request = BenchRequest(validation, Rounds(args.runs, args.warmups, args.threads))
    run_bench(request, quiet=args.quiet, debug=args.debug)
    if not args.quiet:
        print_outcome(f"bench: {validation.out / 'bench.html'}")
    return EXIT_PASSED


def _add_stress_arguments(parser: argparse.ArgumentParser) -> None:
    add_exit_codes(parser)
    parser.description = (
        "Compare algorithms, also from other packages, with exact first hits and with relations "
        "that hold for every correct result; measure the effect of small depth errors."
    )
    parser.add_argument(
        "scene",
        type=Path,
        nargs="?",
        help="Mitsuba scene (.xml) whose depth is jittered; two synthetic spheres otherwise",
    )
    parser.add_argument("-o", "--out", type=Path, help="folder (default: SCENE-stress)")
    add_choices(parser, "definitions", "algorithms")
    add_allow_folder(parser)
    parser.add_argument("--quick", action="store_true", help="fewer and smaller cases")
    add_quiet(parser)


def _stress(args: argparse.Namespace) -> int:
    from inim.pipeline.request import Request
    from inim.stress.job import StressRequest, run_stress
    from inim.worker.output import default_out

    if args.scene is None and args.definitions:
        raise UsageError("stress: -D belongs to a scene; name one")
    out, choices = args.out or default_out(args.scene, "stress"), choices_of(args)
    allowed = tuple(args.allow_folders)
    request = StressRequest(
        out,
        choices.pop("algorithms", None),
        args.quick,
        args.scene and Request(args.scene, out, allow_folders=allowed, **choices),
    )
    passed = run_stress(request, quiet=args.quiet, debug=args.debug)
    if not args.quiet:
        print_outcome(f"{'passed' if passed else 'FAILED'}; {request.out / 'stress.html'}")
    return EXIT_PASSED if passed else EXIT_CHECK_FAILED


COMMANDS = {
    "bench": Command("time algorithms and compare time with error", _add_bench_arguments, _bench),
    "stress": Command("test algorithms for numerical stability", _add_stress_arguments, _stress),
    "sweep": Command(
        "validate all combinations of scenes, displays, algorithms and settings",
        _add_arguments,
        _sweep,
    ),
    "tolerate": Command(
        "compute the tolerances of pitch, gap, rotation, shift and tilt",
        _add_tolerance_arguments,
        _tolerate,
    ),
}
