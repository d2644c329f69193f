"""`li2012` sends every pixel through every lens; what stays empty is a hole, and counted."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from inim.display import Display
from inim.generators import HOLE, find_sources, generate, hole_fraction
from inim.image.rgbd import RGBD
from tests import oracle
from tests.conftest import small_display

REAL = {"depth_min_mm": 20.0, "depth_max_mm": 41.0}
VIRTUAL = {"focal_length_mm": 3.6, "depth_min_mm": -41.0, "depth_max_mm": -20.0}


def picture(depth: Any, cell_mm: float, covered: Any = None, color: Any = None) -> RGBD:
    depth = np.asarray(depth, np.float32)
    covered = np.ones(depth.shape, bool) if covered is None else covered
    color = np.ones((*depth.shape, 3)) if color is None else color
    return RGBD(color, depth, covered, cell_mm)


def one_pixel(row: int, column: int, z: float, shape=(31, 35), cell_mm=0.2371) -> RGBD:
    covered = np.zeros(shape, bool)
    covered[row, column] = True
    return picture(np.full(shape, z), cell_mm, covered)


def rough(shape: tuple[int, int], cell_mm: float, shown: Display, levels: int = 0) -> RGBD:
    """Random depths, of a few levels if so many of one depth are to meet."""
    random = np.random.default_rng(shape[0] + levels)
    low, high = shown.depth_range_mm
    depth = random.uniform(low, high, shape)
    if levels:
        depth = low + (high - low) * random.integers(0, levels, shape) / levels
    return picture(depth, cell_mm, random.random(shape) < 0.8, random.random((*shape, 3)))


def landings(rgbd: RGBD, shown: Display) -> dict[tuple[int, int], list[tuple]]:
    """In rational numbers, from the text: what lands on each panel pixel, and how far off."""
    g, cell, size = (oracle.stated(v) for v in (shown.gap_mm, rgbd.pixel_mm, shown.pixel_pitch_mm))
    panel = oracle.panel_pixels(shown)
    lenses = (shown.lens_rows, shown.lens_columns)
    found: dict[tuple[int, int], list[tuple]] = {}

    def places(axis: int, index: int, z: Fraction) -> list[tuple[int, Fraction]]:
        x = (Fraction(2 * index + 1 - rgbd.shape[axis], 2)) * cell
        hits = []
        for n in range(lenses[axis]):
            x0 = (n - Fraction(lenses[axis] - 1, 2)) * oracle.stated(shown.pitch_mm)
            at = (x0 + (x0 - x) * g / z) / size + Fraction(panel[axis], 2)
            i = math.floor(at)
            if at == i and at >= Fraction(panel[axis], 2):
                i -= 1
            if oracle.lens_of_pixel(i, panel[axis], lenses[axis], ratio(shown)) == n:
                hits.append((i, at - i - Fraction(1, 2)))
        return [(i, off) for i, off in hits if 0 <= i < panel[axis]]

    for r, c in zip(*np.nonzero(rgbd.covered), strict=True):
        z = Fraction(float(rgbd.depth_mm[r, c]))
        for j, dy in places(0, int(r), z):
            for i, dx in places(1, int(c), z):
                entry = (z, dx * dx + dy * dy, int(r) * rgbd.shape[1] + int(c))
                found.setdefault((j, i), []).append(entry)
    return found


def ratio(shown: Display) -> Fraction:
    pitch = shown.pitch_mm if shown.elemental_pitch_mm is None else shown.elemental_pitch_mm
    return oracle.stated(pitch) / oracle.stated(shown.pixel_pitch_mm)


@pytest.mark.parametrize("mode", [REAL, VIRTUAL], ids=["real", "virtual"])
@pytest.mark.parametrize(
    ("pixel_mm", "elemental"), [(1 / 5, None), (1 / 4, None), (0.0636, None), (1 / 7, 1.013)]
)
@pytest.mark.parametrize("levels", [0, 3])
def test_every_landing_in_its_own_elemental_image_competes_and_the_nearest_wins(
    mode: dict[str, float], pixel_mm: float, elemental: float | None, levels: int
) -> None:
    shown = small_display(4, 3, pixel_pitch_mm=pixel_mm, elemental_pitch_mm=elemental, **mode)
    rgbd = rough((17, 20), 0.2717 if levels == 0 else 0.25, shown, levels)
    expected = landings(rgbd, shown)
    sources = find_sources(rgbd, shown, "li2012")
    rivals = 0
    for at, source in np.ndenumerate(sources):
        entries = expected.get(at, [])
        if not entries:
            assert source < 0
            continue
        z = max(depth for depth, _, _ in entries)
        least = min(off for depth, off, _ in entries if depth == z)
        assert source in {s for depth, off, s in entries if depth == z and off - least < 1e-9}
        rivals += len(entries) > 1
    assert rivals > 0


@pytest.mark.parametrize("z", [12.0, 33.0, -12.0, -33.0])
def test_single_pixel_lands_where_the_closed_form_says(z: float) -> None:
    shown = small_display(12, 10, pixels=9)
    row, column, cell = 11, 21, 0.2371
    sources = find_sources(one_pixel(row, column, z), shown, "li2012")
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


def test_a_real_point_is_inverted_under_its_lens_and_a_virtual_one_is_not() -> None:
    shown = small_display(1, 1, pixels=9)
    for z, to_the_right in ((20.0, False), (-20.0, True)):
        sources = find_sources(one_pixel(15, 25, z), shown, "li2012")
        ((row, column),) = np.argwhere(sources >= 0)
        assert row == 4 and (column > 4) == to_the_right and column != 4


@pytest.mark.parametrize("sign", [1, -1])
def test_nearer_pixel_hides_farther_one(sign: int) -> None:
    # Pixels to either side of the near ones land where these do, and lose.
    shown = small_display(2, 1, pixels=9)
    depth = np.full((1, 41), 20.0 * sign)
    depth[0, 17:20] = 30.0 * sign
    rgbd = picture(depth, 0.1)
    sources = find_sources(rgbd, shown, "li2012")
    for at, entries in landings(rgbd, shown).items():
        depths = {z for z, _, _ in entries}
        assert rgbd.depth_mm.ravel()[sources[at]] == max(depths)
    assert any(len({z for z, _, _ in e}) > 1 for e in landings(rgbd, shown).values())


@pytest.mark.parametrize("lenses", [(4, 3), (3, 4)])
@pytest.mark.parametrize("pixels", [4, 5])
@pytest.mark.parametrize("shape", [(20, 25), (25, 20)])
@pytest.mark.parametrize("levels", [0, 1, 3])
def test_mirrored_picture_gives_the_mirrored_map(
    lenses: tuple[int, int], pixels: int, shape: tuple[int, int], levels: int
) -> None:
    shown = small_display(*lenses, pixels=pixels, **REAL)
    rgbd = rough(shape, 0.2, shown, levels)
    sources = find_sources(rgbd, shown, "li2012")
    index = np.arange(rgbd.depth_mm.size).reshape(shape)
    for axis in (0, 1):
        there = picture(np.flip(rgbd.depth_mm, axis), 0.2, np.flip(rgbd.covered, axis))
        back = np.flip(find_sources(there, shown, "li2012"), axis)
        named = np.where(back >= 0, np.flip(index, axis).ravel()[back], back)
        # A point on the axis has to go one way.
        middle = [(shown.eia_shape[axis] - 1) // 2, shown.eia_shape[axis] // 2]
        assert np.array_equal(np.delete(named, middle, axis), np.delete(sources, middle, axis))


def test_pixel_on_the_axis_lands_to_the_left_and_above() -> None:
    shown = small_display(1, 1, pixels=4)
    sources = find_sources(one_pixel(1, 1, 20.0, (3, 3)), shown, "li2012")
    assert np.argwhere(sources >= 0).tolist() == [[1, 1]]


def test_magnified_picture_leaves_holes_of_the_expected_share() -> None:
    # Images of neighbours are cell g / z = 2 panel pixels apart: one panel pixel in four is met.
    shown = small_display(6, 5, pixels=4)
    rgbd = picture(np.full((30, 30), 33.0), 5.0)
    assert hole_fraction(find_sources(rgbd, shown, "li2012")) == 0.75
    fine = picture(np.full((200, 200), 33.0), 1.0)
    assert hole_fraction(find_sources(fine, shown, "li2012")) == 0


def dome(shown: Display, cell_mm: float, cells: int) -> RGBD:
    """A smooth bump without background."""
    low, high = shown.depth_range_mm
    x = (np.arange(cells) + 0.5 - cells / 2) * cell_mm / 6
    return picture(low + (high - low) * np.exp(-(x**2) - x[:, None] ** 2), cell_mm)


def test_on_a_smooth_surface_most_sources_are_the_exact_ones_or_touch_them() -> None:
    shown = small_display(12, 12, pixels=17, depth_min_mm=30.0, depth_max_mm=36.0)
    # One picture pixel to a panel pixel. With more of them the foremost wins, not the middle one.
    rgbd = dome(shown, shown.scene_pixel_mm, 60)
    sources = find_sources(rgbd, shown, "li2012")
    right = oracle.float_sources(rgbd, shown)
    seen = sources >= 0
    assert 0.7 < seen.mean() < 1
    rows, columns = (abs(a - b)[seen] for a, b in zip(
        np.divmod(sources, 60), np.divmod(right, 60), strict=True))  # fmt: skip
    assert np.mean((rows == 0) & (columns == 0)) > 0.97
    assert np.mean((rows <= 1) & (columns <= 1)) == 1


def test_pixel_on_the_array_is_skipped_and_others_are_not() -> None:
    shown = small_display(4, 4, pixels=9)
    depth = np.full((9, 9), 0.0)
    rgbd = picture(depth, 0.25)
    assert (find_sources(rgbd, shown, "li2012") == HOLE).all()
    assert (generate(rgbd, shown, "li2012:fill=hidden") == 0).all()
    depth[2, 3], depth[4, 5] = -20.0, 20.0
    sources = find_sources(picture(depth, 0.25), shown, "li2012")
    assert set(sources[sources >= 0]) == {2 * 9 + 3, 4 * 9 + 5}


@pytest.mark.parametrize("z", [1e-30, -1e-30, 1e30, 0.01])
def test_extreme_depths_land_somewhere_or_nowhere_without_harm(z: float) -> None:
    shown = small_display(4, 4, pixels=9)
    sources = find_sources(picture(np.full((16, 16), z), 0.3), shown, "li2012")
    assert sources.min() >= HOLE and sources.max() < 256
