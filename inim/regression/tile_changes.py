"""Verdicts on rendered pictures: Welch's t-test in every tile, and a size below which none counts.

Differences are shown in codes: steps of an 8-bit panel, on the sRGB curve, of the tile's mean or
of the root of its power. Below one code a change could not be shown on a panel at all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from inim.regression.inference import (
    FALSE_ALARM_RATE,
    sidak,
    welch_half_width,
    welch_p_value,
)
from inim.regression.tiles import TileStatistics
from inim.regression.verdict import Verdict, within

__all__ = ["SMALLEST_CODES", "TileChange", "compare_noise", "compare_pictures", "tile_change"]

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
