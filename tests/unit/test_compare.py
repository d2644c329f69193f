"""Comparisons in text: paired differences over relics, directions, and what a reader must know."""

import re
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest
from scipy import stats

from inim.display.settings import Settings
from inim.generators import Algorithm
from inim.pipeline import compare
from inim.pipeline.compare import Pair, all_lines, paired_differences
from inim.pipeline.evaluation import Evaluation
from inim.pipeline.plan import Plan
from inim.pipeline.stages.method import GeneratorMethod
from inim.pipeline.stages.scoring import Statistics
from inim.report.comparison_text import accepted_lines, also_changed, comparison_lines
from inim.report.images import ENCODINGS, ReportImages
from inim.report.labels import check_sentence
from inim.report.sections.regression import regression
from inim.report.summary import render_checks
from inim.scores.document_parts import Change, Check
from inim.scores.metrics import HEADLINE
from inim.scores.regression.document import CompareDocument
from inim.scores.regression.scores import ScoreEstimate, compare_scores, score_label
from inim.scores.regression.verdict import judge, within
from inim.system.errors import UsageError
from tests.schemas import completed


def pair(title: str, *changes: float, verdict: str = "passed") -> Pair:
    """A comparison of a relic with changes of the headline score at its viewpoints."""
    checks = [
        Check(
            name=f"template/view{n}: {score_label(HEADLINE)} against the baseline",
            kind="score", value=change, relation="within", limit=0.1, passed=abs(change) < 0.1,
            detail="", interval=(change - 0.01, change + 0.01), unit="",
        )
        for n, change in enumerate(changes)
    ]  # fmt: skip
    text = completed("compare", {"title": title, "regression": {"verdict": verdict, "inputs": []}})
    data = with_checks(msgspec.convert(text, CompareDocument), checks)
    return Pair(Path("a"), Path("b"), Path("c"), data)


def with_checks(data: CompareDocument, checks: list[Check]) -> CompareDocument:
    verdict = msgspec.structs.replace(data.verdict, passed=False, checks=checks)
    return msgspec.structs.replace(data, verdict=verdict)


def test_relics_are_paired_by_student_s_test():
    relics = {"jade": (0.01, 0.03), "vase": (0.05, 0.05), "coin": (-0.01, 0.03)}
    [line] = paired_differences([pair(title, *changes) for title, changes in relics.items()])
    means = [0.02, 0.05, 0.01]
    low, high = stats.ttest_1samp(means, 0).confidence_interval(0.95)
    numbers = f"{sum(means) / 3:.4f} [{low:.4f}, {high:.4f}]".replace("-", "−")
    assert line.endswith(f"{numbers}, paired t-test")


def test_one_relic_has_the_reason_for_no_paired_test():
    assert paired_differences([pair("jade", 0.01)]) == [
        "template: no paired test, because there is only one relic"
    ]


@pytest.mark.parametrize("verdict", ["passed", "worse"])
def test_a_pair_that_passed_has_one_line(verdict):
    text = all_lines([pair("jade", 0.01), pair("vase", 0.2, verdict=verdict)])
    assert sum(line.startswith("jade, b against a: passed") for line in text) == 1
    assert any(line.startswith("  changed: template/view0") for line in text) is (
        verdict == "worse"
    )


@pytest.mark.parametrize(
    ("title", "path", "imports", "refused"),
    [
        ("Jade disc", "new.xml", "other.ply: 9 triangles", False),
        ("Disc", "old/jade.xml", "other.ply: 9 triangles", False),
        ("Disc", "new.xml", "disc.ply: 8 triangles", False),
        ("Bronze ibex", "ibex.xml", "ibex.ply: 7 triangles", True),
    ],
)
def test_reports_of_different_relics_are_refused(monkeypatch, title, path, imports, refused):
    def report(title: str, path: str, imports: str) -> SimpleNamespace:
        scene = SimpleNamespace(path=path, imports=[imports])
        return SimpleNamespace(data=SimpleNamespace(title=title, scene=scene))

    reports = {
        Path("a"): report("Jade disc", "jade.xml", "disc.ply: 8 triangles"),
        Path("b"): report(title, path, imports),
    }
    monkeypatch.setattr(compare.Report, "load", reports.get)
    monkeypatch.setattr(compare, "compare_reports", lambda *_: None)
    if refused:
        with pytest.raises(UsageError, match=r"b: is of another .*compare_algorithms"):
            compare.compare_all([*reports], Path("out"))
    else:
        assert compare.compare_all([*reports], Path("out"))


def compared(old: float, new: float, name: str, scored: str = "template/left") -> Check:
    """The check of a score without noise; the light of the reference view stays 0.5."""
    reference = {"reference/left": {name: ScoreEstimate(0.5, 0.0, 8.0, 0.0)}}
    runs = [reference | {scored: {name: ScoreEstimate(v, 0.0, 8.0, 0.0)}} for v in (old, new)]
    return compare_scores(*runs)[-1]


@pytest.mark.parametrize(
    ("name", "old", "new", "direction"),
    [
        ("ssim_to_reference", 0.8, 0.9, "better"),
        ("ssim_to_reference", 0.9, 0.8, "worse"),
        ("ssim_to_reference", 0.9, 0.901, ""),
        ("flip", 0.1, 0.2, "worse"),
        ("light_on_relic_red_to_reference", -5.0, 1.0, "better"),
        ("light_on_relic_red_to_reference", 1.0, -5.0, "worse"),
        ("light_on_relic_red", 0.6, 0.52, "better"),
        ("light_on_relic_red", 0.6, 0.3, "worse"),
    ],
)
def test_a_change_has_the_direction_of_its_metric_or_of_the_reference_light(
    name, old, new, direction
):
    assert compared(old, new, name).direction == direction


def test_light_of_the_reference_view_has_no_better_side():
    assert compared(0.5, 0.7, "light_on_relic_red", "reference/left").direction == ""


# Lines of the completed document's own values.
_EXAMPLE = ("changed ", "not compared", "also changed")


def test_worse_scores_come_first_and_the_verdict_names_the_worst():
    better = compared(0.5, 0.9, HEADLINE)
    worse = compared(0.1, 0.11, "flip")
    verdict, checks = judge([better, worse], inputs_changed=False, allow_changed_inputs=False)
    data = with_checks(pair("jade", verdict=verdict).data, checks)
    first, second, *_, last = (x for x in comparison_lines(data) if not x.startswith(_EXAMPLE))
    assert first.startswith("worse: template/left: FLIP to ground truth")
    assert second.startswith("better: template/left: SSIM on relic to reference")
    expected = "worse: 2 of 2 comparisons changed, 1 worse; worst: template/left: FLIP"
    assert last.startswith(expected)
    assert "not corrected for noise" in render_checks(data)


def test_page_lists_changed_scores_and_counts_the_other_changes(tmp_path):
    scores = [compared(0.9, 0.8, HEADLINE, f"template/view{n}") for n in range(3)]
    light = [within(f"light {n}", "light", 0.1, 0.01, 0.01, unit="") for n in range(4)]
    data = with_checks(pair("jade", verdict="worse").data, [*scores, *light])
    page = regression(data, ReportImages(tmp_path, ENCODINGS[0]))
    assert "7 of 7 comparisons changed" in page
    assert "Changed scores: 3," in page
    assert page.count("<li>") == 3
    assert 'Other changed comparisons: 4, see <a href="#checks">Checks</a>' in page
    alone = regression(with_checks(data, scores), ReportImages(tmp_path, ENCODINGS[0]))
    assert "Other changed comparisons" not in alone
    assert "Changes of all scores are in the checks of compare.html." in render_checks(data)


def test_changed_inputs_have_the_folders_of_both_runs_as_heads(tmp_path):
    change = {"name": "display: gap_mm", "baseline": 3.3, "candidate": 3.2}
    text = completed(
        "compare",
        {
            "before": {"folder": "out/first"},
            "after": {"folder": "out/<second>"},
            "regression": {"verdict": "worse", "inputs": [change], "circumstances": [change]},
        },
    )
    data = msgspec.convert(text, CompareDocument)
    page = regression(data, ReportImages(tmp_path, ENCODINGS[0]))
    heads = ["out/first", "out/&lt;second&gt;"]
    assert re.findall('<th scope="col">(.*?)</th>', page) == [
        *("Input", *heads),
        *("Circumstance", *heads),
    ]
    assert "Baseline" not in page


def test_a_limit_that_is_the_uncertainty_is_printed_once():
    noisy = within("a", "score", -0.0347, 0.009, 0.005, unit="", detail="why")
    assert check_sentence(noisy) == "−0.0347, required within ± 0.009, its uncertainty. why"
    large = within("a", "score", -0.0347, 0.001, 0.005, unit="")
    assert check_sentence(large) == "−0.0347, required within ± 0.005 (interval −0.0357 to −0.0337)"


def test_an_accepted_report_lists_all_of_its_changes(monkeypatch):
    checks = [compared(0.9, 0.8, HEADLINE, f"template/view{n}") for n in range(40)]
    data = with_checks(pair("jade").data, checks)
    monkeypatch.setattr("inim.report.comparison_text.read_document", lambda *_: data)
    lines = accepted_lines(Path("out"))
    assert sum(line.startswith("worse: template/view") for line in lines) == 40
    assert not any(" more " in line for line in lines)


def test_other_differences_excuse_no_change():
    code = Change(name="package mine", baseline="1.0 a", candidate="1.0 b")
    comparison = msgspec.structs.replace(pair("jade").data.regression, circumstances=[code])
    assert also_changed(comparison) == [
        "also changed, which excuses no change: package mine: 1.0 a → 1.0 b"
    ]


def test_a_package_has_its_name_whatever_its_options(monkeypatch):
    monkeypatch.setattr("inim.pipeline.plan.identity", lambda *_: {"version": "1.0"})
    chosen = Algorithm("mine", lambda *_: None, chosen_options=(("turns", 3),))
    method = GeneratorMethod("mine:turns=3", chosen)
    packages = Plan.algorithm_packages.fget(SimpleNamespace(methods=[method]))
    assert packages == {"mine": {"version": "1.0"}}


@pytest.mark.parametrize(("width", "warned"), [(0.010004, None), (0.0104, "0.0104")])
def test_an_uncertainty_above_the_limit_is_also_printed_above_it(width, warned):
    score = ScoreEstimate(0.9, 0.0, 8.0, 0.0, 0.9, (0.9 - width, 0.9 + width))
    statistics = Statistics(scores={"template/left": {HEADLINE: score}})
    used = {"eia_spp": 128, "capture_spp": 256}
    plan = SimpleNamespace(settings=Settings(score_error=0.01, **used), by_need=("eia_spp",))
    results = {"template": SimpleNamespace(statistics=statistics)}
    warnings = Evaluation._sampling_warnings(SimpleNamespace(plan=plan, results=results))
    assert len(warnings) == (warned is not None)
    assert all(f"by {warned}, more than inim.score_error, 0.01;" in text for text in warnings)
    assert all("inim.eia_spp=128 and inim.capture_spp=256" in text for text in warnings)
