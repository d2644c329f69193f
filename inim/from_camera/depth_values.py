"""Interpretation of a depth picture's numbers: unit, direction and missing values.

Properties given by the user are checked. The others are detected, with a warning.

The direction follows from two regularities of pictures: the bottom is nearer than the top (floors,
tables), and the middle is nearer than the rim (relics before a background). Where the two disagree,
the direction stays undecided.
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
# From a macro lens to the far end of a street: the range of all depth cameras.
_NEAREST_MEDIAN_MM = 10.0
_FARTHEST_MEDIAN_MM = 150_000.0
# Depth cameras for interiors and relics have a shorter range.
_FAR_MEDIAN_MM = 10_000.0
# Files with at most this many levels hold grey values, others a sensor's millimetres.
_MOST_GREYS = 256
# Above this share of the pixels, the largest number probably means "no depth".
_SATURATED_SHARE = 0.01
# Sample size for statistics: gives quantiles to a thousandth.
_MOST_SAMPLED = 2**20
# Medians of two regions differ significantly from this share of the range on.
_SIGNIFICANT = 0.1


@dataclass(frozen=True)
class DepthConvention:
    """Properties of a depth picture that the user gives; None: to be detected."""

    unit_mm: float | None = None  #: Millimetres per unit; 0 for numbers without a unit.
    near_is_large: bool | None = None
    #: Numbers that mean "no depth"; infinite values and NaN always do.
    missing: tuple[float, ...] = ()
    has_range: bool = False  #: True if the user confirms the distances by giving both near and far.


@dataclass(frozen=True)
class DepthValues:
    """Depth with its unit and direction."""

    #: (H, W) float32: millimetres, or raw values if unitless; NaN where missing.
    depth: NDArray[np.float32]
    near_is_large: bool
    has_unit: bool
    step: float  #: Quantisation step of the file, in the same unit; 0 for floats.
    warnings: tuple[str, ...]
    #: Quantisation step of the inverse depth, for files that quantise it; otherwise 0.
    inverse_step: float = 0.0


def parse_unit(text: str) -> float:
    """Millimetres per unit of ``mm``, ``cm``, ``m``, ``none`` (0) or a number per metre."""
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
            f"--depth-unit {text}: use mm, cm, m, none, or the number of units per metre (5000)"
        )
    return 1000.0 / per_metre


def interpret_depth(file: DepthFile, convention: DepthConvention, name: str) -> DepthValues:
    """Interpret the numbers of a depth picture.

    * `convention`: properties given by the user.
    * `name`: file name for messages.

    Raises `FileError`: no pixel has a depth, or the distances are implausible. `UsageError`: the
    direction is not given and cannot be detected.
    """
    warnings: list[str] = []
    unit = convention.unit_mm
    if unit is None:
        unit, reason = _detect_unit(file)
        warnings.append(f"{name}: no depth unit given; {reason}; set it with --depth-unit")
    is_distance = unit > 0 and not convention.near_is_large
    depth = file.values.copy()
    empty = ~np.isfinite(depth)
    if is_distance:
        empty |= depth <= 0
    for number in convention.missing:
        empty |= file.values == np.float32(number)
    depth[empty] = np.nan
    if empty.all():
        raise FileError(
            f"{name}: no pixel has a depth (all {empty.size} are 0, not finite or --missing); "
            "check that it is the right file and was saved with 16 bits"
        )
    scale = unit if unit > 0 else 1.0
    depth *= np.float32(scale)
    if not convention.missing:
        warnings += _saturation_warnings(file, name)
    if is_distance and not convention.has_range:
        warnings += _check_distances(depth, file, name, unit)
    detected = _detect_direction(depth)
    near_is_large = convention.near_is_large
    if near_is_large is None:
        near_is_large, messages = _choose_direction(detected, unit, name)
        warnings += messages
    elif detected is not None and detected != near_is_large:
        option, opposite = _direction_options(near_is_large)
        warnings.append(
            f"{name}: the depth looks inverted: with {option}, the middle and the bottom are "
            f"behind the rim and the top; if the result is inside out, use {opposite}"
        )
    step = scale if file.largest is not None else 0.0
    return DepthValues(depth, near_is_large, unit > 0, step, tuple(warnings))


def sample(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Valid depths of evenly spaced pixels, at most about a million."""
    stride = max(1, math.ceil(math.sqrt(depth.size / _MOST_SAMPLED)))
    subset = depth[stride // 2 :: stride, stride // 2 :: stride]
    valid: NDArray[np.float32] = subset[~np.isnan(subset)]
    return valid if valid.size else depth[~np.isnan(depth)][:_MOST_SAMPLED]


def _detect_unit(file: DepthFile) -> tuple[float, str]:
    valid = file.values[np.isfinite(file.values) & (file.values > 0)]
    if not valid.size:
        return 0.0, "assumed none"
    middle = float(np.median(valid[:: max(1, valid.size // _MOST_SAMPLED)]))
    if file.largest is not None and file.largest >= _MOST_GREYS and float(valid.max()) >= 300:
        return 1.0, f"assumed mm, as usual for integers around {middle:.4g}"
    if file.largest is None and 0.05 < middle < 100 and float(valid.max()) > 1:
        return 1000.0, f"assumed m, as usual for floats around {middle:.4g}"
    return 0.0, f"assumed none, as usual for depth maps with values around {middle:.4g}"


def _saturation_warnings(file: DepthFile, name: str) -> list[str]:
    if file.largest is None or file.largest < _MOST_GREYS:
        return []
    share = np.count_nonzero(file.values == file.largest) / file.values.size
    if share < _SATURATED_SHARE:
        return []
    return [
        f"{name}: {share:.1%} of the depths are {file.largest}, the largest possible number; if "
        f"it means no depth, use --missing {file.largest}"
    ]


def _check_distances(
    depth: NDArray[np.float32], file: DepthFile, name: str, unit: float
) -> list[str]:
    middle = float(np.median(sample(depth)))
    if middle > _FAR_MEDIAN_MM and middle <= _FARTHEST_MEDIAN_MM:
        return [
            f"{name}: a median depth of {middle / 1000:.4g} m is far for a depth camera; if the "
            "file has 5000 units per metre, use --depth-unit 5000"
        ]
    if _NEAREST_MEDIAN_MM <= middle <= _FARTHEST_MEDIAN_MM:
        return []
    stored = middle / unit
    guess, _ = _detect_unit(file)
    likely = {1.0: "mm", 1000.0: "m"}.get(guess)
    remedy = f"use {likely}" if likely and guess != unit else "use another unit"
    raise FileError(
        f"{name}: implausible --depth-unit of {unit:g} mm: the median depth {stored:.4g} would be "
        f"{middle / 1000:.4g} m; {remedy}, or confirm the unit with --near and --far in mm"
    )


def _detect_direction(depth: NDArray[np.float32]) -> bool | None:
    """True if larger numbers seem nearer; None if undecided."""
    stride = max(1, math.ceil(max(depth.shape) / 512))
    small = depth[::stride, ::stride]
    rows, columns = small.shape
    if rows < 6 or columns < 6:
        return None
    rim = np.ones(small.shape, bool)
    rim[rows // 8 :, columns // 8 : -(columns // 8)] = False
    middle = np.zeros(small.shape, bool)
    middle[rows // 4 : -(rows // 4), columns // 4 : -(columns // 4)] = True
    valid = small[~np.isnan(small)]
    if not valid.size:
        return None
    low, high = np.quantile(valid, (0.05, 0.95))
    if high <= low:
        return None
    span = float(high - low)
    upper, lower = small[: rows // 3], small[-(rows // 3) :]
    votes = [
        (_median(lower) - _median(upper)) / span,
        (_median(small[middle]) - _median(small[rim])) / span,
    ]
    if any(math.isnan(vote) for vote in votes) or max(map(abs, votes)) < _SIGNIFICANT:
        return None
    if min(votes) > -_SIGNIFICANT:
        return True
    return False if max(votes) < _SIGNIFICANT else None


def _median(values: np.ndarray) -> float:
    valid = values[~np.isnan(values)]
    return float(np.median(valid)) if valid.size else math.nan


def _choose_direction(detected: bool | None, unit: float, name: str) -> tuple[bool, list[str]]:
    if unit > 0:  # a distance grows away from the camera
        if not detected:
            return False, []
        return False, [
            f"{name}: the depth looks inverted: the middle and the bottom are behind the rim and "
            "the top; assumed distances; otherwise, use --near-is-large"
        ]
    if detected is None:
        raise UsageError(
            f"{name}: the direction of its unitless depth cannot be detected; use "
            "--near-is-large (white is near) or --far-is-large"
        )
    option, opposite = _direction_options(detected)
    return detected, [
        f"{name}: no depth direction given; assumed {option}, as the middle and the bottom are "
        f"usually nearer than the rim and the top; set it with {option} or {opposite}"
    ]


def _direction_options(near_is_large: bool) -> tuple[str, str]:
    """Option for the direction, and option for the opposite direction."""
    options = ("--near-is-large", "--far-is-large")
    return options if near_is_large else (options[1], options[0])


def fill_missing_depth(
    depth: NDArray[np.float32], rule: str, *, near_is_large: bool = False
) -> NDArray[np.float32]:
    """Fill the missing pixels (NaN) of a depth picture, (H, W) float32, by one of `FILL_RULES`.

    Pixels stay NaN where the rule has no depth to use. Without missing pixels, returns the input.
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
    for row in filled:  # row by row: avoids temporary arrays of the picture's size
        valid = np.flatnonzero(~np.isnan(row))
        gaps = np.flatnonzero(np.isnan(row))
        if valid.size and gaps.size:
            next_valid = np.searchsorted(valid, gaps)
            left = np.where(next_valid > 0, row[valid[next_valid - 1]], np.float32(np.nan))
            right = row[valid[np.minimum(next_valid, valid.size - 1)]]
            right = np.where(next_valid < valid.size, right, np.float32(np.nan))
            row[gaps] = farther(left, right)
    return filled
