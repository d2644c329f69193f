"""Scores of reports as tables for pandas, CSV and LaTeX, and paired comparisons of algorithms."""

from __future__ import annotations

import csv
import io
import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import TYPE_CHECKING, Any

from inim.report.labels import is_number, last_digits, number, precise, short_names
from inim.report.page import text_table
from inim.scores.metrics import HEADLINE, find
from inim.scores.regression.scores import INTERVAL_LEVEL
from inim.scores.regression.verdict import student_interval
from inim.system.errors import UsageError, suggest_words

if TYPE_CHECKING:
    from inim.report import Report

#: Names the reference view where an algorithm could be named.
REFERENCE = "reference"
# What a row belongs to.
_NAMES = ("relic", "algorithm", "viewpoint")
# A score and the ends of its interval, of which each can be missing.
_Estimate = tuple[float | None, float | None, float | None]
_LATEX = str.maketrans({c: f"\\{c}" for c in "&%$#_{}"})


@dataclass(frozen=True, repr=False)
class ScoreTable:
    """Scores of reports, a row for each algorithm and viewpoint; the reference is among them.

    Attributes
    ----------
    scores : tuple of str
        Names of the scores.
    rows : list of dict
        ``relic``, ``algorithm``, ``viewpoint``, and each score with its 95 % interval, as ``NAME``,
        ``NAME_low`` and ``NAME_high``; None where a value is missing or infinite.
    """

    scores: tuple[str, ...]
    rows: list[dict[str, Any]]

    @classmethod
    def of(cls, reports: Report | Sequence[Report], scores: Sequence[str] = ()) -> ScoreTable:
        """Table of some scores of one or several reports; by default of all scores.

        Relics are named by the titles of their reports, or by the folders if titles are equal.

        Raises
        ------
        UsageError
            A report has no such score, or there is no report.
        """
        results: list[tuple[str, Any, str, Any]] = []
        for relic, report in named_relics(reports).items():
            data = report.data
            results += [(relic, data, name, result) for name, result in data.algorithms.items()]
            results.append((relic, data, REFERENCE, data.reference))
        names = {key: None for *_, r in results for s in r.views.values() for key in s}
        for name in scores:
            if name not in names:
                raise UsageError(f"scores: {name!r}: {suggest_words(name, list(names))}")
        chosen = tuple(scores or names)
        rows = []
        for relic, data, algorithm, result in results:
            for viewpoint in data.viewpoint_names:
                values = result.views.get(viewpoint, {})
                precision = result.precision.get(viewpoint, {})
                row: dict[str, Any] = {"relic": relic, "algorithm": algorithm}
                row["viewpoint"] = viewpoint
                for name in chosen:
                    low, high = precision[name].interval if name in precision else (None, None)
                    row |= {name: values.get(name), f"{name}_low": low, f"{name}_high": high}
                rows.append(row)
        return cls(chosen, rows)

    def __repr__(self) -> str:
        counts = [f"{name}s={len({row[name] for row in self.rows})}" for name in _NAMES]
        return f"ScoreTable({', '.join(counts)}, scores={len(self.scores)})"

    def _repr_html_(self) -> str:
        """All rows with their intervals, for notebooks."""
        rows = [
            [row[name] for name in _NAMES] + [_with_interval(row, name) for name in self.scores]
            for row in self.rows
        ]
        return text_table("Scores with 95 % intervals", [*_NAMES, *self.scores], rows)

    def to_pandas(self) -> Any:
        """A pandas DataFrame. Raises `UsageError` without the package pandas."""
        try:
            import pandas
        except ModuleNotFoundError:
            raise UsageError(
                "to_pandas needs pandas, which is not installed: pip install pandas"
            ) from None
        return pandas.DataFrame(self.rows)

    def to_csv(self) -> str:
        """Text of a CSV file, with a line of column names."""
        stream = io.StringIO()
        writer = csv.DictWriter(stream, list(self.rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.rows)
        return stream.getvalue()

    def to_latex(self, score: str = "", viewpoint: str = "") -> str:
        """A LaTeX table of one score, a row for each algorithm, for the package booktabs.

        The columns are the viewpoints of one relic, or several relics. The best of each column is
        bold. A cell has the score and half of its interval in units of the last digit:
        ``0.955(2)``. A mean of several viewpoints has no interval. Options that all algorithms
        have are left out of their names.

        Parameters
        ----------
        score : str
            By default the headline score, or the first if the table lacks it.
        viewpoint : str
            One viewpoint. By default a relic among several has the mean of all viewpoints.

        Raises
        ------
        UsageError
            The table has no such score or viewpoint.
        """
        score = score or (HEADLINE if HEADLINE in self.scores else self.scores[0])
        views = list(dict.fromkeys(row["viewpoint"] for row in self.rows))
        for option, value, names in (
            ("score", score, self.scores),
            ("viewpoint", viewpoint or views[0], views),
        ):
            if value not in names:
                raise UsageError(f"{option} {value}: {suggest_words(value, list(names))}")
        metric, digits = find(score), _digits(score)
        key = "relic" if len({row["relic"] for row in self.rows}) > 1 else "viewpoint"
        cells: dict[str, dict[str, list[_Estimate]]] = defaultdict(lambda: defaultdict(list))
        for row in self.rows:
            if row["algorithm"] != REFERENCE and viewpoint in ("", row["viewpoint"]):
                estimate = row[score], row[f"{score}_low"], row[f"{score}_high"]
                cells[row["algorithm"]][row[key]].append(estimate)
        columns = list(dict.fromkeys(column for row in cells.values() for column in row))
        means = {n: {c: _mean(row[c]) for c in columns} for n, row in cells.items()}
        best_of = min if metric is not None and metric.better == "lower" else max
        best = {
            c: best_of((x for m in means.values() if is_number(x := m[c][0])), default=math.nan)
            for c in columns
        }
        rows = [
            [latex_text(name)]
            + [
                _latex_cell(mean, digits, mean[0] == best[c])
                for c, mean in means[algorithm].items()
            ]
            for algorithm, name in short_names([*means]).items()
        ]
        return latex_table(["algorithm", *map(latex_text, columns)], rows)


def latex_text(text: str) -> str:
    """Plain text as LaTeX."""
    return text.translate(_LATEX)


def latex_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A LaTeX table for the package booktabs, of cells in LaTeX."""
    lines = [
        rf"\begin{{tabular}}{{l{'r' * (len(heads) - 1)}}}",
        r"\toprule",
        " & ".join(heads) + r" \\",
        r"\midrule",
        *(" & ".join(row) + r" \\" for row in rows),
    ]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def named_relics(reports: Report | Sequence[Report]) -> dict[str, Report]:
    """Reports by the titles of their relics, or by their folders if titles are equal."""
    listed = [*reports] if isinstance(reports, Sequence) else [reports]
    if not listed:
        raise UsageError("reports: there are none; give one or more")
    titles = {report.data.title: report for report in listed}
    return titles if len(titles) == len(listed) else {str(r.folder): r for r in listed}


def _digits(score: str) -> int:
    metric = find(score)
    return 3 if metric is None else max(metric.digits - 1, 1)


def _with_interval(row: dict[str, Any], score: str) -> str:
    value, *interval = (row[name] for name in (score, f"{score}_low", f"{score}_high"))
    return precise(value, interval, _digits(score))


def _mean(estimates: Sequence[_Estimate]) -> _Estimate:
    """Mean of estimates, without an interval if there are several; none if a value is missing."""
    if len(estimates) == 1:
        return estimates[0]
    values = [value for value, *_ in estimates if is_number(value)]
    return fmean(values) if values and len(values) == len(estimates) else None, None, None


def _latex_cell(estimate: _Estimate, digits: int, is_best: bool) -> str:
    value, low, high = estimate
    if not is_number(value):
        return "--"
    text = number(value, digits)
    if is_number(low) and is_number(high):
        if abs(high + low - 2 * value) > 10.0**-digits:
            ends = (last_digits(part, digits) / 10**digits for part in (high - value, value - low))
            text += "^{{+{:.{d}f}}}_{{-{:.{d}f}}}".format(*ends, d=digits)
            return rf"$\mathbf{{{text}}}$" if is_best else f"${text}$"
        text += f"({last_digits((high - low) / 2, digits)})"
    return rf"\textbf{{{text}}}" if is_best else text


@dataclass(frozen=True, repr=False)
class PairedComparison:
    """Difference of a score between two algorithms, paired by relic.

    Views of one relic are not independent, so their mean is one observation.

    Attributes
    ----------
    differences : dict of str to float
        First minus second algorithm, mean over the viewpoints, by report.
    mean, low, high : float
        Mean difference and its 95 % interval by Student's t; NaN for a single report.
    p_value : float
        Probability of such differences between equal algorithms, by the Wilcoxon signed-rank test
        (Biometrics Bulletin 1, 1945); NaN below six reports, where it cannot fall below 0.05.
    reason : str
        Reason why there is no probability; empty if there is one.
    """

    differences: dict[str, float]
    mean: float
    low: float
    high: float
    p_value: float
    reason: str = ""

    def __repr__(self) -> str:
        mean, relics = self._mean_text, len(self.differences)
        return f"PairedComparison(mean={mean}, p_value={self.p_value:.2g}, relics={relics})"

    def _repr_html_(self) -> str:
        """Differences, their mean and its probability, for notebooks."""
        rows = [(name, number(d, _DIFFERENCE_DIGITS)) for name, d in self.differences.items()]
        rows += [("mean", self._mean_text), ("p", self.reason or f"{self.p_value:.2g}")]
        return text_table("First minus second algorithm", ["report", "difference"], rows)

    @property
    def _mean_text(self) -> str:
        return precise(self.mean, (self.low, self.high), _DIFFERENCE_DIGITS)


_LEAST_FOR_TEST = 6
_DIFFERENCE_DIGITS = 4


def compare_algorithms(
    reports: Sequence[Report], first: str, second: str, score: str = HEADLINE
) -> PairedComparison:
    """Compare two algorithms over the reports of several relics.

    Parameters
    ----------
    reports : sequence of Report
        One of each relic, with both algorithms.
    first, second : str
        Algorithms with their options, or ``"reference"``.
    score : str
        Name of a score of views.

    Raises
    ------
    UsageError
        A report has no such algorithm or score, or there is no report.
    """
    if not reports:
        raise UsageError("reports: there are none; give the reports of several relics")
    differences: dict[str, float] = {}
    for report in reports:
        table = ScoreTable.of(report, [score])
        means = []
        for name in (first, second):
            values = [row[score] for row in table.rows if row["algorithm"] == name]
            if not values or not all(map(is_number, values)):
                names = list(dict.fromkeys(row["algorithm"] for row in table.rows))
                raise UsageError(f"{report.folder}: {name}: {suggest_words(name, names)}")
            means.append(math.fsum(values) / len(values))
        differences[str(report.folder)] = means[0] - means[1]
    sample = [*differences.values()]
    mean, low, high, p_value = fmean(sample), math.nan, math.nan, math.nan
    if len(sample) > 1:
        low, high = student_interval(sample, INTERVAL_LEVEL)
    if len(sample) >= _LEAST_FOR_TEST:
        from scipy.stats import wilcoxon  # takes two seconds to load

        p_value, reason = float(wilcoxon(sample).pvalue) if any(sample) else 1.0, ""
    else:
        reason = (
            f"{len(sample)} of at least {_LEAST_FOR_TEST} relics; with fewer, the test cannot "
            "reach a probability below 0.05"
        )
    return PairedComparison(differences, mean, low, high, p_value, reason)
