"""Comparisons of several reports: paired differences over relics."""

from pathlib import Path

import msgspec
import pytest
from scipy import stats

from inim.pipeline.compare import Pair, all_lines, paired_differences
from inim.scores.document_parts import Check
from inim.scores.metrics import HEADLINE
from inim.scores.regression.document import CompareDocument
from inim.scores.regression.scores import score_label
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
    data = msgspec.convert(text, CompareDocument)
    data = msgspec.structs.replace(
        data, verdict=msgspec.structs.replace(data.verdict, passed=False, checks=checks)
    )
    return Pair(Path("a"), Path("b"), Path("c"), data)


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
