"""Command `inim bench`."""

import argparse
from pathlib import Path

from inim.pipeline.options import Command, add_shared, default_out, finish, request_of


def _add_bench_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Time each algorithm on the display-ready pictures of scenes and compare time with error. "
        "All algorithms run alternately with a reference kernel: one 4-byte gather per panel "
        "pixel. Times, their ratios to the kernel's and errors have 95 % intervals."
    )
    parser.add_argument(
        "scenes", nargs="+", type=Path, metavar="SCENE", help="Mitsuba scene (.xml)"
    )
    parser.add_argument(
        "--size",
        action="append",
        default=[],
        dest="sizes",
        metavar="KEY=VALUE,...",
        help="settings of a size, such as lens_columns=32,lens_rows=32 or "
        "capture_pixels_per_pitch=2; may be repeated, for several sizes",
    )
    shared = ("definitions", "display", "algorithms", "allow_folders", "quiet")
    add_shared(parser, *shared, out="folder (default: SCENE-bench)")
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

    args.out = args.out or default_out(args.scenes[0], "bench")
    requests = []
    for scene in args.scenes:
        args.scene = scene
        requests.append(request_of(args))
    rounds = Rounds(args.runs, args.warmups, args.threads)
    request = BenchRequest(tuple(requests), tuple(args.sizes), rounds, args.command_line)
    run_bench(request, quiet=args.quiet, debug=args.debug)
    return finish(True, f"bench: {args.out / 'bench.html'}", quiet=args.quiet)


COMMANDS = {
    "bench": Command(
        "time algorithms and compare time with error",
        _add_bench_arguments,
        _bench,
        "inim bench scenes/jade.xml -a gu2020,template -o out/jade-bench",
    ),
}
