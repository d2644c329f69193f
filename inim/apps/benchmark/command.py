"""Command `inim benchmark`."""

import argparse
from pathlib import Path
from typing import Any

from inim.apps.benchmark.protocol import BLIND_SEED, PROTOCOL, SEED, TIER_NAMES, TRACKS
from inim.pipeline.options import Command, add_shared, finish, print_lines

_SUITE = Path(PROTOCOL)


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        f"{PROTOCOL}: a benchmark of algorithms for elemental images. `make` renders its inputs "
        "and its truth, `run` runs algorithms of this program, `score` validates and scores a "
        "folder of EIAs, `board` compares all scored ones."
    )
    tasks: Any = parser.add_subparsers(required=True, metavar="TASK", dest="task")

    def task(name: str, text: str, run: Any) -> argparse.ArgumentParser:
        part: argparse.ArgumentParser = tasks.add_parser(name, help=text, description=text)
        part.set_defaults(task_function=run)
        part.add_argument(
            "--suite", type=Path, default=_SUITE, help=f"folder of the suite (default: {_SUITE})"
        )
        add_shared(part, "quiet")
        return part

    make = task("make", "Render the cases of a tier; those that exist are kept.", _make)
    make.add_argument(
        "--tier", choices=TIER_NAMES, default="small", help="cases to render (default: small, four)"
    )
    make.add_argument("--case", action="append", default=[], dest="names", help="only these cases")
    make.add_argument("--scans", type=Path, metavar="DIR", help="folder of the scanned meshes")
    make.add_argument("--seed", type=int, default=SEED, help="seed of the renderer's noise")
    make.add_argument(
        "--blind-seed", type=int, default=BLIND_SEED, metavar="SEED",
        help="seed of the deviations in the track blind; a reviewer takes a secret one",
    )  # fmt: skip
    task("check", "Check the files of the suite and compare it with the published one.", _check)
    run = task("run", "Run algorithms on the inputs, and score them.", _run)
    run.add_argument(
        "algorithms", nargs="*", metavar="ALGORITHM", help="default: those of the published board"
    )
    score = task("score", "Validate and score a submission.", _score)
    score.add_argument("submission", type=Path, help="folder of EIAs with submission.json")
    score.add_argument(
        "--as-is", action="store_true", help="score it in spite of mistakes in its content"
    )
    task("board", "Write the board of all scored submissions.", _board)


def _make(args: argparse.Namespace) -> int:
    from inim.apps.benchmark.definition import case_of, cases_of
    from inim.apps.benchmark.make import MANIFEST, CaseJob, render_case, scene_of, write_licences

    suite, names = args.suite, args.names
    cases = [case_of(name) for name in names] if names else [*cases_of(args.tier)]
    for number, case in enumerate(cases, 1):
        job = CaseJob.of(case, scene_of(case, suite, args.scans), args.seed, args.blind_seed)
        if job.is_made(suite / case.name / MANIFEST):
            continue
        if not args.quiet:
            print_lines(f"{case.name}, {number} of {len(cases)}")
        render_case(job, suite, quiet=args.quiet, debug=args.debug)
    write_licences(suite)
    return finish(True, f"suite: {suite}, {len(cases)} cases", quiet=args.quiet)


def _check(args: argparse.Namespace) -> int:
    from inim.apps.benchmark.published import suite_mistakes
    from inim.apps.benchmark.suite import made_cases

    cases = made_cases(args.suite)
    mistakes = suite_mistakes(cases)
    lines = mistakes or [f"{len(cases)} cases are those of {PROTOCOL}"]
    return finish(not mistakes, *lines, quiet=args.quiet)


def _run(args: argparse.Namespace) -> int:
    from inim.apps.benchmark.run import BUILT_IN, run_algorithm
    from inim.apps.benchmark.score import score_submission
    from inim.apps.benchmark.submission import check_name

    algorithms = args.algorithms or BUILT_IN
    for algorithm in algorithms:
        folder = args.suite / "submissions" / check_name(algorithm)
        run_algorithm(algorithm, args.suite, folder, quiet=args.quiet, debug=args.debug)
        out = args.suite / "results" / folder.name
        score_submission(
            args.suite, folder, out, as_is=True, is_own=True, quiet=args.quiet, debug=args.debug
        )
    return finish(True, f"scored: {', '.join(algorithms)}", quiet=args.quiet)


def _score(args: argparse.Namespace) -> int:
    from inim.apps.benchmark.score import SubmissionError, score_submission
    from inim.apps.benchmark.submission import check_name, read_submission

    name = check_name(read_submission(args.submission).name)
    out = args.suite / "results" / name
    try:
        score_submission(
            args.suite, args.submission, out, as_is=args.as_is, quiet=args.quiet, debug=args.debug
        )
    except SubmissionError as error:  # of its files; the worker prints those of the content
        print_lines(*(f"mistake: {text}" for text in error.mistakes))
        raise
    return finish(True, f"scored: {out}", quiet=args.quiet)


def _board(args: argparse.Namespace) -> int:
    from inim.apps.benchmark.board import write_board

    out = args.suite / "board"
    write_board(args.suite, out, args.command_line)
    return finish(True, f"board: {out / 'board.html'}", quiet=args.quiet)


_SUMMARY = f"benchmark of algorithms on fixed inputs: {', '.join(TRACKS)}"
_EXAMPLE = "inim benchmark make --case ibex-sheet --suite out/suite"
COMMANDS = {
    "benchmark": Command(_SUMMARY, _add_arguments, lambda args: args.task_function(args), _EXAMPLE),
}
