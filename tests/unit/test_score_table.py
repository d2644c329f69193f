"""Tables of a report's scores, and paired comparisons, against values computed by hand."""

import csv
import io
import math
import sys
from pathlib import Path

import msgspec
import pytest

from inim.report import Report
from inim.report.labels import short_names
from inim.report.score_table import ScoreTable, compare_algorithms
from inim.system.errors import UsageError
from tests.schemas import report_document

HEADLINE = "ssim_on_relic_to_reference"


def report(folder: str = "out", **scores_by_algorithm: tuple[float, float]) -> Report:
    """Report of two viewpoints, with intervals of ± 0.002 at the left one."""
    algorithms = {
        name: {
            "views": {"centre": {HEADLINE: centre}, "left": {HEADLINE: left}},
            "precision": {
                "left": {HEADLINE: {"plain": 0.9, "interval": [left - 0.002, left + 0.002]}}
            },
        }
        for name, (centre, left) in scores_by_algorithm.items()
    }
    viewpoints = [{"name": "centre"}, {"name": "left"}]
    data = {"viewpoints": viewpoints, "algorithms": algorithms, "reference": {"precision": {}}}
    return Report(Path(folder), report_document(data))


def test_rows_have_values_and_ends_of_intervals():
    table = report(template=(0.95, 0.9), gu2020=(0.85, 0.8)).table(HEADLINE)
    rows = {(row["algorithm"], row["viewpoint"]): row for row in table.rows}
    assert len(rows) == 6
    left = rows["template", "left"]
    assert (left[HEADLINE], left[f"{HEADLINE}_low"], left[f"{HEADLINE}_high"]) == (
        0.9, 0.898, 0.902
    )  # fmt: skip
    assert rows["template", "centre"][f"{HEADLINE}_low"] is None
    assert next(iter(csv.DictReader(io.StringIO(table.to_csv()))))[HEADLINE] == "0.95"


def test_a_missing_pandas_is_an_error_with_the_remedy(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(UsageError, match="pip install pandas"):
        report(template=(0.95, 0.9)).table(HEADLINE).to_pandas()


def test_notebook_shows_all_rows_with_their_intervals():
    table = report(**{"a": (0.95, 0.9), "<b>": (0.85, 0.8)}).table(HEADLINE)
    assert repr(table) == "ScoreTable(relics=1, algorithms=3, viewpoints=2, scores=1)"
    html = table._repr_html_()
    assert html.count("<tr>") == 1 + len(table.rows)
    assert "<td>0.900 ± 0.002</td>" in html
    assert "<td>0.950</td>" in html
    assert "<td>&lt;b&gt;</td>" in html


def test_notebook_shows_the_differences_of_a_comparison():
    reports = [report(f"relic{n}", a=(0.8 + n / 100, 0.7), b=(0.7, 0.8)) for n in range(6)]
    result = compare_algorithms(reports, "a", "b")
    assert repr(result) == "PairedComparison(mean=0.0125 ± 0.0099, p_value=0.062, relics=6)"
    html = result._repr_html_()
    assert html.count("<tr>") == 1 + 6 + 2
    assert "<td>0.0125 ± 0.0099</td>" in html
    single = compare_algorithms(reports[:1], "a", "b")
    assert repr(single) == "PairedComparison(mean=0.0000, p_value=nan, relics=1)"
    assert single.reason in single._repr_html_()


def test_latex_has_uncertain_digits_and_the_best_in_bold():
    text = report(**{"template:samples=1": (0.95, 0.9), "my_own": (0.96, 0.8)}).table().to_latex()
    lines = [line for line in text.splitlines() if "&" in line]
    assert lines == [
        r"algorithm & centre & left \\",
        r"template:samples=1 & 0.950 & \textbf{0.900(2)} \\",
        r"my\_own & \textbf{0.960} & 0.800(2) \\",
    ]
    assert text.count("\\begin") == text.count("\\end") == 1


def test_latex_names_leave_out_the_options_of_all_algorithms():
    names = ("template:samples=4:fill=none", "gu2020:fill=none:samples=4:colour=smooth")
    text = report(**dict.fromkeys(names, (0.95, 0.9))).table().to_latex()
    rows = [line.partition(" & ")[0] for line in text.splitlines() if "&" in line]
    assert rows == ["algorithm", "template", "gu2020:colour=smooth"]
    assert short_names(["template:samples=1", "gu2020"])["template:samples=1"] == (
        "template:samples=1"
    )


def test_latex_of_a_table_without_the_headline_score_has_the_first():
    table = ScoreTable(("psnr_db",), [{"relic": "jade", "algorithm": "a", "viewpoint": "centre",
        "psnr_db": 30.0, "psnr_db_low": None, "psnr_db_high": None}])  # fmt: skip
    assert r"a & \textbf{30.0} \\" in table.to_latex()
    with pytest.raises(UsageError, match="score ssim"):
        table.to_latex("ssim")


def test_latex_has_both_errors_of_an_asymmetric_interval():
    result = report(a=(0.95, 0.987), b=(0.94, 0.986))
    precision = result.data.algorithms["a"].precision["left"][HEADLINE]
    clipped = msgspec.structs.replace(precision, interval=(0.981, 1.0))
    for name in "ab":
        result.data.algorithms[name].precision["left"][HEADLINE] = clipped
    rows = result.table().to_latex().splitlines()
    assert r"a & \textbf{0.950} & $\mathbf{0.987^{+0.013}_{-0.006}}$ \\" in rows
    assert r"b & 0.940 & $0.986^{+0.014}_{-0.005}$ \\" in rows


def test_paired_comparison_takes_one_observation_per_relic():
    """Differences 0.01 to 0.06: mean 0.035; all positive, so the rank test has p = 2 / 2^6."""
    reports = [
        report(f"relic{n}", a=(0.8 + n / 100, 0.7 + n / 100), b=(0.7, 0.8)) for n in range(1, 7)
    ]
    result = compare_algorithms(reports, "a", "b")
    assert list(result.differences.values()) == pytest.approx([n / 100 for n in range(1, 7)])
    assert result.mean == pytest.approx(0.035)
    half = 2.570582 * math.sqrt(0.00035) / math.sqrt(6)  # Student's t of 5 degrees of freedom
    assert (result.low, result.high) == pytest.approx((0.035 - half, 0.035 + half), abs=1e-7)
    assert result.p_value == pytest.approx(2 / 64)
    assert compare_algorithms(reports, "b", "a").mean == pytest.approx(-0.035)


def test_few_reports_have_no_p_value_and_one_no_interval():
    single = compare_algorithms([report(a=(0.9, 0.9), b=(0.8, 0.8))], "a", "b")
    assert single.mean == pytest.approx(0.1)
    assert math.isnan(single.low)
    assert math.isnan(single.p_value)
    assert single.reason.startswith("1 of at least 6 relics")


def test_a_table_of_several_relics_names_them_by_title_or_folder():
    reports = [report("first", a=(0.9, 0.8)), report("second", a=(0.7, 0.6), b=(0.95, 0.5))]
    table = ScoreTable.of(reports, [HEADLINE])
    assert {row["relic"] for row in table.rows} == {"first", "second"}  # their titles are equal
    lines = [line for line in table.to_latex().splitlines() if "&" in line]
    assert lines == [
        r"algorithm & first & second \\",
        r"a & \textbf{0.850} & 0.650 \\",
        r"b & -- & \textbf{0.725} \\",
    ]
    left = [line for line in table.to_latex(viewpoint="left").splitlines() if "&" in line]
    assert left[1:] == [
        r"a & \textbf{0.800(2)} & \textbf{0.600(2)} \\",
        r"b & -- & 0.500(2) \\",
    ]
    with pytest.raises(UsageError, match="viewpoint lefd: did you mean left"):
        table.to_latex(viewpoint="lefd")
    titles = [
        msgspec.structs.replace(r.data, title=name) for r, name in zip(reports, "xy", strict=True)
    ]
    named = [Report(r.folder, data) for r, data in zip(reports, titles, strict=True)]
    assert {row["relic"] for row in ScoreTable.of(named).rows} == {"x", "y"}
    with pytest.raises(UsageError, match="there are none"):
        ScoreTable.of([])
