"""Fronts of time against error that respect noise."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean

import numpy as np

from inim.pipeline.timing import Timing, mean_ratio
from inim.scores import metrics
from inim.scores.regression.scores import INTERVAL_LEVEL, ScoreEstimate, difference
from inim.scores.regression.verdict import binomial_interval, sidak

#: Key of the share of wrong sources among the errors.
WRONG_SOURCE = "wrong_source"


@dataclass(frozen=True)
class Entry:
    """Time and errors of an algorithm, as far as comparisons need them.

    `wrong`, (n,) bool, are the checked panel pixels with a wrong source; None if unknown. `scores`
    are by viewpoint, then by key. `is_sampled` is False if all panel pixels were checked.
    """

    timing: Timing
    wrong: np.ndarray | None
    scores: Mapping[str, Mapping[str, ScoreEstimate]]
    is_sampled: bool = True

    @property
    def keys(self) -> list[str]:
        """Keys of its errors."""
        scores = next(iter(self.scores.values()), {})
        keys = [metric.on_relic_to_reference_key for metric in metrics.all_metrics()]
        sources = [] if self.wrong is None else [WRONG_SOURCE]
        return sources + [key for key in keys if key in scores]


def fronts(entries: Mapping[str, Entry]) -> dict[str, list[str]]:
    """Errors on whose fronts each entry is, by name.

    An entry is on the front of an error unless another is significantly better in time or in the
    error, and not significantly worse in the other. The level of better is corrected for the number
    of pairs; that of worse is not, so that few runs exclude no entry. A single run excludes none.
    """
    keys = list(dict.fromkeys(key for entry in entries.values() for key in entry.keys))
    level = sidak(INTERVAL_LEVEL, max(1, len(entries) * (len(entries) - 1) // 2))
    result: dict[str, list[str]] = {name: [] for name in entries}
    for key in keys:
        rivals = {name: entry for name, entry in entries.items() if key in entry.keys}
        for name, entry in rivals.items():
            others = [other for other in rivals.values() if other is not entry]
            if not any(_is_beaten(key, entry, other, level) for other in others):
                result[name].append(key)
    return result


def _is_beaten(key: str, entry: Entry, other: Entry, level: float) -> bool:
    """True if an entry is worse at a level than another, and not better at the usual level."""
    if min(len(entry.timing.times_s), len(other.timing.times_s)) < 2:
        return False
    strict, usual = (
        (_sign_of_times(entry, other, level), _sign_of_errors(key, entry, other, level))
        for level in (level, INTERVAL_LEVEL)
    )
    return max(strict) > 0 and min(usual) >= 0


def _sign(interval: Sequence[float], neutral: float = 0.0) -> int:
    """1 or -1 if an interval is above or below a value; 0 if it contains it or is unknown."""
    low, high = interval
    return int(low > neutral) - int(high < neutral)


def _sign_of_times(entry: Entry, other: Entry, level: float) -> int:
    """1 if an entry is significantly slower than another, -1 if faster."""
    return _sign(mean_ratio(entry.timing, other.timing, level)[1], 1.0)


def _sign_of_errors(key: str, entry: Entry, other: Entry, level: float) -> int:
    """1 if an entry is significantly worse than another, -1 if better."""
    if key == WRONG_SOURCE:
        assert entry.wrong is not None and other.wrong is not None
        more, fewer = (
            int(np.count_nonzero(a & ~b))
            for a, b in ((entry.wrong, other.wrong), (other.wrong, entry.wrong))
        )
        if not entry.is_sampled:
            return int(more > fewer) - int(more < fewer)
        # Sign test of the pixels that only one of them shows wrongly.
        return _sign(binomial_interval(more, more + fewer, level), 0.5) if more + fewer else 0
    metric = metrics.find(key)
    assert metric is not None
    intervals = [
        difference(scores[key], other.scores[view][key], level)[1]
        for view, scores in entry.scores.items()
    ]
    low, high = (fmean(ends) for ends in zip(*intervals, strict=True))
    return -_sign((low, high)) if metric.better == "higher" else _sign((low, high))
