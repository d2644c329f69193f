"""A run against a baseline: verdicts, or why there can be none, and images of what changed."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from inim.display import Display
from inim.errors import BaselineError
from inim.regression.fingerprints import Fingerprint, compare_fingerprints, sampled_pixels
from inim.regression.inference import FALSE_ALARM_RATE, sidak
from inim.regression.run_statistics import RunStatistics
from inim.regression.scores import compare_scores
from inim.regression.tile_changes import compare_noise, compare_pictures, tile_change
from inim.regression.tiles import TileStatistics
from inim.regression.times import compare_times
from inim.regression.verdict import Verdict

__all__ = [
    "changed_circumstances",
    "changed_pixels",
    "check_comparable",
    "check_times",
    "compare",
    "drift",
    "tile_pictures",
]

#: Rendered without any generator: their noise is that of the ground truth.
TRUTH = "truth/"
# Changes are shown this many times larger, and those that failed at least this bright.
_GAIN = 8.0
_LEAST_SHOWN = 0.35
_BRIGHTER, _DARKER = np.array([1.0, 0.25, 0.05]), np.array([0.05, 0.3, 1.0])
# Lengths that follow from others may differ in the last bits between machines.
_SAME_LENGTH = 1e-9
# A value of conditions longer than this is not printed in an error.
_LONGEST_SHOWN = 60
_TIME_CONDITIONS = ("processor", "threads")
_ALWAYS_NEW = ("created",)


def differing_conditions(baseline: Mapping[str, Any], candidate: Mapping[str, Any]) -> list[str]:
    """What the two do not share, one phrase for each condition; empty if they can be compared."""
    names = [*baseline, *(name for name in candidate if name not in baseline)]
    return [
        f"{name} is {_shown(candidate.get(name))}, the baseline's {_shown(baseline.get(name))}"
        for name in names
        if not _same(baseline.get(name), candidate.get(name))
    ]


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
    text = "not there" if value is None else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _LONGEST_SHOWN else f"{text[: _LONGEST_SHOWN - 1]}…"


def check_comparable(baseline: RunStatistics, conditions: Mapping[str, Any], where: str) -> None:
    """Raise `BaselineError` unless a run under these conditions can be compared.

    Parameters
    ----------
    baseline : RunStatistics
    conditions : mapping
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


def check_times(baseline: RunStatistics, circumstances: Mapping[str, Any], where: str) -> None:
    """Raise `BaselineError` unless times of a run under these circumstances can be compared.

    A ratio to the yardstick takes out how fast a machine is, not what it is good at: another
    processor, or another number of threads, has other ratios.
    """
    if not baseline.times:
        raise BaselineError(
            f"{where}: has no times; accept one of a run with --time, or leave --time out"
        )
    for name in _TIME_CONDITIONS:
        old, new = baseline.circumstances.get(name), circumstances.get(name)
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


def changed_circumstances(
    baseline: RunStatistics, candidate: RunStatistics
) -> list[dict[str, Any]]:
    """What else differs, without a verdict: versions, samples, seed, machine."""
    names = [*baseline.circumstances, *candidate.circumstances]
    rows = []
    for name in dict.fromkeys(names):
        old, new = baseline.circumstances.get(name), candidate.circumstances.get(name)
        if old != new and name not in _ALWAYS_NEW:
            rows.append({"name": name, "baseline": old, "candidate": new})
    return rows


def drift(baseline: RunStatistics, candidate: RunStatistics) -> list[dict[str, Any]]:
    """Every reported number of both runs, by what was scored and the score's name."""
    rows = []
    for what, scores in candidate.reported.items():
        for name, new in scores.items():
            old = baseline.reported.get(what, {}).get(name)
            change = None if old is None or new is None else float(new) - float(old)
            if change is not None and not math.isfinite(change):
                change = None
            row = {"what": what, "score": name, "baseline": old, "candidate": new}
            rows.append(row | {"change": change})
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
