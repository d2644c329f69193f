"""Command `inim stress`."""

import argparse
from pathlib import Path

from inim.pipeline.options import Command, add_shared, default_out, finish, request_of
from inim.system.errors import UsageError


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _add_stress_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Check relations that hold for every correct result: displays, rays, algorithms, lens "
        "models, colours, views, scores and statistics, also of other packages; measure the effect "
        "of small depth errors."
    )
    parser.add_argument(
        "scene",
        type=Path,
        nargs="?",
        help="Mitsuba scene (.xml) whose depth is changed (default: two synthetic spheres)",
    )
    shared = ("definitions", "algorithms", "allow_folders", "quiet")
    add_shared(parser, *shared, out="folder (default: SCENE-stress)")
    parser.add_argument(
        "--lens-models", type=_names, metavar="NAMES", help="lens models (default: all)"
    )
    parser.add_argument(
        "--relations", type=_names, default=(), metavar="NAMES", help="relations or topics only"
    )
    parser.add_argument("--quick", action="store_true", help="fewer and smaller cases")


def _stress(args: argparse.Namespace) -> int:
    from inim.apps.stress.run import StressRequest, run_stress

    if args.scene is None and args.definitions:
        raise UsageError("stress: -D belongs to a scene; name one")
    args.out = args.out or default_out(args.scene, "stress")
    validation = request_of(args)
    request = StressRequest(
        args.out,
        validation.algorithms,
        args.lens_models,
        args.relations,
        args.quick,
        None if args.scene is None else validation,
        args.command_line,
    )
    passed = run_stress(request, quiet=args.quiet, debug=args.debug)
    verdict = "passed" if passed else "FAILED"
    return finish(passed, f"{verdict}; {args.out / 'stress.html'}", quiet=args.quiet)


COMMANDS = {
    "stress": Command(
        "test the whole chain for numerical faults",
        _add_stress_arguments,
        _stress,
        "inim stress --quick -o out/stress",
    ),
}
