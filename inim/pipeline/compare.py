"""Comparison of finished reports: two, or pairs of several relics with a paired test."""

import math
import re
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from inim.pipeline.baseline import FOLDER, failed_pictures, read_run, regression_data
from inim.report import Report
from inim.report.comparison_text import (
    comparison_lines,
    headline_changes,
    short_name,
    verdict_sentence,
)
from inim.report.images import ENCODINGS, ReportImages, difference
from inim.report.labels import number
from inim.report.sections.regression import write_comparison
from inim.scores.document_parts import Checks
from inim.scores.metrics import HEADLINE_WORDS, MAIN
from inim.scores.regression.comparison import compare
from inim.scores.regression.document import CompareDocument, Side
from inim.scores.regression.scores import INTERVAL_LEVEL
from inim.scores.regression.verdict import student_interval
from inim.system.errors import UsageError
from inim.system.process.atomic_file import write_atomically
from inim.system.worker.output import output_files

#: Files of a comparison of two reports; the first marks a whole comparison.
COMPARISON_FILES = ("compare.json", "compare.html", "junit.xml", "summary.md")


class Pair(NamedTuple):
    """Two compared reports, and the folder of their comparison."""

    before: Path
    after: Path
    out: Path
    data: CompareDocument


def compare_all(reports: Sequence[Path], out: Path) -> list[Pair]:
    """Compare reports in pairs and write the results into a folder.

    Each report is compared with the first of its relic, or with the first of all if its relic has
    no other. Several pairs have subfolders of `out`. Raises as `compare_reports` does, and
    `UsageError` for reports of different relics.
    """
    by_title: dict[str, list[Path]] = defaultdict(list)
    loaded = {folder: Report.load(folder) for folder in reports}
    for folder in reports:
        by_title[loaded[folder].data.title].append(folder)
    firsts = {
        folder: group[0] if len(group) > 1 else reports[0]
        for group in by_title.values()
        for folder in group
    }
    pairs = [(firsts[folder], folder) for folder in reports if firsts[folder] != folder]
    pairs = pairs or [(reports[0], folder) for folder in reports[1:]]
    for before, after in pairs:
        if _relic_names(loaded[before]).isdisjoint(_relic_names(loaded[after])):
            raise UsageError(
                f"{after}: is of another relic than {before}, so their scores cannot be compared; "
                "compare two algorithms over relics with inim.compare_algorithms, or draw the "
                "reports with inim figure"
            )
    if len(pairs) == 1:
        [(before, after)] = pairs
        return [Pair(before, after, out, compare_reports(before, after, out))]
    compared = []
    for index, (before, after) in enumerate(pairs, 1):
        place = out / (re.sub(r"[^\w.+-]+", "-", f"{index}-{after.name}").strip("-.") or str(index))
        compared.append(Pair(before, after, place, compare_reports(before, after, place)))
    text = "\n".join(f"* {line}" for line in all_lines(compared))
    write_atomically(out / "summary.md", lambda path: path.write_text(f"{text}\n", "utf-8"))
    return compared


def _relic_names(report: Report) -> set[str]:
    """Title, file and meshes of a report's relic; a changed relic keeps one of these."""
    source = report.data.scene or report.data.picture
    assert source is not None
    return {report.data.title, Path(source.path).name, *getattr(source, "imports", ())}


def all_lines(pairs: Sequence[Pair]) -> list[str]:
    """Lines of text on pairs, one for a pair that passed, and the paired differences."""
    if len(pairs) == 1:
        return comparison_lines(pairs[0].data)
    lines = []
    for pair in pairs:
        comparison = pair.data.regression
        head = f"{pair.data.title}, {pair.after} against {pair.before}"
        if comparison.verdict == "passed":
            lines.append(f"{head}: {verdict_sentence(pair.data, comparison)}")
        else:
            lines += [f"{head}:", *(f"  {line}" for line in comparison_lines(pair.data))]
    return [*lines, *paired_differences(pairs)]


def paired_differences(pairs: Sequence[Pair]) -> list[str]:
    """Mean change of the headline score over relics by algorithm, by the paired t-test.

    A relic's change is the mean over its viewpoints. Source: Student, Biometrika 6, 1908.
    """
    changes: dict[str, dict[str, float]] = defaultdict(dict)
    for pair in pairs:
        for algorithm, by_view in headline_changes(pair.data).items():
            values = [check.value for check in by_view.values()]
            mean = float(np.mean([math.nan if value is None else value for value in values]))
            if math.isfinite(mean) and algorithm != "reference":
                changes[algorithm][pair.data.title] = mean
    lines = []
    for algorithm, by_relic in changes.items():
        values_of_relics, count = [*by_relic.values()], len(by_relic)
        if count < 2:
            lines.append(f"{algorithm}: no paired test, because there is only one relic")
            continue
        mean = float(np.mean(values_of_relics))
        ends = student_interval(values_of_relics, INTERVAL_LEVEL)
        value, low, high = (number(x, MAIN.digits) for x in (mean, *ends))
        lines.append(
            f"{algorithm}: change of {HEADLINE_WORDS}, mean of {count} relics: "
            f"{value} [{low}, {high}], paired t-test"
        )
    return lines


def compare_reports(before: Path, after: Path, out: Path) -> CompareDocument:
    """Compare two reports and write the result into a folder.

    The report in the folder `before` is the baseline of that in `after`. Writes `COMPARISON_FILES`
    into `out`.
    Raises `BaselineError` if one has no data for a comparison, and `FileError` if a report is
    missing or `out` cannot be written.
    """
    (report, old), (other, new) = read_run(before), read_run(after)
    if out.exists() and any(out.samefile(folder) for folder in (before, after)):
        raise UsageError(f"{out}: is one of the reports; choose another folder with -o")
    comparison = compare(old, new)
    checks = [
        replace(c, name=short_name(c), detail=c.detail.replace("baseline", "first report"))
        for c in comparison.checks
    ]
    with output_files(out, COMPARISON_FILES) as staging:
        data = CompareDocument(
            title=new.circumstances.title or after.name,
            created=new.circumstances.created,
            before=Side(folder=str(before), circumstances=old.circumstances),
            after=Side(folder=str(after), circumstances=new.circumstances),
            regression=regression_data(
                str(before),
                old,
                comparison,
                [
                    name
                    for name in failed_pictures(comparison)
                    if _copy_pictures(report, other, name, staging)
                ],
            ),
            verdict=Checks.of(checks),
        )
        write_comparison(data, staging)
    return data


def _copy_pictures(before: Report, after: Report, name: str, staging: Path) -> bool:
    """Write both reports' images of a name and their difference; False if one is missing."""
    from PIL import Image

    old, new = (ReportImages(r.folder, ENCODINGS[0]).read(f"{name}.png") for r in (before, after))
    change = difference(old, new)
    if old is None or new is None or change is None:
        return False
    target = staging / FOLDER / name
    target.parent.mkdir(parents=True, exist_ok=True)
    for pixels, kind in ((old, "baseline"), (new, "candidate"), (change, "difference")):
        Image.fromarray(pixels).save(target.with_name(f"{target.name}-{kind}.png"))
    return True
