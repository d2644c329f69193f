"""Holes filled from their own views: `fill` of every algorithm that reports its sources.

Expected: a background continues behind a foreground, and the foreground does not; the border of a
picture is repeated beyond its edge; visible ground stays ground. Plain loops repeat the definition.
"""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from inim.display import DISPLAYS, Display
from inim.generators import HOLE, NO_LENS, find_sources, generate, prepare, registry
from inim.generators.raycast.columns import STEEPEST
from inim.generators.registry import Algorithm
from inim.generators.steps import RayGenerator
from inim.image.color import srgb_from_linear, srgb_to_uint8
from inim.image.rgbd import RGBD
from inim.system.errors import UsageError
from tests.conftest import small_display

SURFACE = "template:samples=1:colour=nearest"
WALL, NEAR = (0.1, 0.6, 0.2), (0.9, 0.1, 0.1)
DEPTHS = {"depth_min_mm": 10.0, "depth_max_mm": 40.0}
ARRAYS: list[dict[str, Any]] = [
    {},
    {"pixel_pitch_mm": 0.0636},
    {"elemental_pitch_mm": 1.013, "shift_x_mm": 0.2},
]


def continued(rgbd: RGBD) -> RGBD:
    """Picture whose border is repeated beyond its edge, farther than rays reach."""
    rows, columns = (np.clip(np.arange(-60, n + 60), 0, n - 1) for n in rgbd.shape)
    parts = (part[rows][:, columns] for part in (rgbd.color, rgbd.depth_mm, rgbd.covered))
    return RGBD(*parts, rgbd.pixel_mm)


def left(rgbd: RGBD, display: Display, algorithm: str) -> tuple[np.ndarray, np.ndarray]:
    """Sources and EIA, with holes, of a picture that reaches far enough."""
    size = {"shape": rgbd.shape, "pixel_mm": rgbd.pixel_mm}
    generator = prepare(display, algorithm, **size, fill="all")
    assert isinstance(generator, RayGenerator) and generator.with_holes.shape == rgbd.shape
    return generator.with_holes.sources(rgbd), generator.with_holes.generate(rgbd)


def wall_and_plate(display: Display, per_pitch: int = 4) -> RGBD:
    """A near plate before a far wall that covers all of the array and no more."""
    shape = display.lens_rows * per_pitch, display.lens_columns * per_pitch
    low, high = display.depth_range_mm
    depth = np.full(shape, low + 0.05 * (high - low), np.float32)
    color = np.full((*shape, 3), WALL, np.float32)
    near = np.s_[shape[0] // 3 : shape[0] // 2, shape[1] // 4 : shape[1] // 2]
    depth[near], color[near] = high, NEAR
    return RGBD(color, depth, np.ones(shape, bool), display.pitch_mm / per_pitch)


def hills(display: Display, seed: int = 5) -> RGBD:
    """Slopes, jumps and uncovered patches, smaller than what the display sees."""
    rgbd = wall_and_plate(display, 3)
    rows, columns = np.mgrid[: rgbd.shape[0], : rgbd.shape[1]]
    low, high = display.depth_range_mm
    wave = 0.25 * (np.sin(columns / 4) + np.cos(rows / 5)) + 0.5 * (columns % 9 > 5)
    depth = np.float32(low + (high - low) * (wave + 0.5) / 1.5)
    color = np.random.default_rng(seed).random((*rgbd.shape, 3), dtype=np.float32)
    return RGBD(color, depth, (rows // 5 + columns // 6) % 4 > 0, rgbd.pixel_mm)


@pytest.mark.parametrize("more", ARRAYS)
@pytest.mark.parametrize("samples", [1, 4])
def test_uncovered_background_and_the_picture_beyond_its_edge_are_wall(more, samples) -> None:
    display = small_display(16, 15, **DEPTHS, **more)
    rgbd = wall_and_plate(display)
    sources, plain = left(continued(rgbd), display, f"template:colour=nearest:samples={samples}")
    filled = generate(rgbd, display, SURFACE, samples=samples, fill="hidden")
    assert 0.02 < np.mean(sources[display.lensed] == HOLE) < 0.3
    outside = find_sources(rgbd, display, "template:columns=solid") == HOLE
    assert np.mean(outside & (sources >= 0)) > 0.05
    holes = (sources == HOLE) & (plain == 0).all(axis=-1)
    assert np.abs(filled[holes] - WALL).max() < 1e-6
    assert (filled[display.lensed] > 0.09).all() and (filled[~display.lensed] == 0).all()
    if samples == 1:
        assert np.array_equal(filled[sources >= 0], plain[sources >= 0])


@pytest.mark.parametrize("method", ["hidden", "all"])
@pytest.mark.parametrize("more", ARRAYS)
@pytest.mark.parametrize("algorithm", [SURFACE, "li2012"])
def test_fill_is_as_defined(more, method, algorithm) -> None:
    display = small_display(7, 6, **more)
    rgbd = hills(display)
    beyond = continued(rgbd)
    sources, plain = left(beyond, display, algorithm)
    filled = generate(rgbd, display, algorithm, fill=method)
    as_without = find_sources(rgbd, display, algorithm)
    assert np.array_equal(find_sources(rgbd, display, algorithm, fill=method), as_without)
    # A template supposes what goes on behind a surface; a fill is given the hole.
    assert ((sources == HOLE) & (as_without >= 0)).any() == (algorithm == SURFACE)
    assert np.array_equal(filled[sources != HOLE], plain[sources != HOLE])
    right, empty = 0, 0
    holes = np.argwhere(sources == HOLE)
    for i, j in holes[:: max(1, len(holes) // 200)]:
        expected = by_definition(beyond, display, sources, i, j, unknown=method == "all")
        assert np.abs(filled[i, j] - expected).max() < 1e-5
        right += expected.any()
        empty += not expected.any()
    assert right > 30
    assert method == "all" or empty > 30


def by_definition(rgbd, display, sources, i, j, *, unknown):
    """The colour of one hole, in plain Python."""
    rows, columns, same = display.rows, display.columns, STEEPEST * rgbd.pixel_mm

    def beside(axis, pitch_mm, pixel, lenses):
        own = np.flatnonzero(axis.lens == axis.lens[pixel] + lenses)
        if axis.lens[pixel] + lenses < 0 or not len(own):
            return None
        place = pixel + lenses * pitch_mm / display.pixel_pitch_mm
        return own[np.abs(own - place).argmin()]

    def first_along(p, q, z):
        x = columns.centre_mm[q] + columns.slope[q] * z
        y = rows.centre_mm[p] + rows.slope[p] * z
        u = math.floor(x / rgbd.pixel_mm + rgbd.shape[1] / 2)
        v = math.floor(rgbd.shape[0] / 2 - y / rgbd.pixel_mm)
        if not (0 <= v < rgbd.shape[0] and 0 <= u < rgbd.shape[1]):
            return math.inf
        if not rgbd.covered[v, u]:
            return -1e30 if unknown else -math.inf
        return rgbd.depth_mm[v, u]

    if first_along(i, j, display.depth_range_mm[0]) == -math.inf:
        return np.zeros(3)
    surfaces = []
    for a, b in [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b]:
        least, steps = math.inf, [(i, j)]
        while True:
            p = beside(rows, display.elemental_row_pitch_mm, i, a * len(steps))
            q = beside(columns, display.elemental_image_pitch_mm, j, b * len(steps))
            if p is None or q is None or sources[p, q] == NO_LENS or sources[p, q] >= 0:
                break
            steps.append((p, q))
        if p is None or q is None or sources[p, q] < 0:
            continue
        row, column = divmod(int(sources[p, q]), rgbd.shape[1])
        z = rgbd.depth_mm[row, column]
        least = min(first_along(*step, z) for step in steps)
        if least == -math.inf:
            continue
        r, c = row + a, column + b
        inside = 0 <= r < rgbd.shape[0] and 0 <= c < rgbd.shape[1]
        if inside and rgbd.covered[r, c] and abs(rgbd.depth_mm[r, c] - z) <= same:
            row, column = r, c
        apart = len(steps) * math.hypot(a * display.row_pitch_mm, b * display.pitch_mm)
        surfaces.append((least >= z - same, z, 1 / apart, rgbd.color[row, column]))
    covered_cells = [s for s in surfaces if s[0]]
    if not covered_cells and surfaces and (unknown or rgbd.covered.all()):
        farthest = min(s[1] for s in surfaces)
        covered_cells = [s for s in surfaces if s[1] <= farthest + same]
    if not covered_cells:
        return np.zeros(3)
    return sum(s[2] * s[3] for s in covered_cells) / sum(s[2] for s in covered_cells)


@pytest.mark.parametrize("samples", [1, 4])
def test_display_ready_pixels_are_the_codes_of_the_same_light(samples: int) -> None:
    display = small_display(9, 8)
    rgbd = hills(display)
    codes = srgb_to_uint8(srgb_from_linear(rgbd.color))
    opaque = np.concatenate([codes, np.full((*rgbd.shape, 1), 255, np.uint8)], axis=-1)
    encoded = RGBD(opaque, rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm)
    method = f"template:colour=nearest:samples={samples}:fill=all"
    linear, direct = generate(rgbd, display, method), generate(encoded, display, method)
    far = np.abs(direct[..., :3].astype(int) - srgb_to_uint8(srgb_from_linear(linear)))
    # The picture's codes are rounded, and so is the light of a pixel that is shown in part.
    assert far.max() <= 3 and far.mean() < 0.3
    assert np.array_equal(direct[..., 3] > 0, linear.any(axis=-1))
    assert (direct[..., 3] == 255).mean() > 0.95


def test_rays_without_holes_are_searched_once(monkeypatch) -> None:
    """Expected: the fill reads the sources of rays with holes only."""
    display = small_display(4, 3, 7, **DEPTHS)
    searched, sources_of = [], RayGenerator._marked
    monkeypatch.setattr(RayGenerator, "_marked", lambda *a: searched.append(a[2]) or sources_of(*a))
    with_plate = wall_and_plate(display)
    flat = RGBD(with_plate.color, np.full(with_plate.shape, 20.0), with_plate.covered, 0.25)
    filled, plain = (generate(flat, display, SURFACE, fill=fill) for fill in ("all", "none"))
    covered = find_sources(flat, display, SURFACE) >= 0
    assert searched == [] and np.array_equal(filled[covered], plain[covered])
    generate(with_plate, display, "template:samples=4:colour=smooth:fill=all")
    assert searched == [0, 1, 2, 3]


def test_inputs_that_cannot_be_filled_are_refused(monkeypatch) -> None:
    display = DISPLAYS["nominal"]
    size = {"shape": (8, 8), "pixel_mm": 1.0}
    with pytest.raises(UsageError, match="fill = 'mirror': use none or hidden or all"):
        prepare(display, "template:fill=mirror", **size)
    with pytest.raises(UsageError, match="form no rows and columns; use fill=none"):
        prepare(display.replace(lattice="hexagonal"), "gu2020:fill=all", **size)
    colours = Algorithm("mine", lambda *_: SimpleNamespace(generate=len), options={})
    monkeypatch.setattr(registry, "find_algorithm", lambda name: colours)
    with pytest.raises(UsageError, match="'mine' does not report its sources"):
        prepare(display, "mine:fill=all", **size)
