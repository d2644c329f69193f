"""Test matrix of the generators: displays, pictures and algorithms.

The displays are small and cover all implementations of source maps: whole and fractional numbers of
pixels per lens, lenses in more than one strip of 32, shifted, hexagonal, turned and tilted arrays,
and real and virtual images. The pictures cover all kinds of hits: ties at borders, steps, thin
surfaces, holes, layers, and pixels that do not divide the pitch.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from inim.apps.stress.pictures import picture_of_depth, solids_of, tied_picture
from inim.display import Display
from inim.display.pixels import exact_length
from inim.image.rgbd import RGBD, Layer, LayeredRGBD
from inim.render.scene_files.two_spheres import two_spheres
from tests.conftest import small_display
from tests.skewed_layout import Skewed

REAL = {"depth_min_mm": 10.0, "depth_max_mm": 31.0}
VIRTUAL = {"focal_length_mm": 3.6, "depth_min_mm": -31.0, "depth_max_mm": -9.0}
BOTH_SIDES = {"depth_min_mm": -9.0, "depth_max_mm": 11.0}
PHONE = {"pixel_pitch_mm": 0.0636}
OFF_IN_EVERY_WAY: dict[str, Any] = {
    "lattice": "hexagonal", "rotation_deg": 7.0, "shift_x_mm": 0.31, "shift_y_mm": -0.22,
    "tilt_x_deg": -2.0, "tilt_y_deg": 1.5, "elemental_pitch_mm": 1.01,
}  # fmt: skip
_BINARY = {"gap_mm": 2.0, "focal_length_mm": 1.5, "depth_min_mm": -6.0, "depth_max_mm": 8.0}

#: Displays whose rows and columns are independent.
SEPARABLE = {
    "odd pixels": small_display(4, 3, 7, **REAL),
    "even pixels": small_display(5, 4, 8, **REAL),
    "binary lengths": small_display(4, 3, 8, **_BINARY),
    "nominal pixels, one lens": small_display(1, 1, 17, **BOTH_SIDES),
    "virtual": small_display(4, 3, 6, **VIRTUAL),
    "both sides": small_display(3, 4, 5, **BOTH_SIDES),
    "focused": small_display(3, 3, 5, gap_mm=3.0, depth_min_mm=-4.0, depth_max_mm=9.0),
    "one pixel per lens": small_display(4, 5, 1, **BOTH_SIDES),
    "three strips": small_display(70, 1, 5, **BOTH_SIDES),
    "phone": small_display(3, 2, **PHONE, **REAL),
    "phone, virtual": small_display(2, 3, **PHONE, **VIRTUAL),
    "elemental pitch": small_display(4, 3, 7, elemental_pitch_mm=1.013, **REAL),
    "larger panel": small_display(3, 2, 7, panel_columns=26, panel_rows=21, **BOTH_SIDES),
    "smaller panel": small_display(4, 4, 7, panel_columns=19, panel_rows=20, **REAL),
    "moved": small_display(4, 3, 7, shift_x_mm=0.37, shift_y_mm=-0.21, **REAL),
    "off the panel": small_display(5, 3, 7, shift_x_mm=3.2, shift_y_mm=-1.6, **REAL),
    "rows closer": small_display(4, 3, 7, pitch_y_mm=0.8, **REAL),
    "rows closer, elemental pitch": small_display(
        3, 3, 7, pitch_y_mm=1.2, elemental_pitch_mm=1.02, **REAL
    ),
}
NON_SEPARABLE = {
    "hexagonal": small_display(4, 3, 7, lattice="hexagonal", **REAL),
    "skewed rows": small_display(4, 3, 7, lattice=Skewed.name, shift_x_mm=0.1, **REAL),
    "turned": small_display(4, 3, 7, rotation_deg=4.0, **REAL),
    "tilted": small_display(4, 3, 7, tilt_x_deg=8.0, tilt_y_deg=-6.0, **REAL),
    "off in every way": small_display(4, 3, 7, **OFF_IN_EVERY_WAY, **REAL),
}
#: Displays whose colour channels have different subpixel positions.
SUBPIXELS = {
    "stripes": small_display(4, 3, 7, subpixels="rgb-stripe", pixel_fill=0.8, **REAL),
    "pentile, moved": small_display(4, 3, 7, subpixels="pentile", shift_y_mm=0.13, **REAL),
    "stripes, phone": small_display(2, 2, subpixels="rgb-stripe", **PHONE, **REAL),
    "stripes, turned": small_display(4, 3, 7, subpixels="rgb-stripe", rotation_deg=5.0, **REAL),
}
DISPLAYS = SEPARABLE | NON_SEPARABLE | SUBPIXELS


@dataclass(frozen=True)
class AlgorithmCase:
    """An algorithm of the matrix.

    Attributes
    ----------
    columns : str, optional
        Columns for the rational oracle, if the algorithm shows exact first hits.
    most_pixels : int
        Largest number of panel pixels for the float64 oracle.
    anywhere : bool
        True if the algorithm supports non-separable displays.
    """

    columns: str | None
    most_pixels: int
    anywhere: bool


ALGORITHMS = {
    "template": AlgorithmCase("surface", 300, True),
    "template:columns=solid": AlgorithmCase("solid", 300, True),
    "layered": AlgorithmCase("layers", 300, True),
    "gu2020": AlgorithmCase(None, 75, True),
    "wang2024": AlgorithmCase(None, 20, False),
    "wang2024:matching=ray": AlgorithmCase(None, 30, False),
    "li2012": AlgorithmCase(None, 20, False),
}


def single_ray(algorithm: str) -> str:
    """The algorithm with one ray per pixel."""
    return "layered:samples=1" if algorithm == "layered" else algorithm


def _shape(display: Display, pixel_mm: float) -> tuple[int, int]:
    """Shape of a picture that covers about the part that rays reach, not symmetric."""
    rows, columns = display.capture_shape(1)
    share = display.pitch_mm / pixel_mm
    return max(1, round(rows * share) - 1), max(1, round(columns * share) - 2)


def random(display: Display, pixel_mm: float, coverage: float = 0.9) -> RGBD:
    """Independent depths over the whole range and a little beyond; some cells uncovered."""
    generator = np.random.default_rng(3)
    low, high = display.depth_range_mm
    shape, margin = _shape(display, pixel_mm), (high - low) / 8
    depth = generator.uniform(low - margin, high + margin, shape).astype(np.float32)
    return picture_of_depth(depth, pixel_mm, generator.random(shape) < coverage)


def hills(display: Display, pixel_mm: float) -> RGBD:
    """Slopes, a jump and holes, with connected neighbours and all kinds of column ends."""
    shape = _shape(display, pixel_mm)
    rows, columns = np.indices(shape)
    low, high = display.depth_range_mm
    wave = np.sin(columns / 3) * np.cos(rows / 4) + 1.6 * (columns > shape[1] // 2)
    depth = np.float32(low + (high - low) * (wave + 1.0) / 3.6)
    return picture_of_depth(depth, pixel_mm, (rows + columns) % 11 > 1)


def steps(display: Display, pixel_mm: float) -> RGBD:
    """Five depths, including the ends of the range and its middle."""
    generator = np.random.default_rng(4)
    low, high = display.depth_range_mm
    depth = low + (high - low) * generator.integers(0, 5, _shape(display, pixel_mm)) / 4
    return picture_of_depth(depth.astype(np.float32), pixel_mm, generator.random(depth.shape) < 0.9)


def spikes(display: Display, pixel_mm: float) -> RGBD:
    """Thin near surfaces in front of a far background."""
    far, near = map(np.float32, display.depth_range_mm)
    rows, columns = np.indices(_shape(display, pixel_mm))
    return picture_of_depth(np.where((rows % 3 == 1) & (columns % 4 == 2), near, far), pixel_mm)


def single(display: Display, pixel_mm: float) -> RGBD:
    """Picture of one cell."""
    return picture_of_depth(np.full((1, 1), display.depth_range_mm[1], np.float32), pixel_mm)


def ties(ulps: int) -> Callable[[Display, float], RGBD]:
    """Depths at which rays leave cells, moved by `ulps` units in the last place."""
    return lambda display, pixel_mm: tied_picture(
        display, _shape(display, pixel_mm), pixel_mm, ulps
    )


def layers(display: Display, pixel_mm: float) -> LayeredRGBD:
    """Three layers of random, mostly thin solids; deeper layers are sparser."""
    generator = np.random.default_rng(1)
    shape, (low, high) = _shape(display, pixel_mm), display.depth_range_mm
    covered, above, solids = generator.random(shape) < 0.7, np.full(shape, high), []
    for _ in range(3):
        front = np.float32(low + (above - low) * generator.random(shape))
        back = np.minimum(np.float32(front - (front - low) * generator.random(shape) ** 3), front)
        solids.append(Layer(generator.random((*shape, 3), np.float32), front, back, covered))
        above, covered = back, covered & (generator.random(shape) < 0.6)
    first = solids[0]
    return LayeredRGBD(
        first.color, first.front_mm, covered=first.covered, pixel_mm=pixel_mm,
        back_mm=first.back_mm, deeper=tuple(solids[1:]),
    )  # fmt: skip


#: Functions that create the pictures, and cells per pitch. Fractional ones cannot use tables.
PICTURES: dict[str, tuple[Callable[[Display, float], RGBD], float]] = {
    "random": (random, 2),
    "random, sparse, odd size": (lambda d, p: random(d, p, 0.4), 3.68),
    "hills": (hills, 3),
    "steps": (steps, 4),
    "spikes": (spikes, 1),
    "one cell": (single, 1),
    "spheres": (
        lambda d, p: _linear(two_spheres(d, _shape(d, p), p)), 5,
    ),
    "ties, one unit below": (ties(-1), 2),
    "ties": (ties(0), 2),
    "ties, one unit above": (ties(1), 2),
    "ties of solids": (lambda d, p: solids_of(ties(0)(d, p), d), 2),
    "layers": (layers, 2),
    "layers, odd size": (layers, 2.3),
}  # fmt: skip


def _linear(rgbd: RGBD) -> RGBD:
    return picture_of_depth(rgbd.depth_mm, rgbd.pixel_mm, rgbd.covered)


def random_codes(rgbd: RGBD, *, opaque: bool = False) -> RGBD:
    """The same surfaces with random 8-bit sRGB codes and opacities."""
    generator = np.random.default_rng(5)

    def codes() -> np.ndarray:
        color = generator.integers(0, 256, (*rgbd.shape, 4)).astype(np.uint8)
        color[..., 3] |= 255 * opaque
        return color

    if not isinstance(rgbd, LayeredRGBD):
        return RGBD(codes(), rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm)
    return replace(
        rgbd, color=codes(), deeper=tuple(replace(layer, color=codes()) for layer in rgbd.deeper)
    )


@cache
def picture(display: str, name: str) -> RGBD:
    """Picture of the matrix, by the names of its display and of the picture."""
    create, per_pitch = PICTURES[name]
    pitch = exact_length(DISPLAYS[display].pitch_mm)
    return create(DISPLAYS[display], float(1 / (exact_length(per_pitch) / pitch)))


def pictures_for(display: str) -> list[str]:
    """Names of the pictures for a display; ties need exact rays."""
    exact = DISPLAYS[display].is_separable
    return [name for name in PICTURES if exact or not name.startswith("ties")]


def coded(rgbd: RGBD) -> RGBD:
    """Picture in RGBA whose colours are the numbers of its pixels, from 1."""

    def codes(shape: tuple[int, int], first: int) -> np.ndarray:
        index = np.arange(first, first + shape[0] * shape[1], dtype=np.uint32)
        return index.view(np.uint8).reshape(*shape, 4)

    size = rgbd.depth_mm.size
    plain: dict[str, Any] = {
        "color": codes(rgbd.shape, 1), "depth_mm": rgbd.depth_mm, "covered": rgbd.covered,
        "pixel_mm": rgbd.pixel_mm,
    }  # fmt: skip
    if not isinstance(rgbd, LayeredRGBD):
        return RGBD(**plain)
    deeper = tuple(
        Layer(codes(rgbd.shape, 1 + (n + 1) * size), layer.front_mm, layer.back_mm, layer.covered)
        for n, layer in enumerate(rgbd.deeper)
    )
    return LayeredRGBD(**plain, back_mm=rgbd.back_mm, deeper=deeper)
