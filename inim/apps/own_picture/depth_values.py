"""Interpretation of a depth picture's numbers: unit, direction and missing values.

The user states them. Distances that no depth camera returns reveal a wrong statement.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inim.apps.own_picture.picture_files import DepthFile
from inim.system.errors import FileError, UsageError

_UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
# Range of depth cameras for interiors and relics, by the median of a picture.
_NEAREST_MEDIAN_MM = 10.0
_FARTHEST_MEDIAN_MM = 10_000.0
# Nearly all distances of a picture, and their largest ratio: swapped bytes give 255.
_RANGE = (0.005, 0.5, 0.995)
_FAR_OVER_NEAR = 100.0
_LARGEST_OF_16_BITS = 65535
# Numbers that renderers write as floats where there is no surface: 1e9 and more, and the largest
# half-precision number.
_LEAST_BACKGROUND, _LARGEST_HALF = 1e9, 65504.0
# Files with at most this many levels hold grey values, others a sensor's millimetres.
_MOST_GREYS = 256
# Above this share of the pixels, the largest number probably means "no depth".
_SATURATED_SHARE = 0.01
# A number is far from all others if it is so many times as far as they are from each other.
_ISOLATED = 10.0
# Sample size for statistics: gives quantiles to a thousandth.
_MOST_SAMPLED = 2**20


@dataclass(frozen=True)
class DepthConvention:
    """Properties of a depth picture's numbers that the user states."""

    unit_mm: float  #: Millimetres per unit; 0 for numbers without a unit.
    near_is_large: bool = False
    swap_bytes: bool = False  #: True if the bytes of its 16-bit numbers were swapped.
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

    * `name`: file name for messages.

    Raises `FileError`: no pixel has a depth, or the distances are implausible.
    """
    unit = convention.unit_mm
    is_distance = unit > 0 and not convention.near_is_large
    depth = file.values.copy()
    empty = ~np.isfinite(depth)
    if is_distance:
        empty |= depth <= 0
    for number in convention.missing:
        empty |= file.values == np.float32(number)
    warnings = list(file.notes)
    if not convention.missing and (file.largest is None or is_distance):
        background = ~empty & _is_background(file, empty)
        if background.any() and not (background | empty).all():
            empty |= background
            number = float(file.values[background].max())
            warnings.append(
                f"{name}: {background.mean():.1%} of the depths are {number:g}, which programs "
                "write where there is no surface: they are missing; to change that, give --missing"
            )
    depth[empty] = np.nan
    if empty.all():
        raise FileError(
            f"{name}: no pixel has a depth (all {empty.size} are 0, not finite or --missing); "
            "check that it is the right file and was saved with 16 bits"
        )
    scale = unit if unit > 0 else 1.0
    depth *= np.float32(scale)
    if is_distance and not convention.has_range:
        _check_distances(depth, file, convention, name)
    if not convention.missing:
        saturated = _saturation_warnings(file, empty, name)
        warnings += saturated
        if not is_distance and not saturated:  # others were checked
            warnings += _isolated_warnings(depth / scale, name)
    step = scale if file.largest is not None else 0.0
    return DepthValues(depth, convention.near_is_large, unit > 0, step, tuple(warnings))


def sample(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Valid depths of evenly spaced pixels, at most about a million."""
    stride = max(1, math.ceil(math.sqrt(depth.size / _MOST_SAMPLED)))
    subset = depth[stride // 2 :: stride, stride // 2 :: stride]
    valid: NDArray[np.float32] = subset[~np.isnan(subset)]
    return valid if valid.size else depth[~np.isnan(depth)][:_MOST_SAMPLED]


def _is_background(file: DepthFile, empty: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels whose number programs write for "no depth": infinite, or the largest 16-bit number.

    The latter only if no other number reaches half of it.
    """
    values = file.values
    if file.largest is None:
        background: NDArray[np.bool_] = (values >= _LEAST_BACKGROUND) | (values == _LARGEST_HALF)
        return background
    background = values == file.largest
    others = values[~background & ~empty]
    is_isolated = file.largest >= _MOST_GREYS and others.max(initial=0) < file.largest / 2
    return background & is_isolated


def _saturation_warnings(file: DepthFile, empty: NDArray[np.bool_], name: str) -> tuple[str, ...]:
    if file.largest is None or file.largest < _MOST_GREYS:
        return ()
    share = np.count_nonzero((file.values == file.largest) & ~empty) / file.values.size
    if share < _SATURATED_SHARE:
        return ()
    return (
        f"{name}: {share:.1%} of the depths are {file.largest}, the largest possible number; if "
        f"it means no depth, use --missing {file.largest}",
    )


def _isolated_warnings(depth: NDArray[np.float32], name: str) -> tuple[str, ...]:
    """Warn of one number, far from all others, that may stand for no depth."""
    values = sample(depth).astype(np.float64)
    for extreme in (values.min(), values.max()):
        others = values[values != extreme]
        if not others.size or np.mean(values == extreme) < _SATURATED_SHARE:
            continue
        far = np.abs(others - extreme).min()
        if far > _ISOLATED * float(np.ptp(others)) > 0:
            return (
                f"{name}: {np.mean(values == extreme):.1%} of the depths are {extreme:g}, far from "
                f"all others; if it means no depth, use --missing {extreme:g}",
            )
    return ()


def _check_distances(
    depth: NDArray[np.float32], file: DepthFile, convention: DepthConvention, name: str
) -> None:
    """Raise `FileError` for distances in mm that no depth camera returns."""
    is_largest = file.values == (math.nan if file.largest is None else file.largest)
    distances = sample(np.where(is_largest, np.float32(np.nan), depth))
    if not distances.size:
        distances = sample(depth)
    near, middle, far = map(float, np.quantile(distances, _RANGE))
    if _NEAREST_MEDIAN_MM <= middle <= _FARTHEST_MEDIAN_MM and far <= _FAR_OVER_NEAR * near:
        return
    remedies = ["the right --depth-unit", "--missing N for numbers that mean no depth"]
    if convention.swap_bytes:
        remedies.insert(1, "no --swap-bytes")
    elif file.largest == _LARGEST_OF_16_BITS:
        remedies.insert(1, "--swap-bytes for the other byte order")
    raise FileError(
        f"{name}: implausible distances, {near:.4g} .. {far:.4g} mm with a median of {middle:.4g} "
        f"mm, by a --depth-unit of {convention.unit_mm:g} mm; give {', '.join(remedies)}, or "
        "confirm them with --near and --far in mm"
    )
