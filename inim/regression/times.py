"""Verdicts on times: only as ratios to the yardstick of the same round, only with their spread.

What else a machine does changes from round to round and hits generator and yardstick alike. So
each round gives ``ln(time / yardstick)``, and two runs are compared by the median of all pairwise
differences of these, with its distribution-free interval (`shift_of`): a round that the
system interrupted is one outlier among many and carries no weight.

Noise may explain a slowdown only while it is small itself: an interval that holds no change and
30 % more time alike says nothing. It fails, as too few rounds do.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence

from inim.regression.verdict import FALSE_ALARM_RATE, Verdict, shift_of, sidak

#: Fewer rounds say nothing: with nine on each side the interval still has an end at this level.
LEAST_ROUNDS = 9
#: A slowdown below this passes: from one process to the next, where code and data come to lie in
#: memory changes ratios by some per cent, and rounds of one process do not show it.
MOST_SLOWDOWN = 1.15
# What no amount of noise may hide.
_NEVER_HIDDEN = 1.3


def log_ratios(times_s: Sequence[float], yardstick_s: Sequence[float]) -> tuple[float, ...]:
    """Natural logarithms of time over yardstick, round by round, of the rounds both were in."""
    return tuple(math.log(t / y) for t, y in zip(times_s, yardstick_s, strict=False))


def yardsticks(ratios: Sequence[float]) -> float:
    """Median time in yardsticks, from `log_ratios`."""
    return math.exp(statistics.median(ratios))


def is_steady(ratios: Sequence[float]) -> bool:
    """Whether a run with these `log_ratios` can be told from one slower by `MOST_SLOWDOWN`.

    Two runs that scatter as this one does would have an interval no wider than that to either side.
    """
    if len(ratios) < LEAST_ROUNDS:
        return False
    return shift_of(ratios, ratios, FALSE_ALARM_RATE).high <= math.log(MOST_SLOWDOWN)


def compare_times(
    baseline: Mapping[str, Sequence[float]], candidate: Mapping[str, Sequence[float]]
) -> list[Verdict]:
    """One verdict for each algorithm of the baseline: only slower fails.

    Parameters
    ----------
    baseline, candidate : mapping of str to sequence of float
        `log_ratios` by algorithm. One with fewer than `LEAST_ROUNDS` fails, and one that scatters
        so much that 30 % more time could hide in it.
    """
    level = sidak(FALSE_ALARM_RATE, len(baseline))
    return [_verdict(n, old, candidate.get(n, ()), level) for n, old in baseline.items()]


def _verdict(name: str, old: Sequence[float], new: Sequence[float], level: float) -> Verdict:
    label = f"{name}: time against the baseline"
    rounds = min(len(old), len(new))
    shift = shift_of(new, old, level)
    limit = MOST_SLOWDOWN
    # Where the interval reaches down to no change, noise explains the shift.
    if shift.low <= 0:
        limit = max(limit, math.exp(max(shift.value, 0.0)) if math.isfinite(shift.value) else 0.0)
    value = math.exp(shift.value)
    known = rounds >= LEAST_ROUNDS and math.isfinite(value)
    hidden = shift.low <= 0 and shift.high > math.log(_NEVER_HIDDEN)
    passed = bool(known and not hidden and value <= limit)
    detail = f"{_words(new)} yardsticks, baseline {_words(old)}; {rounds} rounds"
    if rounds < LEAST_ROUNDS:
        detail += f", {LEAST_ROUNDS} needed"
    elif hidden:
        detail += "; they scatter too much to tell: time both on a quiet machine"
    interval = (math.exp(shift.low), math.exp(min(shift.high, 700.0)))
    return Verdict(
        label, "time", value, "<=", limit, interval, passed, "times", shift.p_value, detail
    )


def _words(ratios: Sequence[float]) -> str:
    return f"{yardsticks(ratios):.3g}" if ratios else "no"
