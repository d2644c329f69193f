"""`inim bench` and `inim stress`: the algorithms timed against their error, and put to the test."""

from __future__ import annotations

import argparse
from pathlib import Path

from inim.commands.options import (
    Command,
    add_allow_folder,
    add_choices,
    add_exit_codes,
    add_quiet,
    choices_of,
    print_outcome,
)
from inim.errors import EXIT_CHECK_FAILED, EXIT_PASSED, UsageError


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
}
