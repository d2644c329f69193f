"""What a case of the stress run is made of: a small display, and a picture that is noise.

Nothing in the pictures is smooth, so a wrong source shows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import partial

import numpy as np

from inim.display import Display
from inim.rgbd import RGBD

__all__ = [
    "FULL",
    "QUICK",
    "Case",
    "Family",
    "Made",
    "Size",
    "case_at",
    "decades",
    "display_of",
    "noise",
    "over",
    "shaped",
    "sized",
    "window",
    "windowed",
    "with_depth",
]

Made = tuple[Display, RGBD]


@dataclass(frozen=True)
class Size:
    """How much is run.

    Attributes
    ----------
    lenses : (columns, rows)
        Of the displays whose size is not the parameter; odd, so that one lens is on the axis.
    pixels : int
        Per lens.
    thin : int
        Every so manieth point of a family.
    random : int
        Random displays.
    most_pixels : int
        Panel pixels compared with the oracle; a sample where there are more.
    many : int
        Lenses along a side of the largest array.
    """

    lenses: tuple[int, int]
    pixels: int
    thin: int
    random: int
    most_pixels: int
    many: int


QUICK = Size((3, 3), 5, 24, 2, 49, 60)
FULL = Size((3, 3), 5, 2, 10, 225, 1000)


@dataclass(frozen=True)
class Case:
    """One display and picture.

    Attributes
    ----------
    label : str
    make : callable
        Makes display and picture; may be refused.
    value : float, optional
        Of the family's parameter.
    refused : bool, optional
        Whether it must be refused; None: it may be.
    """

    label: str
    make: Callable[[], Made]
    value: float | None = None
    refused: bool | None = False


@dataclass(frozen=True)
class Family:
    """Cases along one parameter.

    Attributes
    ----------
    name : str
    parameter : str
        What `Case.value` is, with its unit; empty where cases have no order.
    cases : callable
        From a `Size`.
    """

    name: str
    parameter: str
    cases: Callable[[Size], list[Case]]


# -- displays and pictures ----------------------------------------------------------------------


def display_of(size: Size, **changes: object) -> Display:
    """The small display of most cases: 1 mm lenses, real mode, a whole number of pixels."""
    values: dict[str, object] = {
        "pitch_mm": 1.0,
        "focal_length_mm": 3.0,
        "gap_mm": 3.3,
        "pixel_pitch_mm": 1.0 / size.pixels,
        "lens_columns": size.lenses[0],
        "lens_rows": size.lenses[1],
    }
    return Display(**(values | changes))  # type: ignore[arg-type]


def noise(
    display: Display, shape: tuple[int, int], pixel_mm: float, seed: int = 0, covered: float = 0.85
) -> RGBD:
    """Random depths over the depth range, colours and cover."""
    rng = np.random.default_rng(seed)
    low, high = display.depth_range_mm
    depth = (low + (high - low) * rng.random(shape)).astype(np.float32)
    return with_depth(depth, pixel_mm, rng.random(shape) < covered, seed)


def with_depth(
    depth: np.ndarray, pixel_mm: float, covered: np.ndarray | None = None, seed: int = 0
) -> RGBD:
    """A picture of given depths and random colours."""
    colour = np.random.default_rng(seed + 1).random((*depth.shape, 3)).astype(np.float32)
    cover = np.ones(depth.shape, bool) if covered is None else covered
    return RGBD(colour, depth, cover, pixel_mm)


def shaped(kind: str, display: Display, shape: tuple[int, int], pixel_mm: float) -> RGBD:
    """Spikes, slits, a checkerboard, a ramp or stairs between the ends of the depth range."""
    r, c = np.indices(shape)
    far, near = map(np.float32, display.depth_range_mm)
    depth = {
        "spikes": np.where((r % 5 == 2) & (c % 7 == 3), near, far),
        "slits": np.where(c % 6 == 2, far, near),
        "checkerboard": np.where((r + c) % 2 == 1, near, far),
        "ramp": far + (near - far) * (r + c) / (sum(shape) - 2),
        "stairs": far + (near - far) * (c // 3 % 5) / 4,
    }[kind]
    return with_depth(depth.astype(np.float32), pixel_mm)


def over(display: Display, per_pitch: int = 2) -> tuple[tuple[int, int], float]:
    """Shape and pixel of a picture that covers what rays reach."""
    return display.capture_shape(per_pitch), display.pitch_mm / per_pitch


def window(display: Display, cells: int = 48) -> tuple[tuple[int, int], float]:
    """A picture around the axis whose pixel is an eighth of how far rays travel sideways."""
    reach = max(map(abs, display.depth_range_mm)) * display.pitch_mm / (2 * display.gap_mm)
    return (cells, cells), _nice(reach / 8)


def _nice(length: float) -> float:
    """The next number below with one digit: what a person would write."""
    power = math.floor(math.log10(length))
    digit = math.floor(length / 10.0**power) or 1
    return float(Fraction(digit) * Fraction(10) ** power)


def sized(display: Display, seed: int = 0, per_pitch: int = 2) -> Made:
    """A display with noise over all that its rays reach."""
    return display, noise(display, *over(display, per_pitch), seed)


def windowed(display: Display, seed: int = 0) -> Made:
    """A display with noise in a window around its axis."""
    return display, noise(display, *window(display), seed)


def case_at(
    label: str, make: Callable[..., Made], value: float, refused: bool | None = False
) -> Case:
    """The case that `make` makes of a value of its family's parameter."""
    return Case(label, partial(make, value), value, refused)


def decades(first: int, last: int) -> list[float]:
    """Powers of ten, each the nearest float."""
    return [float(Fraction(10) ** k) for k in range(first, last + 1)]
