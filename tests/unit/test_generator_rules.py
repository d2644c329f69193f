"""Rules of single generators in closed form, their options, and what they refuse.

Sources on whole panels are tested in `test_generators`.
"""

import math
from typing import Any

import numpy as np
import pytest

from inim.apps.stress.pictures import noise, solids_of
from inim.display import DISPLAYS, Display
from inim.generators import (
    HOLE,
    NO_LENS,
    Algorithm,
    find_sources,
    generate,
    hole_fraction,
    prepare,
)
from inim.image.color import srgb_from_linear
from inim.image.rgbd import RGBD
from inim.pipeline.stages.generation import run_generator
from inim.render.scene_files.two_spheres import two_spheres, two_spheres_eia
from inim.system.errors import UsageError
from tests import oracle
from tests.conftest import small_display

# Lengths that are binary fractions: every position and slope is exact in float64.
BINARY = {
    "pitch_mm": 1.0, "focal_length_mm": 1.5, "gap_mm": 2.0, "pixel_pitch_mm": 0.125,
    "lens_columns": 4, "lens_rows": 3,
}  # fmt: skip
NOMINAL = {**DISPLAYS["nominal"].parameters(), "lens_columns": 4, "lens_rows": 3}
VIRTUAL = {"focal_length_mm": 3.6, "depth_min_mm": -41.0, "depth_max_mm": -20.0}
SOLID = "template:columns=solid"


def display(base: dict[str, Any] = BINARY, **changes: Any) -> Display:
    return Display(**{**base, **changes})


def picture(depth: Any, cell_mm: float, covered: Any = None) -> RGBD:
    depth = np.asarray(depth, np.float32)
    covered = np.ones(depth.shape, bool) if covered is None else covered
    return RGBD(np.ones((*depth.shape, 3), np.float32), depth, covered, cell_mm)


def only(shape: tuple[int, int], cell: tuple[int, int], depth: float, cell_mm: float) -> RGBD:
    """A picture in which one cell is covered."""
    covered = np.zeros(shape, bool)
    covered[cell] = True
    return picture(np.full(shape, depth), cell_mm, covered)


def ray_at(device: Display, z: float) -> tuple[np.ndarray, np.ndarray]:
    """y of every panel row's ray and x of every panel column's at depth z, by Eq. 1."""
    axes = []
    for pixels, lenses, sign in (
        (device.eia_shape[0], device.lens_rows, -1),
        (device.eia_shape[1], device.lens_columns, 1),
    ):
        x = (np.arange(pixels) + 0.5 - pixels / 2) * device.pixel_pitch_mm
        lens = np.arange(pixels) * lenses // pixels
        x0 = (lens + 0.5 - lenses / 2) * device.pitch_mm
        axes.append(sign * (x0 + (x0 - x) * z / device.gap_mm))
    return axes[0], axes[1]


# -- first hits ---------------------------------------------------------------------------------


@pytest.mark.parametrize("algorithm", ["template", "gu2020", "gu2020:step_mm=20.9"])
def test_depth_equal_to_the_far_end_is_seen_below_it_is_not(algorithm):
    device = display(depth_min_mm=4.0, depth_max_mm=8.0)
    for depth, holes in ((np.float32(4.0), 0), (np.nextafter(np.float32(4.0), np.float32(0)), 1)):
        rgbd = picture(np.full((40, 48), depth), 0.25)
        assert hole_fraction(find_sources(rgbd, device, algorithm)) == holes


def test_columns_that_end_are_nearer_to_the_truth_than_solid_ones():
    display = small_display(24, 24, 17)
    rgbd = two_spheres(display, display.capture_shape(5), display.capture_pixel_mm(5))
    truth = srgb_from_linear(two_spheres_eia(display))
    error = [
        np.mean((generate(rgbd, display, f"{a}:samples=4")[..., :3] / 255 - truth) ** 2)
        for a in (SOLID, "template")
    ]
    assert 10 * math.log10(error[0] / error[1]) > 4


def test_rays_and_tables_without_end_are_refused_or_walked():
    """A picture of 50,000 pixels per pitch took 894 GiB as tables."""
    fine = small_display(3, 3, pixels=5, depth_min_mm=1e-3, depth_max_mm=1.5e-3)
    rgbd = solids_of(noise(fine, (16, 16), 2e-5), fine)
    assert (find_sources(rgbd, fine, "layered", samples=1) >= 0).any()
    far = small_display(2, 2, pixels=3, gap_mm=3.0 * (1 + 2.0**-24))
    for device in (far, far.replace(rotation_deg=4.0)):
        for algorithm in ("layered", "template"):
            with pytest.raises(UsageError, match=f"{algorithm}: a ray crosses .* make sense"):
                prepare(device, algorithm, shape=(9, 9), pixel_mm=0.5)


# -- gu2020 -------------------------------------------------------------------------------------


def searched(rgbd: RGBD, device: Display, step: float) -> np.ndarray:
    """All samples of all rays at once, picked by argmax."""
    low, high = device.depth_range_mm
    z = np.append(np.arange(high, low + 1e-9 * step, -step), low)
    v, u = (
        np.floor(np.array(a.start, float)[:, None] + np.array(a.slope, float)[:, None] * z)
        for a in oracle.all_rays(rgbd, device)
    )
    high_cells, wide = rgbd.shape
    inside = ((v >= 0) & (v < high_cells))[:, None] & ((u >= 0) & (u < wide))[None]
    source = (v[:, None] * wide + u[None]).astype(int)
    depth = np.where(rgbd.covered, rgbd.depth_mm.astype(float), -np.inf).ravel()
    hit = inside & (depth[np.where(inside, source, 0)] >= z)
    first = hit.argmax(axis=2)[..., None]
    return np.where(hit.any(axis=2), np.take_along_axis(source, first, 2)[..., 0], HOLE)


@pytest.mark.parametrize("mode", [{"depth_min_mm": 20.0, "depth_max_mm": 41.0}, VIRTUAL])
@pytest.mark.parametrize("step", [0.37, 5.3])
def test_gu2020_steps_as_far_as_its_option(mode, step):
    display = small_display(4, 3, pixel_pitch_mm=1 / 15.7, **mode)
    rgbd = noise(display, (33, 37), 0.27171, covered=0.4)
    sources = find_sources(rgbd, display, "gu2020", step_mm=step)
    lensed = sources != NO_LENS
    assert np.array_equal(sources[lensed], searched(rgbd, display, step)[lensed])


@pytest.mark.parametrize("step", ["0", -1, "fast", "nan", "inf", True, 1e-9])
def test_step_that_makes_no_sense_is_refused_by_name(step):
    with pytest.raises(UsageError, match="step_mm"):
        prepare(display(NOMINAL), "gu2020", shape=(4, 4), pixel_mm=1.0, step_mm=step)


# -- wang2024 -----------------------------------------------------------------------------------


def entries(
    rgbd: RGBD, device: Display, row: int, column: int,
    matching: str = "matrix", rounding: str = "nearest", step_pixel: str = "picture",
    cells: str = "at_depth",
) -> tuple[float, list[tuple[float, int]]]:  # fmt: skip
    """Eq. 5 to 10 for one panel pixel, read off the text: the step, and each entry's mismatch."""
    p_i = rgbd.pixel_mm if step_pixel == "picture" else device.scene_pixel_mm
    g, cell = device.gap_mm, rgbd.pixel_mm
    high, wide = rgbd.shape
    low, top = device.depth_range_mm
    pixels = round(device.pixels_per_lens)
    (m, v), (n, u) = divmod(row, pixels), divmod(column, pixels)
    x0 = (n - (device.lens_columns - 1) / 2) * device.pitch_mm
    y0 = ((device.lens_rows - 1) / 2 - m) * device.pitch_mm
    dx = ((pixels - 1) / 2 - u) * device.pixel_pitch_mm  # x0 - x
    dy = (v - (pixels - 1) / 2) * device.pixel_pitch_mm  # y0 - y
    travel = max(abs(dx), abs(dy)) / g / p_i * (top - low)  # pixels P_I over the whole range
    if travel < (0.5 if rounding == "nearest" else 1):
        step, depths = top - low, [device.central_depth_mm]
    else:
        step = p_i * g / max(abs(dx), abs(dy))  # Eq. 5
        z_len = round(travel + 1) if rounding == "nearest" else math.ceil(travel) + 1  # Eq. 6
        depths = [low + i * step for i in range(z_len)]
    at_row = [math.floor(high / 2 - (y0 + dy / g * z) / cell) for z in depths]
    at_column = [math.floor(wide / 2 + (x0 + dx / g * z) / cell) for z in depths]
    if cells == "consecutive":
        at_row = [at_row[0] - i * (1 if dy > 0 else -1) for i in range(len(depths))]
        at_column = [at_column[0] + i * (1 if dx >= 0 else -1) for i in range(len(depths))]
    mismatches = []
    for i, (z, r) in enumerate(zip(depths, at_row, strict=True)):
        for c in [at_column[i]] if matching == "ray" else at_column:
            if 0 <= r < high and 0 <= c < wide and rgbd.covered[r, c]:
                mismatches.append((abs(float(rgbd.depth_mm[r, c]) - z), r * wide + c))
    return step, mismatches


@pytest.mark.parametrize(
    "mode", [{"depth_min_mm": 26.0, "depth_max_mm": 41.0},
             {"focal_length_mm": 3.6, "depth_min_mm": -40.0, "depth_max_mm": -31.0}],
)  # fmt: skip
@pytest.mark.parametrize("pixels", [4, 5])
@pytest.mark.parametrize(
    "options",
    [{"rounding": "up"}, {"step_pixel": "scene"},
     {"matching": "ray", "rounding": "up", "step_pixel": "scene"},
     {"cells": "consecutive"}, {"matching": "ray", "cells": "consecutive"}],
    ids=str,
)  # fmt: skip
def test_wang2024_takes_the_best_entry_under_each_option(mode, pixels, options):
    display = small_display(3, 2, pixels, **mode)
    rgbd = noise(display, (23, 20), 0.2717, seed=pixels)
    sources = find_sources(rgbd, display, "wang2024", **options)
    assert (sources >= 0).any()
    for (row, column), source in np.ndenumerate(sources):
        step, mismatches = entries(rgbd, display, row, column, **options)
        best = min((mismatch for mismatch, _ in mismatches), default=math.inf)
        # Entries may tie: the same cell is met from several columns of the matrix.
        tied = {s for d, s in mismatches if d <= best + 1e-9}
        assert source == HOLE if best >= step else source in tied


@pytest.mark.parametrize(
    ("low", "high", "at"),
    [(20.0, 26.0, 23.0), (31.0, 37.0, 33.0), (28.0, 34.0, 33.0)],
    ids=["middle of the range", "D below the middle", "D above the middle"],
)
def test_single_entry_is_at_the_central_depth_plane_or_else_in_the_middle(low, high, at):
    # No ray moves by half a cell over a range this short: one entry each. D = 33.
    display = small_display(3, 2, 5, depth_min_mm=low, depth_max_mm=high)
    sources = find_sources(picture(np.full((14, 15), at), 1.51), display, "wang2024")
    listed = np.ones(display.eia_shape, bool)
    masked = find_sources(picture(np.full((14, 15), at), 1.51), display, "wang2024", mask=listed)
    assert np.array_equal(masked, sources)
    y, x = ray_at(display, at)
    row, column = np.floor(7 - y / 1.51).astype(int), np.floor(7.5 + x / 1.51).astype(int)
    assert np.array_equal(sources, row[:, None] * 15 + column)


# -- li2012 -------------------------------------------------------------------------------------


@pytest.mark.parametrize("z", [12.0, 33.0, -12.0, -33.0])
def test_single_pixel_lands_at_the_place_of_the_closed_form(z):
    display = small_display(12, 10, pixels=9)
    row, column, cell = 11, 21, 0.2371
    sources = find_sources(only((31, 35), (row, column), z, cell), display, "li2012")
    x, y = (column + 0.5 - 35 / 2) * cell, (31 / 2 - row - 0.5) * cell
    expected = set()
    for m in range(10):
        for n in range(12):
            x0, y0 = n - 5.5, 4.5 - m
            across, up = (x0 - x) * 3.3 / z, (y0 - y) * 3.3 / z
            if abs(across) <= 0.5 and abs(up) <= 0.5:
                expected.add((math.floor((5 - y0 - up) * 9), math.floor((6 + x0 + across) * 9)))
    assert expected
    assert {(int(j), int(i)) for j, i in np.argwhere(sources >= 0)} == expected
    assert set(sources[sources >= 0]) == {row * 35 + column}


def test_pixel_on_the_axis_lands_to_the_left_and_above():
    sources = find_sources(only((3, 3), (1, 1), 20.0, 0.2), small_display(1, 1, 4), "li2012")
    assert np.argwhere(sources >= 0).tolist() == [[1, 1]]


@pytest.mark.parametrize("shape", [(20, 25), (25, 20)])
@pytest.mark.parametrize("levels", [1, 3])
def test_equal_landings_keep_the_mirror(shape, levels):
    display = small_display(4, 3, 5, depth_min_mm=20.0, depth_max_mm=41.0)
    random = np.random.default_rng(levels)
    rgbd = picture(20 + 7.0 * random.integers(0, levels, shape), 0.2, random.random(shape) < 0.8)
    sources, index = find_sources(rgbd, display, "li2012"), np.arange(rgbd.depth_mm.size)
    for axis in (0, 1):
        there = picture(np.flip(rgbd.depth_mm, axis), 0.2, np.flip(rgbd.covered, axis))
        back = np.flip(find_sources(there, display, "li2012"), axis)
        named = np.where(back >= 0, np.flip(index.reshape(shape), axis).ravel()[back], back)
        # A point on the axis has to go one way.
        middle = [(display.eia_shape[axis] - 1) // 2, display.eia_shape[axis] // 2]
        assert np.array_equal(np.delete(named, middle, axis), np.delete(sources, middle, axis))


@pytest.mark.parametrize("algorithm", ["template", SOLID, "gu2020", "layered"])
@pytest.mark.parametrize("changes", [{}, {"lattice": "hexagonal"}, {"rotation_deg": 3.0}])
def test_a_surface_at_an_end_of_the_depth_range_is_shown(algorithm, changes):
    display = small_display(depth_min_mm=-24.1, depth_max_mm=24.1, **changes)
    low, high = display.depth_range_mm
    assert float(np.float32(low)) < low  # a float32 picture's far end is beyond the range
    for z in (low, high):
        rgbd = picture(np.full((300, 300), z), 0.25)
        assert not (find_sources(rgbd, display, f"{algorithm}:fill=none") == HOLE).any()


def test_pixel_on_the_array_is_skipped_and_extreme_depths_do_no_harm():
    display = small_display(4, 4, pixels=9)
    depth = np.zeros((9, 9))
    assert (find_sources(picture(depth, 0.25), display, "li2012") == HOLE).all()
    assert (generate(picture(depth, 0.25), display, "li2012:fill=hidden") == 0).all()
    depth[2, 3], depth[4, 5] = -20.0, 20.0
    sources = find_sources(picture(depth, 0.25), display, "li2012")
    assert set(sources[sources >= 0]) == {2 * 9 + 3, 4 * 9 + 5}
    for z in (1e-30, -1e-30, 1e12, -1e12, 0.01):
        sources = find_sources(picture(np.full((16, 16), z), 0.3), display, "li2012")
        assert sources.min() >= HOLE and sources.max() < 256


# -- the interface ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("algorithm", "words"),
    [
        ("li2013", "'li2013': did you mean li2012?"),
        ("x", "'x': use template or .* wang2024"),
        ("template:samples=3", "template: samples = '3'"),
        ("layered:samples=many", "layered: samples = 'many'"),
        ("template:sample=1", "'sample'; its options are columns, .*fill; did you mean samples?"),
        ("template:columns=open", "columns = 'open': use surface or solid"),
        ("template:mask=all", "has no option 'mask'"),
        ("gu2020:samples=3", "gu2020: samples = '3': use auto or centre or 1"),
        ("gu2020:implementation=python", "'gu2020' has no option 'implementation'"),
        ("wang2024:matching=diagonal", "matching = 'diagonal': use matrix or ray"),
        ("li2012:fill=telea", "fill = 'telea': use none or hidden or all"),
    ],
)
def test_unknown_names_options_and_values_are_refused_with_those_there_are(algorithm, words):
    with pytest.raises(UsageError, match=words):
        prepare(small_display(), algorithm, shape=(4, 4), pixel_mm=1.0)


@pytest.mark.parametrize(
    ("algorithm", "changes", "words"),
    [
        ("wang2024:step_pixel=scene", {"gap_mm": 3.0, "depth_min_mm": 1, "depth_max_mm": 9}, "is"),
        *(
            (algorithm, changes, f"{algorithm}.*{word}")
            for algorithm in ("li2012",)
            for changes, word in (({"rotation_deg": 4.0}, "rotation_deg = 4"),
                                  ({"lattice": "hexagonal"}, "hexagonal"))
        ),
    ],
)  # fmt: skip
def test_displays_that_a_method_does_not_serve_are_refused_by_name(algorithm, changes, words):
    with pytest.raises(UsageError, match=words):
        prepare(small_display(**changes), algorithm, shape=(9, 9), pixel_mm=0.5)


def test_pictures_and_places_of_another_size_are_refused():
    display = small_display()
    rgbd = noise(display, (24, 30), 0.5)
    with pytest.raises(UsageError, match="prepared for 40 x 50"):
        prepare(display, shape=(40, 50), pixel_mm=0.5).generate(rgbd)
    out = np.empty((*display.eia_shape, 3), np.float32)
    for wrong in (out[:-1], out.astype(np.float64), out[:, ::-1], np.asfortranarray(out)):
        with pytest.raises(UsageError, match="out"):
            generate(rgbd, display, out=wrong)
    for mask in (np.ones((3, 3), bool), np.ones(display.eia_shape, np.uint8)):
        for algorithm in ("template", "li2012"):
            with pytest.raises(UsageError, match=r"must be bool of the panel's \(80, 96\)"):
                prepare(display, algorithm, shape=(4, 4), pixel_mm=1.0, mask=mask)


class Bright:
    """A generator by others, without a mask and with one place to write to."""

    def __init__(self, display: Display) -> None:
        self.place = np.ones((*display.eia_shape, 3), np.float32)

    def generate(self, rgbd: RGBD, out: np.ndarray | None = None) -> np.ndarray:
        return self.place


def test_a_generator_without_masks_is_run_in_full(monkeypatch):
    display = small_display(5, 4, 3)
    single = Bright(display)
    bright = Algorithm("bright", lambda display, shape, pixel_mm: single, options={})
    monkeypatch.setattr("inim.generators.registry.find_algorithm", lambda name: bright)
    mask = np.random.default_rng(1).random(display.eia_shape) < 0.4
    generator = prepare(display, "bright", shape=(8, 10), pixel_mm=0.5, mask=mask)
    rgbd = noise(display, (8, 10), 0.5)
    masked = np.repeat(mask[..., None], 3, axis=-1)
    assert np.array_equal(generator.generate(rgbd), masked)
    assert np.array_equal(run_generator(generator, rgbd, mask)[0], masked)
    assert single.place.all()
