"""`wang2024` does what its text says the paper prints, no more and no less."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from inim.display import DISPLAYS, Display
from inim.errors import UsageError
from inim.generators import HOLE, NO_LENS, find_sources
from inim.image.rgbd import RGBD
from tests import oracle

BASE = {
    "pitch_mm": 1.0,
    "focal_length_mm": 3.0,
    "gap_mm": 3.3,
    "pixel_pitch_mm": 1 / 5,
    "lens_columns": 3,
    "lens_rows": 2,
    "depth_min_mm": 26.0,
    "depth_max_mm": 41.0,
}


def display(**changes: Any) -> Display:
    return Display(**{**BASE, **changes})


def picture(depth: Any, cell_mm: float, covered: Any = None) -> RGBD:
    depth = np.asarray(depth, np.float32)
    covered = np.ones(depth.shape, bool) if covered is None else covered
    return RGBD(np.ones((*depth.shape, 3)), depth, covered, cell_mm)


def rough(shape: tuple[int, int], cell_mm: float, shown: Display, seed: int = 0) -> RGBD:
    random = np.random.default_rng(seed)
    depth = random.uniform(*shown.depth_range_mm, shape)
    return picture(depth, cell_mm, random.random(shape) < 0.8)


def two_squares(shown: Display, cell_mm: float = 0.2371) -> RGBD:
    """A near square over a far one, on nothing."""
    low, high = shown.depth_range_mm
    depth = np.full((60, 66), low + 0.2 * (high - low))
    depth[20:38, 24:45] = low + 0.8 * (high - low)
    covered = np.zeros(depth.shape, bool)
    covered[12:50, 10:50] = True
    return picture(depth, cell_mm, covered)


def entries(
    rgbd: RGBD, shown: Display, row: int, column: int,
    matching: str = "matrix", rounding: str = "nearest", step_pixel: str = "picture",
) -> tuple[float, list[tuple[float, int]]]:  # fmt: skip
    """Eq. 5 to 10 for one panel pixel, read off the text: the step, and each entry's mismatch."""
    p_i = rgbd.pixel_mm if step_pixel == "picture" else shown.scene_pixel_mm
    g, cell = shown.gap_mm, rgbd.pixel_mm
    high, wide = rgbd.shape
    low, top = shown.depth_range_mm
    pixels = round(shown.pixels_per_lens)
    m, v = divmod(row, pixels)
    n, u = divmod(column, pixels)
    x0 = (n - (shown.lens_columns - 1) / 2) * shown.pitch_mm
    y0 = ((shown.lens_rows - 1) / 2 - m) * shown.pitch_mm
    dx = ((pixels - 1) / 2 - u) * shown.pixel_pitch_mm  # x0 - x
    dy = (v - (pixels - 1) / 2) * shown.pixel_pitch_mm  # y0 - y
    travel = max(abs(dx), abs(dy)) / g / p_i * (top - low)  # pixels P_I over the whole range
    if travel < (0.5 if rounding == "nearest" else 1):
        step, depths = top - low, [shown.central_depth_mm]
    else:
        step = p_i * g / max(abs(dx), abs(dy))  # Eq. 5
        z_len = round(travel + 1) if rounding == "nearest" else math.ceil(travel) + 1  # Eq. 6
        depths = [low + i * step for i in range(z_len)]
    found = []
    for z in depths:
        r = math.floor(high / 2 - (y0 + dy / g * z) / cell)
        for across in [z] if matching == "ray" else depths:
            c = math.floor(wide / 2 + (x0 + dx / g * across) / cell)
            if 0 <= r < high and 0 <= c < wide and rgbd.covered[r, c]:
                found.append((abs(float(rgbd.depth_mm[r, c]) - z), r * wide + c))
    return step, found


@pytest.mark.parametrize(
    "gap", [{}, {"focal_length_mm": 3.6, "depth_min_mm": -40, "depth_max_mm": -31}]
)
@pytest.mark.parametrize("pixels", [3, 4, 5])
@pytest.mark.parametrize("shape", [(14, 17), (23, 20)])
@pytest.mark.parametrize(
    "options",
    [
        {}, {"matching": "ray"}, {"rounding": "up"}, {"step_pixel": "scene"},
        {"matching": "ray", "rounding": "up", "step_pixel": "scene"},
    ],
    ids=str,
)  # fmt: skip
def test_best_entry_of_the_whole_matrix_or_of_the_ray_wins(
    gap: dict[str, float], pixels: int, shape: tuple[int, int], options: dict[str, str]
) -> None:
    shown = display(pixel_pitch_mm=1 / pixels, **gap)
    rgbd = rough(shape, 0.2717, shown, seed=pixels)
    sources = find_sources(rgbd, shown, "wang2024", **options)
    seen = holes = 0
    for row, column in np.ndindex(sources.shape):
        step, found = entries(rgbd, shown, row, column, **options)
        best = min((mismatch for mismatch, _ in found), default=math.inf)
        if best >= step:
            assert sources[row, column] == HOLE
            holes += 1
        else:
            # Entries may tie: the same cell is met from several columns of the matrix.
            assert sources[row, column] in {s for d, s in found if d <= best + 1e-9}
            seen += 1
    assert seen > 0


def test_pixel_under_the_lens_centre_has_one_entry_at_the_central_depth_plane() -> None:
    # Odd pixels: the middle one looks straight ahead, and Eq. 5 would divide by zero.
    shown = display()
    cell = 0.2717
    rgbd = rough((24, 30), cell, shown, seed=2)
    sources = find_sources(rgbd, shown, "wang2024").reshape(2, 5, 3, 5)[:, 2, :, 2]
    for m in range(2):
        for n in range(3):
            row = math.floor(12 - (0.5 - m) / cell)
            column = math.floor(15 + (n - 1) / cell)
            expected = row * 30 + column if rgbd.covered[row, column] else HOLE
            assert sources[m, n] == expected


@pytest.mark.parametrize(
    ("low", "high", "at"),
    [(20.0, 26.0, 23.0), (31.0, 37.0, 33.0), (28.0, 34.0, 33.0)],
    ids=["middle of the range", "D below the middle", "D above the middle"],
)
def test_single_entry_lies_at_the_central_depth_plane_or_else_in_the_middle(
    low: float, high: float, at: float
) -> None:
    # No ray moves by half a cell over a range this short: one entry each. D = 33.
    shown = display(depth_min_mm=low, depth_max_mm=high)
    cell = 1.51
    sources = find_sources(picture(np.full((14, 15), at), cell), shown, "wang2024")
    for row, column in np.ndindex(sources.shape):
        x = (column + 0.5) / 5 - 1.5
        y = 1 - (row + 0.5) / 5
        x0, y0 = column // 5 - 1, 0.5 - row // 5
        at_x, at_y = x0 + (x0 - x) * at / 3.3, y0 + (y0 - y) * at / 3.3
        expected = math.floor(7 - at_y / cell) * 15 + math.floor(7.5 + at_x / cell)
        assert sources[row, column] == expected


def test_uncovered_matches_nothing() -> None:
    shown = display()
    nothing = picture(np.full((20, 20), 33.0), 0.25, np.zeros((20, 20), bool))
    assert (find_sources(nothing, shown, "wang2024") == HOLE).all()
    rgbd = rough((20, 20), 0.2717, shown)
    sources = find_sources(rgbd, shown, "wang2024")
    assert rgbd.covered.ravel()[sources[sources >= 0]].all()
    strange = picture(np.where(rgbd.covered, rgbd.depth_mm, np.nan), 0.2717, rgbd.covered)
    assert np.array_equal(find_sources(strange, shown, "wang2024"), sources)


def test_flat_picture_on_a_sampled_depth_is_matched_on_that_depth() -> None:
    # The far end of the range is a sample of every template with more than one entry.
    shown = display(depth_min_mm=20.0, depth_max_mm=41.0)
    rgbd = picture(np.full((80, 80), 20.0), 0.1237)
    sources = find_sources(rgbd, shown, "wang2024")
    # z depends on the row alone: the row must be the ray's, the column may be any of the matrix.
    y = 1 - (np.arange(10) + 0.5) / 5
    y0 = 0.5 - np.arange(10) // 5
    rows = np.floor(40 - (y0 + (y0 - y) * 20 / 3.3) / 0.1237).astype(int)
    for row, column in np.ndindex(sources.shape):
        if (row % 5, column % 5) != (2, 2):
            assert sources[row, column] // 80 == rows[row]


@pytest.mark.parametrize("share", [0.0, 0.31, 0.77, 1.0])
def test_rounded_to_the_nearest_every_depth_is_within_half_a_step_of_a_sample(share: float) -> None:
    # The outermost rays cross 4.3 cells: five samples, the last 0.3 steps before z_max.
    shown = display(depth_min_mm=20.0, depth_max_mm=36.5)
    at = 20 + share * 16.5
    rgbd = picture(np.full((60, 60), at), 2 / 4.3)
    step, found = entries(rgbd, shown, 0, 0, "ray")
    assert len(found) == 5
    assert len(entries(rgbd, shown, 0, 0, "ray", "up")[1]) == 6
    assert min(mismatch for mismatch, _ in found) <= step / 2
    along = {r: find_sources(rgbd, shown, "wang2024:matching=ray", rounding=r)
             for r in ("nearest", "up")}  # fmt: skip
    assert (along["nearest"] != HOLE).all()
    assert along["nearest"][0, 0] == along["up"][0, 0]


def test_in_scene_pixels_the_number_of_steps_does_not_depend_on_the_picture() -> None:
    shown = display()
    lengths = {
        (step_pixel, cell): len(entries(picture(np.full((200, 200), 33.0), cell), shown, 0, 0,
                                        "ray", step_pixel=step_pixel)[1])
        for step_pixel in ("picture", "scene")
        for cell in (0.1, 0.05)
    }  # fmt: skip
    assert lengths["scene", 0.1] == lengths["scene", 0.05]
    assert lengths["picture", 0.05] > 1.8 * lengths["picture", 0.1]


def test_a_focused_display_has_no_scene_pixel_to_step_by() -> None:
    shown = display(gap_mm=3.0)
    rgbd = rough((20, 24), 0.2717, shown)
    with pytest.raises(UsageError, match="focused"):
        find_sources(rgbd, shown, "wang2024:step_pixel=scene")


def test_panel_pixels_outside_the_array_show_no_lens() -> None:
    shown = display(panel_columns=21, panel_rows=10)
    sources = find_sources(rough((20, 24), 0.25, shown), shown, "wang2024")
    assert (sources[:, :3] == NO_LENS).all() and (sources[:, -3:] == NO_LENS).all()
    assert (sources[:, 3:-3] != NO_LENS).all()


def test_more_pixels_come_from_the_wrong_cell_than_by_the_exact_template() -> None:
    shown = Display(**{**DISPLAYS["nominal"].given(), "lens_columns": 7, "lens_rows": 6})
    rgbd = two_squares(shown)
    right = oracle.float_sources(rgbd, shown)
    clear = ~oracle.doubtful(rgbd, shown)
    share = {
        name: np.mean(find_sources(rgbd, shown, name)[clear] != right[clear])
        for name in ("template", "wang2024")
    }
    assert share["template"] == 0
    assert share["wang2024"] > 0.05


def test_farther_surface_can_win_because_occlusion_plays_no_part() -> None:
    shown = Display(**{**DISPLAYS["nominal"].given(), "lens_columns": 7, "lens_rows": 6})
    rgbd = two_squares(shown)
    near = rgbd.depth_mm == rgbd.depth_mm.max()
    exact, printed = (find_sources(rgbd, shown, name) for name in ("template", "wang2024"))
    behind = near.ravel()[np.maximum(exact, 0)] & (exact >= 0) & (printed >= 0)
    assert (~near.ravel()[printed[behind]]).any()


def test_the_whole_matrix_is_searched_unless_asked_otherwise() -> None:
    shown = display()
    rgbd = rough((20, 24), 0.2717, shown)
    as_printed = find_sources(rgbd, shown, "wang2024")
    assert np.array_equal(find_sources(rgbd, shown, "wang2024:matching=matrix"), as_printed)
    assert not np.array_equal(find_sources(rgbd, shown, "wang2024:matching=ray"), as_printed)


def test_along_the_ray_fewer_pixels_come_from_the_wrong_cell_than_from_the_whole_matrix() -> None:
    shown = Display(**{**DISPLAYS["nominal"].given(), "lens_columns": 7, "lens_rows": 6})
    rgbd = two_squares(shown)
    right = oracle.float_sources(rgbd, shown)
    seen = right >= 0
    share = {
        matching: np.mean((find_sources(rgbd, shown, "wang2024", matching=matching) != right)[seen])
        for matching in ("matrix", "ray")
    }
    assert 0 < share["ray"] < 0.7 * share["matrix"]
