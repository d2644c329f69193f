"""Small displays with test pictures, and the output of an algorithm for them.

The pictures are not smooth, so that a wrong source is visible. Most are noise: random depths over
the whole depth range, some uncovered pixels, random colours.
"""

import math
from collections.abc import Callable, Iterator
from fractions import Fraction
from typing import Any

import numpy as np

from inim.display import Display
from inim.generators import SourceGenerator, colour_of, parse_algorithm, prepare
from inim.generators.oracle import axis_rays
from inim.image.rgbd import RGBD, Layer, LayeredRGBD

PictureCase = tuple[Display, RGBD]

#: Real and virtual mode, an even and an odd number of pixels, binary and decimal lengths.
DISPLAYS: tuple[dict[str, object], ...] = (
    {},
    {"gap_mm": 4.0, "pixel_pitch_mm": 0.125},
    {"focal_length_mm": 3.3, "gap_mm": 3.0, "pixel_pitch_mm": 0.19},
)
#: Arrays without separable rays: one of each kind, and one with all misalignments.
MOUNTINGS: dict[str, dict[str, object]] = {
    "turned": {"rotation_deg": 4.0},
    "tilted": {"tilt_x_deg": 3.0, "tilt_y_deg": -2.0},
    "hexagonal": {"lattice": "hexagonal"},
    "all at once": {
        "lattice": "hexagonal",
        "rotation_deg": -7.0,
        "shift_x_mm": 0.31,
        "shift_y_mm": -0.22,
        "tilt_x_deg": -2.0,
        "tilt_y_deg": 1.5,
        "elemental_pitch_mm": 1.01,
    },
}
CELLS: dict[str, object] = {
    "subpixels": "cells", "cell_pattern": "staggered",
    "subpixel_cells": "-0.3 0.25 0.3 0.2 0 -0.25, 0.2 0 -0.1 0.3 0.35 -0.2, 0 0.1 0.25 0 -0.3 0.3",
}  # fmt: skip
_SHEET: dict[str, object] = {
    "lattice": "lenticular", "lens_columns": 5, "lens_rows": 1, "panel_columns": 26,
    "panel_rows": 17, "elemental_pitch_mm": 1.02, "depth_min_mm": -6.0, "depth_max_mm": 8.0,
}  # fmt: skip
_BOTH_SIDES = {"depth_min_mm": -4.0, "depth_max_mm": 5.0}
#: One display of each kind: layouts, misalignments, sub-pixels, one lens, one pixel per lens.
KINDS: dict[str, dict[str, object]] = {
    **dict(zip(("real", "binary lengths", "virtual"), DISPLAYS, strict=True)),
    **MOUNTINGS,
    "even numbers": {"lens_columns": 4, "lens_rows": 2, "pixel_pitch_mm": 0.25},
    "rows apart": {"pitch_y_mm": 1.3, "panel_rows": 21},
    "aimed": {"elemental_pitch_mm": 1.013},
    "aimed, virtual": {
        "elemental_pitch_mm": 1.05, "focal_length_mm": 3.6, "depth_min_mm": -15.0,
        "depth_max_mm": -5.0,
    },
    "shifted": {"shift_x_mm": 0.37, "shift_y_mm": -0.21},
    "larger panel": {"panel_columns": 26, "panel_rows": 22, **_BOTH_SIDES},
    "smaller panel": {"panel_columns": 12, "panel_rows": 13},
    "one lens": {"lens_columns": 1, "lens_rows": 1},
    "one pixel per lens": {"pixel_pitch_mm": 1.0, "lens_columns": 4, "lens_rows": 5},
    "phone": {"pixel_pitch_mm": 0.0636, "lens_rows": 2},
    "focused": {"gap_mm": 3.0, **_BOTH_SIDES},
    "hexagonal, one row": {"lattice": "hexagonal", "lens_rows": 1},
    "hexagonal, rows apart": {"lattice": "hexagonal", "lens_rows": 4, "pitch_y_mm": 0.7},
    "stripes": {"subpixels": "rgb-stripe", "pixel_fill": 0.8},
    "pentile, turned": {"subpixels": "pentile", "rotation_deg": 3.0},
    "cells": CELLS,
    "cells, hexagonal": {**CELLS, "lattice": "hexagonal", "cell_pattern": "checkerboard"},
    "lenticular": {**_SHEET, "rotation_deg": 12.0},
    "lenticular, cells": {**_SHEET, **CELLS, "rotation_deg": -9.0, "cell_pattern": "rows-of-4"},
    "lenticular, misaligned": {
        **_SHEET, "rotation_deg": 12.0, "shift_x_mm": 0.23, "shift_y_mm": 0.4, "tilt_x_deg": 1.0,
        "tilt_y_deg": -2.0,
    },
    "lenticular, parallel rays": {**_SHEET, "elemental_pitch_mm": None, "rotation_deg": 5.0},
}  # fmt: skip
SHAPES = ("spikes", "slits", "checkerboard", "ramp", "stairs")

# Offsets of a pixel and its neighbours, (rows, columns), a symmetric set.
_AROUND = ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0))
# Number of covered neighbours that deeper layers need to be covered.
_MOST = 4
# Share of the picture's pixels with a depth at which a given ray leaves them.
_TIED = 0.3
# Largest number of rows and columns of a random picture.
_LARGEST_RANDOM = 160


def small_display(**changes: object) -> Display:
    """3 x 3 lenses of 1 mm, one on the axis, each over 5 x 5 pixels, in real mode."""
    values: dict[str, object] = {
        "pitch_mm": 1.0,
        "focal_length_mm": 3.0,
        "gap_mm": 3.3,
        "pixel_pitch_mm": 0.2,
        "lens_columns": 3,
        "lens_rows": 3,
    }
    return Display(**(values | changes))  # type: ignore[arg-type]


_LENGTHS = (
    "pitch_mm", "focal_length_mm", "gap_mm", "pixel_pitch_mm", "elemental_pitch_mm", "pitch_y_mm",
    "shift_x_mm", "shift_y_mm", "depth_min_mm", "depth_max_mm",
)  # fmt: skip


def scaled(display: Display, factor: float) -> Display:
    """Display whose lengths are all multiplied by a factor, but not its layers and aspheres."""
    values = {name: getattr(display, name) for name in _LENGTHS}
    return display.replace(**{k: v * factor for k, v in values.items() if v})


def displays(*, separable: bool = False) -> Iterator[tuple[str, Display]]:
    """A small display of each of `KINDS` with its name, or only those that are separable."""
    for name, changes in KINDS.items():
        display = small_display(**changes)
        if display.is_separable or not separable:
            yield name, display


def noise(
    display: Display, shape: tuple[int, int], pixel_mm: float, seed: int = 0, covered: float = 0.85
) -> RGBD:
    """Random depths over the depth range, colours and cover."""
    rng = np.random.default_rng(seed)
    low, high = display.depth_range_mm
    depth = (low + (high - low) * rng.random(shape)).astype(np.float32)
    return picture_of_depth(depth, pixel_mm, rng.random(shape) < covered, seed)


def picture_of_depth(
    depth: np.ndarray, pixel_mm: float, covered: np.ndarray | None = None, seed: int = 0
) -> RGBD:
    """A picture of given depths and random colours."""
    colour = np.random.default_rng(seed + 1).random((*depth.shape, 3)).astype(np.float32)
    cover = np.ones(depth.shape, bool) if covered is None else covered
    return RGBD(colour, depth, cover, pixel_mm)


def shaped_picture(display: Display, shape: tuple[int, int], pixel_mm: float, kind: str) -> RGBD:
    """One of `SHAPES` between the ends of the depth range."""
    r, c = np.indices(shape)
    far, near = map(np.float32, display.depth_range_mm)
    depth = {
        "spikes": np.where((r % 5 == 2) & (c % 7 == 3), near, far),
        "slits": np.where(c % 6 == 2, far, near),
        "checkerboard": np.where((r + c) % 2 == 1, near, far),
        "ramp": far + (near - far) * (r + c) / (sum(shape) - 2),
        "stairs": far + (near - far) * (c // 3 % 5) / 4,
    }[kind]
    return picture_of_depth(depth.astype(np.float32), pixel_mm)


def tied_picture(display: Display, shape: tuple[int, int], pixel_mm: float, ulps: int) -> RGBD:
    """Depths within `ulps` of one at which a ray leaves the pixel, for a separable display."""
    blank = noise(display, shape, pixel_mm, seed=ulps + 5)
    depth = _boundary_depths(display, blank)
    for _ in range(abs(ulps)):
        depth = np.nextafter(depth, np.float32(math.copysign(math.inf, ulps)))
    return picture_of_depth(depth, pixel_mm, blank.covered)


def _boundary_depths(display: Display, blank: RGBD) -> np.ndarray:
    low, high = display.depth_range_mm
    depth = np.array(blank.depth_mm)
    rng = np.random.default_rng(7)
    for axis, line in enumerate(axis_rays(display, blank)):
        for start, slope in zip(line.start, line.slope, strict=True):
            if slope == 0:
                continue
            ends = sorted(start + slope * Fraction(z) for z in (low, high))
            for border in range(math.floor(ends[0]) + 1, math.ceil(ends[1])):
                cell = border if slope > 0 else border - 1
                if not 0 <= cell < depth.shape[axis]:
                    continue
                z = np.float32(float((border - start) / slope))
                across = rng.random(depth.shape[1 - axis]) < _TIED
                depth[(cell, across) if axis == 0 else (across, cell)] = z
    return depth


def random_picture(seed: int) -> PictureCase:
    """A random separable display of plausible lengths, and a random picture over it."""
    rng = np.random.default_rng(seed)
    pitch = float(rng.choice([1.0, 0.5, 0.93, 1 / 3, rng.uniform(0.1, 3)]))
    pixels = float(rng.choice([3, 5, 7.5, 4.25, rng.uniform(2, 9)]))
    f = pitch * float(rng.choice([2.0, 3.0, rng.uniform(1.5, 5)]))
    gap = f * float(rng.choice([1.1, 0.9, 1.25, rng.uniform(0.7, 1.4)]))
    near, far = np.sort(rng.uniform(-30, 30, 2)) * pitch
    stated = {"depth_min_mm": near, "depth_max_mm": far} if rng.random() < 0.5 else {}
    display = Display(
        pitch, f, gap, pitch / pixels, int(rng.integers(1, 6)), int(rng.integers(1, 5)), **stated
    )
    per_pitch = int(rng.integers(1, 4))
    if rng.random() < 0.4:
        return display, noise(display, (40, 36), pitch / float(rng.uniform(0.5, 3)), seed)
    shape = display.capture_shape(per_pitch)
    if max(shape) > _LARGEST_RANDOM:  # the depth range of such a display is large
        return display, noise(display, *window(display), seed)
    return display, noise(display, shape, pitch / per_pitch, seed)


def window(display: Display, cells: int = 48) -> tuple[tuple[int, int], float]:
    """Shape and pixel size of a picture around the axis; rays travel eight pixels sideways."""
    reach = max(map(abs, display.depth_range_mm)) * display.pitch_mm / (2 * display.gap_mm)
    # Round down to one significant digit.
    power = math.floor(math.log10(reach / 8))
    digit = math.floor(reach / 8 / 10.0**power) or 1
    return (cells, cells), float(Fraction(digit) * Fraction(10) ** power)


def noise_pictures() -> Iterator[PictureCase]:
    """Noise over a small display of each of `DISPLAYS`."""
    for seed, changes in enumerate(DISPLAYS):
        display = small_display(lens_columns=5, **changes)
        yield display, noise(display, display.capture_shape(2), display.pitch_mm / 2, seed=seed)


def misaligned_pictures(rows: int) -> Iterator[PictureCase]:
    """Noise pictures for each array of `MOUNTINGS`, with the given number of lens rows."""
    for seed, changes in enumerate(MOUNTINGS.values()):
        display = small_display(lens_rows=rows, **changes)
        yield display, noise(display, display.capture_shape(2), 0.5, seed=seed)


def solids_of(rgbd: RGBD, display: Display) -> LayeredRGBD:
    """Add layers: three solids in each pixel, between its depths and those of its neighbours.

    A ray enters a pixel at the depth at which it leaves the previous one, so a picture with ties
    has ties at fronts and backs. The last solid extends to infinity. Deeper layers are covered
    where most neighbours are, and have other colours.
    """
    low = np.float32(display.depth_range_mm[0])
    depth_mm = np.where(rgbd.covered, rgbd.depth_mm, low)
    depths = np.sort(np.stack([np.roll(depth_mm, by, axis=(0, 1)) for by in _AROUND]), axis=0)[::-1]
    around = np.stack([np.roll(rgbd.covered, by, axis=(0, 1)) for by in _AROUND]).sum(axis=0)
    inside = rgbd.covered & (around >= _MOST)
    bottom = np.full(rgbd.shape, -np.inf, np.float32)
    colours = [(rgbd.color * share).astype(np.float32) for share in (1.0, 0.5, 0.25)]
    return LayeredRGBD(
        colours[0], depths[0], rgbd.covered, rgbd.pixel_mm, depths[1],
        (
            Layer(colours[1], depths[2], depths[3], inside),
            Layer(colours[2], depths[4], bottom, inside),
        ),
    )  # fmt: skip


# Function with the signature of `algorithm_output`: (rows, columns, 3).
Show = Callable[[RGBD, Display, str], np.ndarray]


def is_first_hit(algorithm: str) -> bool:
    """True if an algorithm is defined by the first hit of each ray, which is unique."""
    return parse_algorithm(algorithm).exact


def input_of(rgbd: RGBD, display: Display, algorithm: str) -> RGBD:
    """Return the picture, with layers if the algorithm reads them."""
    return rgbd if parse_algorithm(algorithm).reads is RGBD else solids_of(rgbd, display)


def algorithm_output(rgbd: RGBD, display: Display, algorithm: str, **options: Any) -> np.ndarray:
    """Output of an algorithm, (rows, columns, 3) float, for comparison with another picture's.

    It is the EIA; or, if the algorithm reports its sources, the result of `colours_of`.
    """
    picture = input_of(rgbd, display, algorithm)
    generator = prepare(display, algorithm, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm, **options)
    if isinstance(generator, SourceGenerator):
        return colours_of(generator.sources(picture), rgbd)
    return generator.generate(picture)


def colours_of(sources: np.ndarray, rgbd: RGBD) -> np.ndarray:
    """Colours of sources, different for each layer, for holes and for pixels without a lens."""
    flat = rgbd.color.reshape(-1, 3)
    layer, cell = np.divmod(np.maximum(sources, 0), len(flat))
    colours: np.ndarray = np.where(
        (sources >= 0)[..., None], flat[cell] + 2.0 * layer[..., None], sources[..., None] - 5.0
    )
    return colours


def eia_of(rgbd: RGBD, display: Display, algorithm: str) -> tuple[np.ndarray, np.ndarray]:
    """Sources, (rows, columns, 1), and linear EIA; the EIA twice without sources."""
    generator = prepare(display, algorithm, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm)
    if isinstance(generator, SourceGenerator):
        sources = generator.sources(rgbd)
        return sources[..., None], colour_of(sources, rgbd)
    eia = generator.generate(rgbd)
    return eia, eia
