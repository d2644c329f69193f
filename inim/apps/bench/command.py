"""Command `inim bench`."""

import argparse

from inim.pipeline.options import Command, add_shared, finish, request_of


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
    from inim.apps.bench.run import BenchRequest, run_bench
    from inim.pipeline.timing import Rounds
    from inim.system.worker.output import default_out

    args.out = args.out or default_out(args.scene, "bench")
    rounds = Rounds(args.runs, args.warmups, args.threads)
    request = BenchRequest(request_of(args), rounds, args.command_line)
    run_bench(request, quiet=args.quiet, debug=args.debug)
    return finish(True, f"bench: {args.out / 'bench.html'}", quiet=args.quiet)


COMMANDS = {
    "bench": Command("time algorithms and compare time with error", _add_bench_arguments, _bench),
}
