"""Comparison of a made suite with the published one: equal up to the noise of the renderer."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from inim.apps.benchmark.document import Statistic, StatisticsDocument
from inim.apps.benchmark.suite import MadeCase
from inim.scores.regression.verdict import sidak, welch_p_value
from inim.system.document import read_document

#: Statistics of the published suite.
PUBLISHED = Path(__file__).with_name("statistics.json")
# Probability that a suite of equal scenes is called another one.
_FALSE_ALARM = 1e-3
# Errors are those of eight replicates.
_FREEDOM = 7.0
# Pixels on edges may differ by rounding.
_MOST_SHARE = 2e-3
# Rounding of an image without noise, such as a black channel.
_LEAST_ERROR = 1e-6


def suite_mistakes(cases: Sequence[MadeCase]) -> list[str]:
    """Sentences on changed files, and on statistics that differ from the published ones."""
    mistakes = [
        f"{case.folder / name}: is not the file that was made; delete {case.folder} and make it "
        "again"
        for case in cases
        for name in case.changed_files()
    ]
    published = read_document(PUBLISHED, "install inim again", StatisticsDocument).cases
    pairs = [
        (case.case.name, name, published[case.case.name][name], case.manifest.statistics.get(name))
        for case in cases
        for name in published.get(case.case.name, {})
    ]
    mistakes += [
        f"{case.case.name}: its statistics are not published; nothing tells whether it is the same "
        "on all machines"
        for case in cases
        if case.case.name not in published
    ]
    level = sidak(_FALSE_ALARM, 3 * len(pairs))
    for case, name, expected, statistic in pairs:
        if statistic is None or differs(statistic, expected, level):
            mistakes.append(
                f"{case}: {name} differs from the published suite, {_words(statistic)} instead of "
                f"{_words(expected)}; its scores are not comparable with published ones"
            )
    return mistakes


def differs(statistic: Statistic, expected: Statistic, level: float) -> bool:
    """True if two means or shares differ by more than noise, in one of three colours."""
    if abs(statistic.share - expected.share) > _MOST_SHARE:
        return True
    change = np.subtract(statistic.mean, expected.mean)
    errors = [np.maximum(s.error, _LEAST_ERROR) for s in (statistic, expected)]
    freedom = np.full(3, _FREEDOM)
    p_values = welch_p_value(change, errors[0], freedom, errors[1], freedom)
    return bool((p_values < level).any())


def _words(statistic: Statistic | None) -> str:
    if statistic is None:
        return "nothing"
    return "mean " + " ".join(f"{value:.5f}" for value in statistic.mean)
