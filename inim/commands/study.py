"""Commands `inim bench`, `stress` and `sweep`."""

from __future__ import annotations

import argparse
from pathlib import Path

from inim.commands import Command, add_shared, finish, print_warning, request_of
from inim.errors import EXIT_PASSED, UsageError

_KEPT = "results are kept; run it again to continue"


def _add_sweep_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Validate all combinations of a study's scenes, displays, settings and algorithms, and "
        "write one table. Existing results are reused, so the command can be repeated after an "
        "interruption or with a larger study."
    )
    parser.add_argument(
        "study", type=Path, metavar="STUDY", help="study (.toml); docs/how-to/sweep.md describes it"
    )
    add_shared(parser, out="folder for the results (default: STUDY-sweep)")
    parser.add_argument(
        "--scheduler",
        metavar="tcp://HOST:PORT",
        help="use the workers of this dask scheduler; each must have access to the folder",
    )
    parser.add_argument(
        "--workers",
        type=int,
        metavar="N",
        help="simultaneous validations on this machine (default: one per core)",
    )
    parser.add_argument(
        "--threads", type=int, metavar="T", help="threads per validation (default: cores / workers)"
    )
    parser.add_argument(
        "--dry-run",
        action="store_true",
        help="only list the finished and the remaining validations",
    )
    add_shared(parser, "allow_folders", "quiet", "debug")


def _sweep(args: argparse.Namespace) -> int:
    from inim.report.sweep import PAGE
    from inim.sweeps import SweepPlace, plan_study, run_sweep
    from inim.sweeps.study import read_study
    from inim.worker.output import default_out

    place = SweepPlace(
        args.out or default_out(args.study, "sweep"),
        args.scheduler,
        args.workers,
        args.threads,
        tuple(args.allow_folders),
    )
    if args.dry_run:
        print("\n".join(plan_study(read_study(args.study), place).lines()))
        return EXIT_PASSED
    try:
        result = run_sweep(args.study, place, args.command_line, quiet=args.quiet, debug=args.debug)
    except KeyboardInterrupt as interrupt:
        interrupt.args += (_KEPT,)
        raise
    if args.quiet:  # otherwise each was printed immediately
        for label, error in result.failed.items():
            print_warning(f"{label}: {error}", "failed")
    return finish(
        result.passed,
        f"{'passed' if result.passed else 'FAILED'}; {result.computed} of {result.units} "
        f"validations run, {len(result.rows)} rows; sweep: {place.out / PAGE}",
        quiet=args.quiet,
    )


def _add_bench_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Time each algorithm on a scene's display-ready picture and compare time with error. All "
        "algorithms run alternately with a reference kernel: one 4-byte gather per panel pixel. "
        "Times are given in milliseconds and as multiples of the kernel's time."
    )
    shared = ("definitions", "display", "algorithms", "allow_folders", "quiet", "debug")
    add_shared(parser, "scene", *shared, out="folder (default: SCENE-bench)")
    parser.add_argument("--runs", type=int, default=9, metavar="N", help="timed runs (default: 9)")
    parser.add_argument(
        "--warmups", type=int, default=2, metavar="N", help="untimed runs before them (default: 2)"
    )
    parser.add_argument(
        "--threads", type=int, metavar="T", help="threads per algorithm (default: all)"
    )


def _bench(args: argparse.Namespace) -> int:
    from inim.bench import BenchRequest, run_bench
    from inim.timing import Rounds
    from inim.worker.output import default_out

    args.out = args.out or default_out(args.scene, "bench")
    rounds = Rounds(args.runs, args.warmups, args.threads)
    request = BenchRequest(request_of(args), rounds, args.command_line)
    run_bench(request, quiet=args.quiet, debug=args.debug)
    return finish(True, f"bench: {args.out / 'bench.html'}", quiet=args.quiet)


def _add_stress_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Compare algorithms, also from other packages, with exact first hits and with relations "
        "that hold for every correct result; measure the effect of small depth errors."
    )
    parser.add_argument(
        "scene",
        type=Path,
        nargs="?",
        help="Mitsuba scene (.xml) whose depth is changed (default: two synthetic spheres)",
    )
    shared = ("definitions", "algorithms", "allow_folders", "quiet", "debug")
    add_shared(parser, *shared, out="folder (default: SCENE-stress)")
    parser.add_argument("--quick", action="store_true", help="fewer and smaller cases")


def _stress(args: argparse.Namespace) -> int:
    from inim.stress import StressRequest, run_stress
    from inim.worker.output import default_out

    if args.scene is None and args.definitions:
        raise UsageError("stress: -D belongs to a scene; name one")
    args.out = args.out or default_out(args.scene, "stress")
    validation = request_of(args)
    request = StressRequest(
        args.out,
        validation.algorithms,
        args.quick,
        None if args.scene is None else validation,
        args.command_line,
    )
    passed = run_stress(request, quiet=args.quiet, debug=args.debug)
    verdict = "passed" if passed else "FAILED"
    return finish(passed, f"{verdict}; {args.out / 'stress.html'}", quiet=args.quiet)


COMMANDS = {
    "bench": Command("time algorithms and compare time with error", _add_bench_arguments, _bench),
    "stress": Command("test algorithms for numerical stability", _add_stress_arguments, _stress),
    "sweep": Command(
        "validate all combinations of scenes, displays, algorithms and settings",
        _add_sweep_arguments,
        _sweep,
    ),
}
