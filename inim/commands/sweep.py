"""`inim sweep`: a whole study validated, into one table."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from inim import interruption
from inim.commands.options import (
    Command,
    add_allow_folder,
    add_exit_codes,
    add_quiet,
    print_outcome,
)
from inim.errors import EXIT_CHECK_FAILED, EXIT_PASSED

__all__ = ["COMMANDS"]


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    add_exit_codes(parser)
    parser.description = (
        "Validate all combinations of a study's scenes, displays, settings and algorithms, into "
        "one table. What is there already is not computed again: run it again after a kill, or "
        "with more in the study."
    )
    parser.add_argument("study", type=Path, help="the study (.toml), see docs/how-to/sweep.md")
    parser.add_argument("-o", "--out", type=Path, help="folder (default: STUDY-sweep)")
    parser.add_argument(
        "--scheduler",
        metavar="tcp://HOST:PORT",
        help="run on the workers of this dask scheduler, which share the folder",
    )
    parser.add_argument(
        "--workers", type=int, metavar="N", help="validations at once, here (one for each core)"
    )
    parser.add_argument(
        "--threads", type=int, metavar="T", help="threads of each (the cores there are for it)"
    )
    parser.add_argument(
        "--dry-run", action="store_true", help="say what is there and what would be run, and stop"
    )
    add_allow_folder(parser)
    add_quiet(parser)


def _run(args: argparse.Namespace) -> int:
    from inim.report.sweep import PAGE
    from inim.sweep.run import SweepRequest, plan_sweep, run_sweep
    from inim.worker.output import default_out

    request = SweepRequest(
        args.study,
        args.out or default_out(args.study, "sweep"),
        args.scheduler,
        args.workers,
        args.threads,
        tuple(args.allow_folders),
    )
    if args.dry_run:
        print("\n".join(plan_sweep(request).lines()))
        return EXIT_PASSED
    interruption.say("results are kept: run it again to go on")
    outcome = run_sweep(request, quiet=args.quiet, debug=args.debug)
    if args.quiet:  # else each was printed when it happened
        for label, error in outcome.failed.items():
            print(f"inim: failed: {label}: {error}", file=sys.stderr)
    else:
        words = f"{outcome.computed} of {outcome.units} validations run, {len(outcome.rows)} rows"
        verdict = "passed" if outcome.passed else "FAILED"
        print_outcome(f"{verdict}; {words}; sweep: {request.out / PAGE}")
    return EXIT_PASSED if outcome.passed else EXIT_CHECK_FAILED


COMMANDS = {
    "sweep": Command(
        "validate a whole study: scenes x displays x algorithms x viewpoints x settings",
        _add_arguments,
        _run,
    )
}
