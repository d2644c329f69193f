"""Commands `inim baseline accept` and `inim compare`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from inim.commands.options import Command, add_exit_codes
from inim.errors import EXIT_CHECK_FAILED, EXIT_PASSED, UsageError

if TYPE_CHECKING:
    from inim.report import Report


def _add_baseline_arguments(parser: argparse.ArgumentParser) -> None:
    add_exit_codes(parser)
    actions: Any = parser.add_subparsers(required=True, metavar="accept")
    accept = actions.add_parser("accept", help="make a report the baseline of its scene")
    accept.add_argument("out", type=Path, metavar="OUT", help="folder of a report")
    accept.add_argument("--reason", required=True, help="why, in a line; kept in the baseline")
    accept.add_argument(
        "--to",
        type=Path,
        metavar="DIR",
        help="folder of the baseline (default: the one compared with, or reports/baselines/TITLE)",
    )


def _baseline(args: argparse.Namespace) -> int:
    from inim.pipeline.output.baseline import accept

    print(f"baseline: {accept(args.out, args.reason, args.to)}")
    return EXIT_PASSED


_MARKER = "compare.json"
_FILES = (_MARKER, "compare.html", "junit.xml", "summary.md")


def _add_compare_arguments(parser: argparse.ArgumentParser) -> None:
    add_exit_codes(parser)
    add = parser.add_argument
    add("baseline", type=Path, metavar="OUT_A", help="folder of the report before")
    add("candidate", type=Path, metavar="OUT_B", help="folder of the report after")
    add("-o", "--out", type=Path, help="folder (default: compare)")
    add("--quiet", action="store_true", help="print errors only")


def _compare(args: argparse.Namespace) -> int:
    out = args.out or Path("compare")
    passed, lines = compare_reports(args.baseline, args.candidate, out)
    if not args.quiet:
        print("\n".join(lines))
        print(f"{'passed' if passed else 'FAILED'}; comparison: {out / 'compare.html'}")
    return EXIT_PASSED if passed else EXIT_CHECK_FAILED


def compare_reports(before: Path, after: Path, out: Path) -> tuple[bool, list[str]]:
    """Compare two reports and write the result into a folder.

    Parameters
    ----------
    before, after : Path
        Folders of reports; `before` is the baseline.
    out : Path
        Folder for `compare.json`, `compare.html`, `junit.xml` and `summary.md`.

    Returns
    -------
    passed : bool
    lines : list of str
        Results as text, failures first.

    Raises
    ------
    BaselineError
        The reports were made under different conditions, or one has no data for a comparison.
    FileError
        A report is missing, or `out` cannot be written.
    """
    from inim.documents.compare import CompareDocument, Side
    from inim.documents.parts import Checks
    from inim.pipeline.output.baseline import read_run, regression_data, verdict_lines
    from inim.regression import all_passed, compare
    from inim.report.sections.regression import write_comparison
    from inim.worker.output import published

    (report, old), (other, new) = read_run(before), read_run(after)
    reports = [report, other]
    if out.exists() and any(out.samefile(folder) for folder in (before, after)):
        raise UsageError(f"{out}: is one of the reports; choose another folder with -o")
    verdicts = compare(old, new, str(before))
    with published(out, _FILES) as staging:
        failed = [v.name for v in verdicts if v.kind == "picture" and not v.passed]
        names = [n for n in old.pictures if any(f.startswith(f"{n}: ") for f in failed)]
        pictures = [n for n in names if _copy_pictures(reports, n, staging)]
        checks = [verdict.as_check() for verdict in verdicts]
        data = CompareDocument(
            title=new.circumstances.title or after.name,
            created=new.circumstances.created,
            before=Side(folder=str(before), circumstances=old.circumstances),
            after=Side(folder=str(after), circumstances=new.circumstances),
            conditions=new.conditions,
            regression=regression_data(str(before), old, new, pictures),
            verdict=Checks(passed=all_passed(verdicts), checks=checks),
        )
        write_comparison(data, staging)
    return all_passed(verdicts), verdict_lines(verdicts)


def _copy_pictures(reports: list[Report], name: str, staging: Path) -> bool:
    """The two pictures of a name, and their difference; whether both are there."""
    from PIL import Image

    from inim.pipeline.output.baseline import FOLDER
    from inim.report.images import ENCODINGS, Images, difference

    images = [Images(r.folder, ENCODINGS[0]).read(f"{name}.png") for r in reports]
    change = difference(images[0], images[1])
    if images[0] is None or images[1] is None or change is None:
        return False
    target = staging / FOLDER / name
    target.parent.mkdir(parents=True, exist_ok=True)
    for pixels, kind in ((images[0], "baseline"), (images[1], "candidate"), (change, "difference")):
        Image.fromarray(pixels).save(target.with_name(f"{target.name}-{kind}.png"))
    return True


COMMANDS = {
    "baseline": Command(
        "accept a report as the baseline of later runs", _add_baseline_arguments, _baseline
    ),
    "compare": Command("compare two reports statistically", _add_compare_arguments, _compare),
}
