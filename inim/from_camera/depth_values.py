"""What the numbers of a depth picture mean: unit, direction, and which of them are none.

What is stated is taken, and checked; what is not stated is detected, with a warning.

Direction is seen by two habits of pictures: what is at the bottom is nearer than what is at the
top (floors, tables), and what is in the middle is nearer than what is along the rim (relics before
a background). Where the two do not agree, nothing is decided.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inim.errors import FileError, UsageError
from inim.from_camera.picture_files import DepthFile

FILL_RULES = ("none", "nearest", "behind", "far")

_UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
# A macro lens and the far end of a street: no camera that measures depth goes beyond either.
_NEAREST_MEDIAN_MM = 10.0
_FARTHEST_MEDIAN_MM = 150_000.0
# Depth cameras of rooms and relics reach less far.
_FAR_MEDIAN_MM = 10_000.0
# Below this many numbers a picture is a map of grey values, above it a sensor's millimetres.
_MOST_GREYS = 256
# From here on the largest number a file can hold is more likely "nothing" than a depth.
_SATURATED_SHARE = 0.01
# For statistics: enough for quantiles to a thousandth, little against a 20-megapixel picture.
_MOST_SAMPLED = 2**20
# By this part of the range the medians of two regions must differ to say anything.
_TELLING = 0.1


@dataclass(frozen=True)
class Meaning:
    """What is stated of a depth picture; None: nothing.

    Attributes
    ----------
    unit_mm : float or None
        Millimetres of one unit; 0 for numbers that are stated to have no unit.
    near_is_large : bool or None
    missing : tuple of float
        Numbers that mean "no depth", beside what is not finite.
    range_stated : bool
        Whether the user vouches for the distances by stating near and far.
    """

    unit_mm: float | None = None
    near_is_large: bool | None = None
    missing: tuple[float, ...] = ()
    range_stated: bool = False


@dataclass(frozen=True)
class DepthValues:
    """Depth whose meaning is known.

    Attributes
    ----------
    depth : (H, W) float32
        Millimetres, or plain numbers where there is no unit; NaN where missing.
    near_is_large : bool
    has_unit : bool
    step : float
        Difference of neighbouring numbers of the file, in the same unit; 0 for floats.
    warnings : tuple of str
    inverse_step : float
        Difference of their inverses, where a file has those in even steps.
    """

    depth: NDArray[np.float32]
    near_is_large: bool
    has_unit: bool
    step: float
    warnings: tuple[str, ...]
    inverse_step: float = 0.0


def parse_unit(text: str) -> float:
    """Millimetres per unit of ``mm``, ``cm``, ``m``, ``none`` (0), or of a number per metre.

    Raises
    ------
    UsageError
        Anything else.
    """
    if text in _UNITS_MM:
        return _UNITS_MM[text]
    if text == "none":
        return 0.0
    try:
        per_metre = float(text)
    except ValueError:
        per_metre = math.nan
    if not 0 < per_metre < math.inf:
        raise UsageError(
            f"--depth-unit {text}: use mm, cm, m, none, or how many units make a metre (5000)"
        )
    return 1000.0 / per_metre


def read_meaning(file: DepthFile, stated: Meaning, name: str) -> DepthValues:
    """What the numbers of a depth picture mean.

    Parameters
    ----------
    file : DepthFile
    stated : Meaning
    name : str
        Of the file, for messages.

    Raises
    ------
    FileError
        No pixel has a depth, or the distances cannot be those of a picture.
    UsageError
        The direction is neither stated nor to be seen.
    """
    warnings: list[str] = []
    unit = stated.unit_mm
    if unit is None:
        unit, reason = _detected_unit(file)
        warnings.append(f"{name}: unit of depth not stated; {reason}; say --depth-unit")
    distances = unit > 0 and not stated.near_is_large
    depth = file.values.copy()
    none = ~np.isfinite(depth)
    if distances:
        none |= depth <= 0
    for number in stated.missing:
        none |= file.values == np.float32(number)
    depth[none] = np.nan
    if none.all():
        raise FileError(
            f"{name}: no pixel has a depth (all {none.size} are 0, not finite or --missing); "
            "it is the wrong file, or was saved by a program that does not keep 16 bits"
        )
    scale = unit if unit > 0 else 1.0
    depth *= np.float32(scale)
    if not stated.missing:
        warnings += _saturated(file, name)
    if distances and not stated.range_stated:
        warnings += _check_distances(depth, file, name, unit)
    seen = _seen_direction(depth)
    if stated.near_is_large is None:
        near_is_large, words = _detected_direction(seen, unit, name)
        warnings += words
    else:
        near_is_large = stated.near_is_large
    if seen is not None and seen != near_is_large and stated.near_is_large is not None:
        word, other = _direction_words(near_is_large)
        warnings.append(
            f"{name}: the depth looks inverted: the middle and the bottom would lie behind the rim "
            f"and the top with {word}; if the result is inside out, say {other}"
        )
    step = scale if file.largest is not None else 0.0
    return DepthValues(depth, near_is_large, unit > 0, step, tuple(warnings))


def sample(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Known depths of evenly spread pixels, at most about a million."""
    stride = max(1, math.ceil(math.sqrt(depth.size / _MOST_SAMPLED)))
    some = depth[stride // 2 :: stride, stride // 2 :: stride]
    known: NDArray[np.float32] = some[~np.isnan(some)]
    return known if known.size else depth[~np.isnan(depth)][:_MOST_SAMPLED]


def _detected_unit(file: DepthFile) -> tuple[float, str]:
    known = file.values[np.isfinite(file.values) & (file.values > 0)]
    if not known.size:
        return 0.0, "took none"
    middle = float(np.median(known[:: max(1, known.size // _MOST_SAMPLED)]))
    if file.largest is not None and file.largest >= _MOST_GREYS and float(known.max()) >= 300:
        return 1.0, f"took mm, as whole numbers about {middle:.4g} mostly are"
    if file.largest is None and 0.05 < middle < 100 and float(known.max()) > 1:
        return 1000.0, f"took m, as floats about {middle:.4g} mostly are"
    return 0.0, f"took none: numbers about {middle:.4g} are a map of depth without a scale"


def _saturated(file: DepthFile, name: str) -> list[str]:
    if file.largest is None or file.largest < _MOST_GREYS:
        return []
    share = np.count_nonzero(file.values == file.largest) / file.values.size
    if share < _SATURATED_SHARE:
        return []
    return [
        f"{name}: {share:.1%} of the depths are {file.largest}, the largest number there is; if "
        f"that means no depth, say --missing {file.largest}"
    ]


def _check_distances(
    depth: NDArray[np.float32], file: DepthFile, name: str, unit: float
) -> list[str]:
    middle = float(np.median(sample(depth)))
    if middle > _FAR_MEDIAN_MM and middle <= _FARTHEST_MEDIAN_MM:
        return [
            f"{name}: a median depth of {middle / 1000:.4g} m is far for a depth camera; if the "
            "file has 5000 units to the metre, as some have, say --depth-unit 5000"
        ]
    if _NEAREST_MEDIAN_MM <= middle <= _FARTHEST_MEDIAN_MM:
        return []
    stored = middle / unit
    guess, _ = _detected_unit(file)
    likely = {1.0: "mm", 1000.0: "m"}.get(guess)
    right = f"--depth-unit {likely} would" if likely and guess != unit else "another unit may"
    raise FileError(
        f"{name}: the median depth {stored:.4g} would be {middle / 1000:.4g} m in the stated unit "
        f"({unit:g} mm): wrong --depth-unit; {right} make sense, or vouch for it with --near and "
        "--far in mm"
    )


def _seen_direction(depth: NDArray[np.float32]) -> bool | None:
    """Whether near looks large; None where the picture does not say."""
    stride = max(1, math.ceil(max(depth.shape) / 512))
    small = depth[::stride, ::stride]
    rows, columns = small.shape
    if rows < 6 or columns < 6:
        return None
    rim = np.ones(small.shape, bool)
    rim[rows // 8 :, columns // 8 : -(columns // 8)] = False
    middle = np.zeros(small.shape, bool)
    middle[rows // 4 : -(rows // 4), columns // 4 : -(columns // 4)] = True
    known = small[~np.isnan(small)]
    if not known.size:
        return None
    low, high = np.quantile(known, (0.05, 0.95))
    if high <= low:
        return None
    span = float(high - low)
    upper, lower = small[: rows // 3], small[-(rows // 3) :]
    votes = [
        (_median(lower) - _median(upper)) / span,
        (_median(small[middle]) - _median(small[rim])) / span,
    ]
    if any(math.isnan(vote) for vote in votes) or max(map(abs, votes)) < _TELLING:
        return None
    if min(votes) > -_TELLING:
        return True
    return False if max(votes) < _TELLING else None


def _median(values: np.ndarray) -> float:
    known = values[~np.isnan(values)]
    return float(np.median(known)) if known.size else math.nan


def _detected_direction(seen: bool | None, unit: float, name: str) -> tuple[bool, list[str]]:
    if unit > 0:  # a distance grows away from the camera
        if not seen:
            return False, []
        return False, [
            f"{name}: the depth looks inverted: the middle and the bottom would lie behind the rim "
            "and the top; taken as distances nevertheless, say --near-is-large if they are not"
        ]
    if seen is None:
        raise UsageError(
            f"{name}: depth without a unit, and its direction cannot be seen in it; say "
            "--near-is-large (white is near) or --far-is-large"
        )
    took, other = _direction_words(seen)
    return seen, [
        f"{name}: direction of depth not stated; took {took}, as the middle and the bottom are "
        f"mostly nearer than the rim and the top; say {took} or {other}"
    ]


def _direction_words(near_is_large: bool) -> tuple[str, str]:
    words = ("--near-is-large", "--far-is-large")
    return words if near_is_large else (words[1], words[0])


def fill_missing(
    depth: NDArray[np.float32], rule: str, *, near_is_large: bool = False
) -> NDArray[np.float32]:
    """Depth with its missing pixels, NaN, filled.

    Parameters
    ----------
    depth : (H, W) float32
    rule : str
        One of `FILL_RULES`.
    near_is_large : bool
        Whether numbers grow towards the viewer.

    Returns
    -------
    (H, W) float32
        NaN where the rule found nothing; the input itself where there is nothing to do.
    """
    empty = np.isnan(depth)
    if rule == "none" or not empty.any() or empty.all():
        return depth
    if rule == "nearest":
        from scipy.ndimage import distance_transform_edt

        rows, columns = distance_transform_edt(empty, return_distances=False, return_indices=True)
        nearest: NDArray[np.float32] = depth[rows, columns]
        return nearest
    farther = np.fmin if near_is_large else np.fmax
    if rule == "far":
        farthest = np.float32(farther.reduce(depth[~empty]))
        return np.where(empty, farthest, depth)
    filled = depth.copy()
    for row in filled:  # a row at a time: no array of the picture's size per step
        known = np.flatnonzero(~np.isnan(row))
        gaps = np.flatnonzero(np.isnan(row))
        if known.size and gaps.size:
            after = np.searchsorted(known, gaps)
            left = np.where(after > 0, row[known[after - 1]], np.float32(np.nan))
            right = row[known[np.minimum(after, known.size - 1)]]
            right = np.where(after < known.size, right, np.float32(np.nan))
            row[gaps] = farther(left, right)
    return filled
