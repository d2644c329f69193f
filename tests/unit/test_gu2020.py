"""`gu2020` samples each ray at fixed steps of depth, from the viewer's side."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from inim.display import DISPLAYS, Display
from inim.errors import UsageError
from inim.generators import HOLE, find_sources, prepare
from inim.image.rgbd import RGBD
from tests import oracle
from tests.conftest import small_display

REAL = {"depth_min_mm": 20.0, "depth_max_mm": 41.0}
VIRTUAL = {"focal_length_mm": 3.6, "depth_min_mm": -41.0, "depth_max_mm": -20.0}


def picture(depth: Any, cell_mm: float, covered: Any = None) -> RGBD:
    depth = np.asarray(depth, np.float32)
    covered = np.ones(depth.shape, bool) if covered is None else covered
    return RGBD(np.ones((*depth.shape, 3)), depth, covered, cell_mm)


def rough(shape: tuple[int, int], cell_mm: float, shown: Display) -> RGBD:
    random = np.random.default_rng(shape[0])
    depth = random.uniform(*shown.depth_range_mm, shape)
    return picture(depth, cell_mm, random.random(shape) < 0.4)


def searched(rgbd: RGBD, shown: Display, step: float) -> np.ndarray:
    """All samples of all rays at once, positions in millimetres, picked by argmax."""
    low, high = shown.depth_range_mm
    z = np.append(np.arange(high, low + 1e-9 * step, -step), low)
    rows, columns = oracle.all_rays(rgbd, shown)
    v, u = (
        np.floor(np.array(a.start, float)[:, None] + np.array(a.slope, float)[:, None] * z)
        for a in (rows, columns)
    )
    high_cells, wide = rgbd.shape
    inside = ((v >= 0) & (v < high_cells))[:, None] & ((u >= 0) & (u < wide))[None]
    source = (v[:, None] * wide + u[None]).astype(int)
    depth = np.where(rgbd.covered, rgbd.depth_mm.astype(float), -np.inf).ravel()
    hit = inside & (depth[np.where(inside, source, 0)] >= z)
    first = hit.argmax(axis=2)[..., None]
    return np.where(hit.any(axis=2), np.take_along_axis(source, first, 2)[..., 0], HOLE)


@pytest.mark.parametrize("mode", [REAL, VIRTUAL], ids=["real", "virtual"])
@pytest.mark.parametrize("pixel_mm", [1 / 4, 1 / 5, 1 / 15.7])
@pytest.mark.parametrize("step", [None, 0.37, 5.3])
def test_first_sample_under_a_surface_wins(
    mode: dict[str, float], pixel_mm: float, step: float | None
) -> None:
    shown = small_display(4, 3, pixel_pitch_mm=pixel_mm, **mode)
    rgbd = rough((33, 37), 0.27171, shown)
    sources = find_sources(rgbd, shown, "gu2020", step_mm=step)
    expected = searched(rgbd, shown, shown.scene_pixel_mm if step is None else step)
    lensed = sources != -2
    assert np.array_equal(sources[lensed], expected[lensed])
    assert (sources >= 0).any() and (sources == HOLE).any()


@pytest.mark.parametrize(("z", "mode"), [(31.0, REAL), (-31.0, VIRTUAL)])
def test_single_pixel_is_shown_where_its_image_falls(z: float, mode: dict[str, float]) -> None:
    # A plate one pixel wide at the depth of a sample, nothing behind it: cut the far end there.
    shown = small_display(8, 6, pixels=16, **mode | {"depth_min_mm": z})
    row, column, cell = 8, 14, 0.4713
    covered = np.zeros((19, 23), bool)
    covered[row, column] = True
    rgbd = picture(np.full(covered.shape, z), cell, covered)
    seen = find_sources(rgbd, shown, "gu2020") == row * 23 + column
    g = shown.gap_mm
    x = (np.arange(128) + 0.5) / 16 - 4
    y = 3 - (np.arange(96) + 0.5) / 16
    x0, y0 = np.floor(x) + 0.5, np.floor(y) + 0.5
    at_x, at_y = x0 + (x0 - x) * z / g, y0 + (y0 - y) * z / g
    in_column = np.floor(at_x / cell + 23 / 2) == column
    in_row = np.floor(19 / 2 - at_y / cell) == row
    assert in_row.any() and in_column.any()
    assert np.array_equal(seen, in_row[:, None] & in_column)


def two_squares(shown: Display, cell_mm: float = 0.2371) -> RGBD:
    """A near square over a far one, on nothing."""
    low, high = shown.depth_range_mm
    depth = np.full((60, 66), low + 0.2 * (high - low))
    depth[20:38, 24:45] = low + 0.8 * (high - low)
    covered = np.zeros(depth.shape, bool)
    covered[12:50, 10:50] = True
    return picture(depth, cell_mm, covered)


NOMINAL = Display(**{**DISPLAYS["nominal"].given(), "lens_columns": 7, "lens_rows": 6})


@pytest.mark.parametrize("mode", [{}, VIRTUAL], ids=["real", "virtual"])
def test_nearer_square_hides_farther_one(mode: dict[str, float]) -> None:
    shown = NOMINAL.replace(**mode)
    rgbd = two_squares(shown)
    sources = find_sources(rgbd, shown, "gu2020")
    # Every ray that meets the front of the near square shows the near square.
    z = float(rgbd.depth_mm.max())
    rows, columns = oracle.all_rays(rgbd, shown)
    v, u = (
        np.floor(np.array(a.start, float) + np.array(a.slope, float) * z) for a in (rows, columns)
    )
    near = ((v >= 20) & (v < 38))[:, None] & ((u >= 24) & (u < 45))
    assert near.any()
    assert (rgbd.depth_mm.ravel()[sources[near]] == rgbd.depth_mm.max()).all()
    assert (sources[near] >= 0).all()


def test_wrong_sources_fade_as_the_step_does() -> None:
    random = np.random.default_rng(4)
    depth = random.uniform(20, 45, (60, 66))
    rgbd = picture(depth, 0.2371, random.random(depth.shape) < 0.5)
    right = oracle.float_sources(rgbd, NOMINAL, columns="solid")
    clear = ~oracle.doubtful(rgbd, NOMINAL, columns="solid")
    assert clear.mean() > 0.9
    steps = (8.0, 2.0, 0.5, 0.125, 0.03125, 0.005)
    wrong = [
        np.mean((find_sources(rgbd, NOMINAL, "gu2020", step_mm=s) != right)[clear]) for s in steps
    ]
    assert wrong[0] > 0.2
    # First order: a cell is missed when the stretch inside it is shorter than the step.
    assert all(finer < 0.6 * coarser for coarser, finer in pairwise(wrong))
    assert 0 < wrong[-2] < 0.01
    assert wrong[-1] < 0.001


@pytest.mark.parametrize("shape", [(31, 36), (36, 31)])
@pytest.mark.parametrize("pixels", [4, 5])
def test_mirrored_picture_gives_the_mirrored_map(shape: tuple[int, int], pixels: int) -> None:
    # A range whose samples lie on no border, as rays at D would.
    shown = small_display(5, 4, pixels=pixels, depth_min_mm=20.0, depth_max_mm=41.03)
    rgbd = rough(shape, 0.27171, shown)
    sources = find_sources(rgbd, shown, "gu2020")
    index = np.arange(rgbd.depth_mm.size).reshape(shape)
    for axis in (0, 1):
        there = picture(np.flip(rgbd.depth_mm, axis), 0.27171, np.flip(rgbd.covered, axis))
        back = np.flip(find_sources(there, shown, "gu2020"), axis)
        # The ray of a middle pixel under a middle lens may run along a border.
        named = np.where(back >= 0, np.flip(index, axis).ravel()[back], back)
        middle = [(shown.eia_shape[axis] - 1) // 2, shown.eia_shape[axis] // 2]
        assert np.array_equal(np.delete(named, middle, axis), np.delete(sources, middle, axis))


def test_surface_at_the_far_end_is_found_though_no_whole_step_ends_there() -> None:
    shown = small_display(4, 3, pixels=5, **REAL)
    rgbd = picture(np.full((120, 120), 20.0), 0.1371)
    for step in (0.8, 4.0, 20.9, 100.0):
        assert (find_sources(rgbd, shown, "gu2020", step_mm=step) >= 0).all()
    beyond = picture(np.full((120, 120), 19.999), 0.1371)
    assert (find_sources(beyond, shown, "gu2020") == HOLE).all()


def test_default_step_is_the_scene_pixel_or_that_of_the_picture_on_a_focused_display() -> None:
    shown = small_display(5, 4, pixels=5, **REAL)
    rgbd = rough((50, 50), 0.2371, shown)

    def sources(display: Display, step: Any = None) -> np.ndarray:
        return find_sources(rgbd, display, "gu2020", step_mm=step)

    # P_I = D P_D / g = 33 x 0.2 / 3.3
    assert np.array_equal(sources(shown), sources(shown, 2.0))
    assert not np.array_equal(sources(shown), sources(shown, 0.2371))
    focused = shown.replace(focal_length_mm=3.3)
    assert np.array_equal(sources(focused), sources(focused, "0.2371"))


@pytest.mark.parametrize("step", ["0", -1, "fast", "nan", "inf", True, 1e-9])
def test_step_that_makes_no_sense_is_refused_by_name(step: Any) -> None:
    with pytest.raises(UsageError, match="step_mm"):
        prepare(NOMINAL, "gu2020", shape=(4, 4), pixel_mm=1.0, step_mm=step)
