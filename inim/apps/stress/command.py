"""Command `inim stress`."""

import argparse
from pathlib import Path

from inim.pipeline.options import Command, add_shared, finish, request_of
from inim.system.errors import UsageError


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
    from inim.apps.stress.run import StressRequest, run_stress
    from inim.system.worker.output import default_out

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
    "stress": Command("test algorithms for numerical stability", _add_stress_arguments, _stress),
}
