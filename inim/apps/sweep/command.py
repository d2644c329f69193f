"""Command `inim sweep`."""

import argparse
from pathlib import Path

from inim.pipeline.options import (
    Command,
    add_shared,
    default_out,
    finish,
    print_lines,
    print_warning,
)
from inim.system.errors import EXIT_PASSED

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
        help="use the workers of this dask scheduler; each must have access to the scenes",
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
    add_shared(parser, "allow_folders", "quiet")


def _sweep(args: argparse.Namespace) -> int:
    from inim.apps.sweep.page import PAGE
    from inim.apps.sweep.run import SweepPlace, plan_study, run_sweep
    from inim.apps.sweep.study import read_study
    from inim.system.cache import store_folder

    place = SweepPlace(
        args.out or default_out(args.study, "sweep"),
        args.scheduler,
        args.workers,
        args.threads,
        tuple(args.allow_folders),
    )
    if args.dry_run:
        print_lines(*plan_study(read_study(args.study), place).lines())
        return EXIT_PASSED
    try:
        result = run_sweep(args.study, place, args.command_line, quiet=args.quiet, debug=args.debug)
    except KeyboardInterrupt as interrupt:
        if store_folder() is not None:
            interrupt.args += (_KEPT,)
        raise
    if args.quiet:  # otherwise each was printed immediately
        for label, error in result.failed.items():
            print_warning(f"{label}: {error}", "failed")
    return finish(
        result.passed,
        f"{'passed' if result.passed else 'FAILED'}; {result.computed} of {result.validations} "
        f"validations run, {result.rows} rows; sweep: {place.out / PAGE}",
        quiet=args.quiet,
    )


COMMANDS = {
    "sweep": Command(
        "validate all combinations of scenes, displays, algorithms and settings",
        _add_sweep_arguments,
        _sweep,
        "inim sweep scenes/study.toml -o out/study --dry-run",
    ),
}
