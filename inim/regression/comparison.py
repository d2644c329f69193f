"""A run against a baseline: verdicts, or why there can be none, and images of what changed.

Rendered pictures are compared by Welch's t-test in every tile, and by a size below which no change
counts. Differences are shown in codes: steps of an 8-bit panel, on the sRGB curve, of the tile's
mean or of the root of its power. Below one code a change could not be shown on a panel at all.

Times are compared only as ratios to the yardstick of the same round: other load of the machine
changes from round to round and affects both. Each round gives ``ln(time / yardstick)``. Two runs
are compared by the median of all pairwise differences of these, with its distribution-free interval
(`shift_of`): an interrupted round is one outlier among many and has no weight. Noise may explain a
slowdown only while it is small itself: an interval that holds both no change and 30 % more time
fails, as too few rounds do.
"""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from inim.display import Display
from inim.documents.parts import Change, Circumstances, Conditions, Drift
from inim.errors import BaselineError
from inim.regression.fingerprints import Fingerprint, compare_fingerprints, sampled_pixels
from inim.regression.run_statistics import RunStatistics
from inim.regression.scores import compare_scores
from inim.regression.tiles import TileStatistics
from inim.regression.verdict import (
    FALSE_ALARM_RATE,
    Verdict,
    shift_of,
    sidak,
    welch_half_width,
    welch_p_value,
    within,
)

#: One step of an 8-bit panel: a smaller difference of a tile's mean cannot be shown.
SMALLEST_CODES = 1.0
#: Noise of the ground truth may grow by this much in standard error: a tenth of the samples more
#: or less is 5 %, while half of them lost unnoticed is 41 %.
MOST_NOISE = 1.25
# Tests in a tile: three colours and the power.
_TESTS = 4


@dataclass(frozen=True)
class TileChange:
    """What changed between two pictures, tile by tile; the last axis is R, G, B, power.

    Attributes
    ----------
    codes : (R, C, 4) float64
        Change in 8-bit codes, candidate less baseline.
    limit : (R, C, 4) float64
        The largest that passes, in the direction of the change.
    half_width : (R, C, 4) float64
        Of the change's interval.
    p_value : (R, C, 4) float64
    """

    codes: np.ndarray
    limit: np.ndarray
    half_width: np.ndarray
    p_value: np.ndarray

    @property
    def failed(self) -> np.ndarray:
        """(R, C) bool; what is not finite has failed."""
        failed: np.ndarray = ~(np.abs(self.codes) <= self.limit).all(axis=-1)
        return failed


def codes_from_linear(linear: np.ndarray) -> np.ndarray:
    """8-bit codes of linear values by IEC 61966-2-1, neither rounded nor clipped; odd about 0."""
    size = np.abs(np.asarray(linear, np.float64))
    curve = 1.055 * np.power(np.maximum(size, 0.0031308), 1 / 2.4) - 0.055
    codes: np.ndarray = np.copysign(255 * np.where(size <= 0.0031308, 12.92 * size, curve), linear)
    return codes


def tile_change(baseline: TileStatistics, candidate: TileStatistics, level: float) -> TileChange:
    """Change of every tile, each tested at `level`.

    The t-test is on linear light, where halves of samples average; its half width and the change
    are then put on the curve of codes, from the baseline towards the candidate.
    """
    old, old_error, old_freedom = _together(baseline)
    new, new_error, new_freedom = _together(candidate)
    sides = (old_error, old_freedom, new_error, new_freedom)
    half = welch_half_width(*sides, level)
    towards = np.where(new >= old, 1.0, -1.0)
    start = _codes(old)
    width = np.abs(_codes(old + towards * half) - start)
    limit = np.maximum(SMALLEST_CODES, width)
    return TileChange(_codes(new) - start, limit, width, welch_p_value(new - old, *sides))


def _together(found: TileStatistics) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values, errors and degrees of freedom (R, C, 4), float64: three colours and the power."""
    least = found.freedom.min(axis=-1, keepdims=True)
    parts = (
        (found.mean, found.power[..., None]),
        (found.mean_error, found.power_error[..., None]),
        (found.freedom, least),
    )
    values, errors, freedom = (np.concatenate(p, axis=-1).astype(np.float64) for p in parts)
    return values, errors, freedom


def _codes(values: np.ndarray) -> np.ndarray:
    """Codes of three means and of the root of a power; an unbiased power may be below zero."""
    root = np.copysign(np.sqrt(np.abs(values[..., 3:])), values[..., 3:])
    return codes_from_linear(np.concatenate([values[..., :3], root], axis=-1))


def compare_pictures(
    baseline: Mapping[str, TileStatistics], candidate: Mapping[str, TileStatistics]
) -> list[Verdict]:
    """One verdict for each of the baseline's pictures, on its worst tile.

    Parameters
    ----------
    baseline, candidate : mapping of str to TileStatistics
        By the pictures' names. One that the candidate lacks, or has in another size, fails.
    """
    tests = sum(_TESTS * found.power.size for found in baseline.values())
    level = sidak(FALSE_ALARM_RATE, tests)
    return [_verdict(name, old, candidate.get(name), level) for name, old in baseline.items()]


def _verdict(name: str, old: TileStatistics, new: TileStatistics | None, level: float) -> Verdict:
    label = f"{name}: tiles against the baseline"
    if new is None or (new.shape, new.tile) != (old.shape, old.tile):
        found = "is missing" if new is None else f"has {new.shape[1]} x {new.shape[0]} pixels"
        detail = f"the picture {found}; the baseline has {old.shape[1]} x {old.shape[0]}"
        return within(
            label, "picture", math.nan, math.nan, SMALLEST_CODES, unit="codes", detail=detail
        )
    change = tile_change(old, new, level)
    excess = np.nan_to_num(np.abs(change.codes) / change.limit, nan=np.inf, posinf=np.inf)
    worst = np.unravel_index(int(np.argmax(excess)), excess.shape)
    row, column, which = (int(n) for n in worst)
    bad = int(np.count_nonzero(change.failed))
    where = f"worst in {'RGB'[which] if which < 3 else 'contrast'} at " + _place(new, row, column)
    return within(
        label,
        "picture",
        float(change.codes[worst]),
        float(change.half_width[worst]),
        SMALLEST_CODES,
        unit="codes",
        p_value=float(change.p_value[worst]),
        detail=f"{bad} of {new.power.size} tiles changed; {where}",
    )


def _place(found: TileStatistics, row: int, column: int) -> str:
    top, left = row * found.tile[0], column * found.tile[1]
    return f"rows {top} to {min(top + found.tile[0], found.shape[0]) - 1}, columns " + (
        f"{left} to {min(left + found.tile[1], found.shape[1]) - 1}"
    )


def compare_noise(
    baseline: Mapping[str, TileStatistics], candidate: Mapping[str, TileStatistics]
) -> Verdict:
    """Whether the ground truth is as sure as it was: noise hides changes, so it may not grow.

    The median over tiles and colours of the ratio of standard errors; of an unchanged renderer it
    is the root of the ratio of samples. Its interval is that of a median by order statistics.
    """
    ratios = np.sort(
        np.concatenate([_ratios(old, candidate.get(n)) for n, old in baseline.items()])
    )
    name = "ground truth: noise against the baseline"
    words = f"median over {ratios.size} tiles and colours of the ratio of standard errors"
    if ratios.size == 0:
        # Nothing was noisy, then or now: an unlit or a noiseless scene.
        quiet = all(_is_quiet(found) for found in candidate.values())
        value = 1.0 if quiet else math.inf
        detail = "no tile is noisy in both runs"
        return Verdict(name, "noise", value, "<=", MOST_NOISE, (value, value), quiet, detail=detail)
    value = float(np.median(ratios))
    interval = _median_interval(ratios)
    return Verdict(
        name, "noise", value, "<=", MOST_NOISE, interval, bool(value <= MOST_NOISE), detail=words
    )


def _ratios(old: TileStatistics, new: TileStatistics | None) -> np.ndarray:
    if new is None or new.mean_error.shape != old.mean_error.shape:
        return np.empty(0)
    noisy = (old.mean_error > 0) & (new.mean_error > 0)
    ratios: np.ndarray = (new.mean_error[noisy] / old.mean_error[noisy]).astype(np.float64)
    return ratios


def _is_quiet(found: TileStatistics) -> bool:
    return not (found.mean_error > 0).any()


def _median_interval(ordered: np.ndarray) -> tuple[float, float]:
    """Source: David and Nagaraja, Order Statistics, 2003, section 7.1."""
    from scipy.special import bdtr

    below = bdtr(np.arange(ordered.size), ordered.size, 0.5)
    k = int(np.searchsorted(below, FALSE_ALARM_RATE / 2))
    return float(ordered[max(0, k - 1)]), float(ordered[min(ordered.size - 1, ordered.size - k)])


#: Rendered without any generator: their noise is that of the ground truth.
TRUTH = "truth/"
# Changes are shown this many times larger, and those that failed at least this bright.
_GAIN = 8.0
_LEAST_SHOWN = 0.35
_BRIGHTER, _DARKER = np.array([1.0, 0.25, 0.05]), np.array([0.05, 0.3, 1.0])
# Lengths that follow from others may differ in the last bits between machines.
_SAME_LENGTH = 1e-9
# A value of conditions longer than this is not printed in an error; nor what rounding leaves.
_LONGEST_SHOWN, _DIGITS_SHOWN = 60, 9
_SHA256_DIGITS = 64
# Values of one condition.
_MOST_SHOWN = 3
_FOLLOWS = {"display as derived": "display"}
_TIME_CONDITIONS = ("processor", "threads")
_ALWAYS_NEW = ("created",)


def differing_conditions(before: Conditions, after: Conditions) -> list[str]:
    """What the two do not share, one phrase for each condition; empty if they can be compared.

    Such as "display: gap_mm 3.2, baseline 3.3".
    """
    baseline, candidate = msgspec.to_builtins(before), msgspec.to_builtins(after)
    names = [*baseline, *(name for name in candidate if name not in baseline)]
    changed = [n for n in names if not _same(baseline.get(n), candidate.get(n))]
    # What follows from others says nothing new.
    told = [n for n in changed if _FOLLOWS.get(n) not in changed]
    return [f"{name}{_difference(candidate.get(name), baseline.get(name))}" for name in told]


def _difference(new: Any, old: Any) -> str:
    """The values that differ; of tables, those in them."""
    if not (isinstance(new, Mapping) and isinstance(old, Mapping)):
        return f" {_shown(new)}, baseline {_shown(old)}"
    names = [name for name in {**old, **new} if not _same(new.get(name), old.get(name))]
    rows = [f"{name}{_difference(new.get(name), old.get(name))}" for name in names]
    more = f" and {len(rows) - _MOST_SHOWN} more" if len(rows) > _MOST_SHOWN else ""
    return f": {', '.join(rows[:_MOST_SHOWN])}{more}"


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return a.keys() == b.keys() and all(_same(a[key], b[key]) for key in a)
    if isinstance(a, (list, tuple)) and isinstance(b, (list, tuple)):
        return len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, float) or isinstance(b, float):
        numbers = isinstance(a, (int, float)) and isinstance(b, (int, float))
        return numbers and math.isclose(a, b, rel_tol=_SAME_LENGTH, abs_tol=_SAME_LENGTH)
    return type(a) is type(b) and bool(a == b)


def _shown(value: Any) -> str:
    if isinstance(value, str):
        return f"{value[:12]}…" if len(value) == _SHA256_DIGITS else value[:_LONGEST_SHOWN]
    if isinstance(value, float):
        return f"{value:.{_DIGITS_SHOWN}g}"
    if isinstance(value, (list, tuple)):  # a viewpoint: where, and what is given of its pupil
        text = f"[{', '.join(_shown(one) for one in value if one is not None)}]"
    else:
        text = "not there" if value is None else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _LONGEST_SHOWN else f"{text[: _LONGEST_SHOWN - 1]}…"


def check_comparable(baseline: RunStatistics, conditions: Conditions, where: str) -> None:
    """Raise `BaselineError` unless a run under these conditions can be compared.

    Parameters
    ----------
    baseline : RunStatistics
    conditions : Conditions
        Of the candidate; known before anything is rendered.
    where : str
        The baseline's place, for the message.
    """
    reasons = differing_conditions(baseline.conditions, conditions)
    if reasons:
        more = f" (and {len(reasons) - 3} more)" if len(reasons) > 3 else ""
        raise BaselineError(
            f"{where}: made under other conditions: {'; '.join(reasons[:3])}{more}; accept a "
            "baseline for these with inim baseline accept OUT --reason TEXT"
        )
    truth = [name for name in baseline.pictures if name.startswith(TRUTH)]
    if not (truth and baseline.scores):
        raise BaselineError(f"{where}: holds no picture or no score to compare; accept it anew")


def check_times(baseline: RunStatistics, circumstances: Circumstances, where: str) -> None:
    """Raise `BaselineError` unless times of a run under these circumstances can be compared.

    A ratio to the yardstick takes out how fast a machine is, not what it is good at: another
    processor, or another number of threads, has other ratios.
    """
    if not baseline.times:
        raise BaselineError(
            f"{where}: has no times; accept one of a run with --time, or leave --time out"
        )
    for name in _TIME_CONDITIONS:
        old, new = getattr(baseline.circumstances, name), getattr(circumstances, name)
        if old != new:
            raise BaselineError(
                f"{where}: its times are of {name} {old!r}, not {new!r}; accept a baseline here, "
                "or leave --time out"
            )


def compare(baseline: RunStatistics, candidate: RunStatistics, where: str) -> list[Verdict]:
    """Verdicts on pictures, noise, scores, EIAs of the reference input and, where known, times.

    Parameters
    ----------
    baseline, candidate : RunStatistics
    where : str
        The baseline's place, for messages.

    Raises
    ------
    BaselineError
        The two were made under conditions that differ.
    """
    check_comparable(baseline, candidate.conditions, where)
    truth_old, truth_new = (_truth(side) for side in (baseline, candidate))
    noise = compare_noise(truth_old, truth_new)
    verdicts = [
        *compare_pictures(baseline.pictures, candidate.pictures),
        noise,
        *compare_scores(baseline.scores, candidate.scores, noise.value),
        *compare_fingerprints(baseline.fingerprints, candidate.fingerprints),
    ]
    if candidate.times:
        check_times(baseline, candidate.circumstances, where)
        verdicts += compare_times(baseline.times, candidate.times)
    return verdicts


def _truth(side: RunStatistics) -> dict[str, Any]:
    return {name: found for name, found in side.pictures.items() if name.startswith(TRUTH)}


def changed_circumstances(baseline: RunStatistics, candidate: RunStatistics) -> list[Change]:
    """Other differences, without a verdict: versions, samples, seed, machine."""
    before, after = map(msgspec.to_builtins, (baseline.circumstances, candidate.circumstances))
    return [
        Change(name=name, baseline=before.get(name), candidate=after.get(name))
        for name in dict.fromkeys([*before, *after])
        if before.get(name) != after.get(name) and name not in _ALWAYS_NEW
    ]


def drift(baseline: RunStatistics, candidate: RunStatistics) -> list[Drift]:
    """Every reported number of both runs, by what was scored and the score's name."""
    rows = []
    for what, scores in candidate.reported.items():
        for name, new in scores.items():
            old = baseline.reported.get(what, {}).get(name)
            change = None if old is None or new is None else float(new) - float(old)
            if change is not None and not math.isfinite(change):
                change = None
            rows.append(Drift(what=what, score=name, baseline=old, candidate=new, change=change))
    return rows


def tile_pictures(
    baseline: TileStatistics, candidate: TileStatistics
) -> tuple[np.ndarray, np.ndarray]:
    """The baseline's tiles and their change, each (rows, columns, 3) float32, linear RGB.

    Red grew brighter, blue darker; only tiles that failed are in colour, others at a tenth.
    """
    change = tile_change(baseline, candidate, sidak(FALSE_ALARM_RATE, 4 * baseline.power.size))
    codes = np.nan_to_num(change.codes, nan=255.0)
    largest = np.argmax(np.abs(codes), axis=-1)[..., None]
    signed = np.take_along_axis(codes, largest, axis=-1)[..., 0]
    size = np.minimum(1.0, _GAIN * np.abs(signed) / 255)
    size = np.where(change.failed, np.maximum(size, _LEAST_SHOWN), 0.1 * size)
    colour = np.where((signed > 0)[..., None], _BRIGHTER, _DARKER) * size[..., None]
    return _enlarged(np.nan_to_num(baseline.mean), baseline), _enlarged(colour, baseline)


def _enlarged(tiles: np.ndarray, found: TileStatistics) -> np.ndarray:
    whole = np.repeat(np.repeat(tiles, found.tile[0], axis=0), found.tile[1], axis=1)
    cut: np.ndarray = whole[: found.shape[0], : found.shape[1]].astype(np.float32)
    return cut


def changed_pixels(old: Fingerprint, new: Fingerprint, display: Display) -> np.ndarray:
    """Where the sampled pixels of the reference input's EIA are: grey if equal, red if changed."""
    picture = np.zeros((*display.eia_shape, 3), np.float32)
    flat = picture.reshape(-1, 3)
    changed = (np.abs(old.sample.astype(np.int16) - new.sample) > 1).any(axis=-1)
    at = sampled_pixels(display)
    flat[at] = 0.2
    flat[at[changed]] = _BRIGHTER
    return picture


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
    return [_time_verdict(n, old, candidate.get(n, ()), level) for n, old in baseline.items()]


def _time_verdict(name: str, old: Sequence[float], new: Sequence[float], level: float) -> Verdict:
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
