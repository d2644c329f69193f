"""`template` finds exactly the cell its definition names, ties and all.

Two sets of lengths. `BINARY` ones are binary fractions, so that every position and slope is exact
in float64 and only the definition can decide a tie; `NOMINAL` ones are those of real displays
(1/17 mm pixels), where the same ties exist on paper and rounding must not decide them.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from inim.display import DISPLAYS, Display
from inim.errors import UsageError
from inim.generators import HOLE, NO_LENS, colour_of, find_sources, generate, hole_fraction
from inim.image.rgbd import RGBD
from tests import oracle

BINARY = {
    "pitch_mm": 1.0,
    "focal_length_mm": 1.5,
    "gap_mm": 2.0,
    "pixel_pitch_mm": 0.125,
    "lens_columns": 4,
    "lens_rows": 3,
}
NOMINAL = {**DISPLAYS["nominal"].given(), "lens_columns": 4, "lens_rows": 3}
REAL, VIRTUAL = {"focal_length_mm": 1.5}, {"focal_length_mm": 4.0}
STRADDLING = {"depth_min_mm": -6.0, "depth_max_mm": 8.0}
SOLID = "template:columns=solid"


def display(base: dict[str, Any] = BINARY, **changes: Any) -> Display:
    return Display(**{**base, **changes})


def picture(depth: Any, cell_mm: float, covered: Any = None) -> RGBD:
    """A picture with a colour of its own in every cell."""
    depth = np.asarray(depth, np.float32)
    covered = np.ones(depth.shape, bool) if covered is None else covered
    color = np.arange(1, depth.size * 3 + 1, dtype=np.float32).reshape(*depth.shape, 3)
    return RGBD(color, depth, covered, cell_mm)


def rough(
    shape: tuple[int, int], cell_mm: float, shown: Display, seed: int = 0, covered: float = 0.9
) -> RGBD:
    """Independent depths over the whole range and a little beyond, some cells uncovered."""
    random = np.random.default_rng(seed)
    low, high = shown.depth_range_mm
    margin = (high - low) / 8
    depth = random.uniform(low - margin, high + margin, shape)
    return picture(depth, cell_mm, random.random(shape) < covered)


def only(shape: tuple[int, int], cell: tuple[int, int], depth: float, cell_mm: float) -> RGBD:
    """A picture in which one cell is covered."""
    covered = np.zeros(shape, bool)
    covered[cell] = True
    return picture(np.full(shape, depth), cell_mm, covered)


def assert_exact(rgbd: RGBD, shown: Display) -> None:
    found, right = find_sources(rgbd, shown), oracle.exact_sources(rgbd, shown)
    wrong = np.argwhere(found != right)
    wide = rgbd.shape[1]
    assert len(wrong) == 0, (
        f"{len(wrong)} of {found.size} panel pixels show the wrong cell; the first, "
        f"{tuple(map(int, wrong[0]))}: {divmod(int(found[tuple(wrong[0])]), wide)}, "
        f"by definition {divmod(int(right[tuple(wrong[0])]), wide)}"
    )


def ray_at(shown: Display, z: float) -> tuple[np.ndarray, np.ndarray]:
    """y of every panel row's ray and x of every panel column's at depth z, by Eq. 1."""
    axes = []
    for pixels, lenses, sign in (
        (shown.eia_shape[0], shown.lens_rows, -1),
        (shown.eia_shape[1], shown.lens_columns, 1),
    ):
        x = (np.arange(pixels) + 0.5 - pixels / 2) * shown.pixel_pitch_mm
        lens = np.arange(pixels) * lenses // pixels
        x0 = (lens + 0.5 - lenses / 2) * shown.pitch_mm
        axes.append(sign * (x0 + (x0 - x) * z / shown.gap_mm))
    return axes[0], axes[1]


# -- against the oracle -------------------------------------------------------------------------


@pytest.mark.parametrize("depths", [REAL, VIRTUAL, STRADDLING], ids=["real", "virtual", "both"])
@pytest.mark.parametrize("cell_mm", [0.125, 0.25, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("shape", [(12, 16), (13, 17), (12, 17), (1, 1), (1, 30)])
def test_every_pixel_shows_the_cell_of_the_definition(
    depths: dict[str, float], cell_mm: float, shape: tuple[int, int]
) -> None:
    shown = display(**depths)
    assert_exact(rough(shape, cell_mm, shown), shown)


@pytest.mark.parametrize("pixels", [1, 2, 3, 5, 7, 8, 17])
@pytest.mark.parametrize("lenses", [(1, 1), (3, 4), (4, 3), (5, 5)])
def test_odd_and_even_counts_of_lenses_and_pixels(pixels: int, lenses: tuple[int, int]) -> None:
    shown = display(pitch_mm=pixels / 8, lens_rows=lenses[0], lens_columns=lenses[1], **STRADDLING)
    assert shown.eia_shape == (lenses[0] * pixels, lenses[1] * pixels)
    assert_exact(rough((11, 14), pixels / 32, shown, seed=pixels), shown)


@pytest.mark.parametrize("gap", [{}, {"gap_mm": 2.7}, STRADDLING], ids=["real", "virtual", "both"])
@pytest.mark.parametrize("cells", [0.7, 1, 2, 3, 4, 5])
@pytest.mark.parametrize("shape", [(26, 32), (27, 33)])
def test_nominal_display_where_rays_meet_corners_on_paper_but_not_in_floats(
    gap: dict[str, float], cells: int, shape: tuple[int, int]
) -> None:
    shown = display(NOMINAL, **gap)
    assert_exact(rough(shape, 1 / cells, shown), shown)


@pytest.mark.parametrize("cells", [3, 4])
@pytest.mark.parametrize("lenses", [(6, 5), (5, 6)])
def test_pixels_that_do_not_divide_the_pitch(cells: int, lenses: tuple[int, int]) -> None:
    shown = display(NOMINAL, pixel_pitch_mm=0.0636, lens_rows=lenses[0], lens_columns=lenses[1])
    assert not shown.has_integer_ratio
    assert_exact(rough((35, 38), 1 / cells, shown), shown)


def test_wide_array_far_from_the_axis() -> None:
    shown = DISPLAYS["phone"].replace(lens_rows=1, panel_rows=16)
    assert_exact(rough((30, 640), 0.25, shown), shown)


def test_panel_larger_and_smaller_than_the_array() -> None:
    shown = display(panel_columns=39, panel_rows=21)
    found = find_sources(rough((12, 16), 0.25, shown), shown)
    # 39 columns over 4 x 8: three and a half too many on each side, the middle one on the axis.
    outside = np.zeros(39, bool)
    outside[:3] = outside[-3:] = True
    assert np.array_equal((found == NO_LENS).all(axis=0), outside)
    assert np.array_equal(found == NO_LENS, np.broadcast_to(outside, found.shape))
    assert_exact(rough((12, 16), 0.25, shown), shown)


def test_elemental_pitch_of_its_own() -> None:
    shown = display(elemental_pitch_mm=1.0625, **STRADDLING)
    assert_exact(rough((14, 18), 0.25, shown), shown)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    pixels=st.integers(1, 9),
    lenses=st.tuples(st.integers(1, 4), st.integers(1, 4)),
    shape=st.tuples(st.integers(1, 20), st.integers(1, 20)),
    cell_mm=st.sampled_from([0.125, 0.25, 0.375, 0.5, 0.75, 1.0]),
    depths=st.sampled_from([REAL, VIRTUAL, STRADDLING]),
    levels=st.integers(1, 40),
    covered=st.floats(0, 1),
    seed=st.integers(0, 2**32 - 1),
)
def test_stepped_depths_whose_steps_meet_cell_borders(
    pixels: int,
    lenses: tuple[int, int],
    shape: tuple[int, int],
    cell_mm: float,
    depths: dict[str, float],
    levels: int,
    covered: float,
    seed: int,
) -> None:
    shown = display(
        pitch_mm=pixels / 8, lens_rows=lenses[0], lens_columns=lenses[1], **(depths | STRADDLING)
    )
    random = np.random.default_rng(seed)
    depth = random.integers(-levels, levels + 1, shape) / 4
    assert_exact(picture(depth, cell_mm, random.random(shape) < covered), shown)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    pitch=st.floats(0.3, 3),
    ratio=st.floats(1, 20),
    cells=st.floats(0.7, 6),
    gap=st.floats(1, 9),
    focus=st.sampled_from([0.7, 0.9, 1.05, 1.4]),
    shape=st.tuples(st.integers(1, 30), st.integers(1, 30)),
    seed=st.integers(0, 2**32 - 1),
)
def test_any_lengths_agree_with_float64_wherever_float64_can_tell(
    pitch: float,
    ratio: float,
    cells: float,
    gap: float,
    focus: float,
    shape: tuple[int, int],
    seed: int,
) -> None:
    shown = display(
        pitch_mm=pitch,
        pixel_pitch_mm=pitch / ratio,
        gap_mm=gap,
        focal_length_mm=gap * focus,
        lens_rows=2,
        lens_columns=3,
    )
    rgbd = rough(shape, pitch / cells, shown, seed)
    clear = ~oracle.doubtful(rgbd, shown)
    found, right = find_sources(rgbd, shown), oracle.float_sources(rgbd, shown)
    assert np.array_equal(found[clear], right[clear])


def test_the_two_oracles_agree() -> None:
    shown = display(NOMINAL, gap_mm=2.7, pixel_pitch_mm=0.0636)
    rgbd = rough((30, 31), 0.2357, shown)
    clear = ~oracle.doubtful(rgbd, shown)
    assert clear.mean() > 0.99
    exact, rounded = oracle.exact_sources(rgbd, shown), oracle.float_sources(rgbd, shown)
    assert np.array_equal(exact[clear], rounded[clear])


def spikes(shape: tuple[int, int]) -> np.ndarray:
    depth = np.full(shape, -6.0)
    depth[2::5, 3::4] = 8.0
    return depth


def slits(shape: tuple[int, int]) -> np.ndarray:
    depth = np.full(shape, 7.0)
    depth[:, 1::3] = -5.0
    return depth


def checkerboard(shape: tuple[int, int]) -> np.ndarray:
    return np.where(np.indices(shape).sum(axis=0) % 2, 8.0, -6.0)


def stairs(shape: tuple[int, int]) -> np.ndarray:
    return np.broadcast_to(np.linspace(-6, 8, shape[1]), shape)


@pytest.mark.parametrize("make", [spikes, slits, checkerboard, stairs])
@pytest.mark.parametrize("base", [BINARY, NOMINAL], ids=["binary", "nominal"])
@pytest.mark.parametrize("holes", [False, True], ids=["covered", "with holes"])
def test_hard_pictures(make: Any, base: dict[str, Any], holes: bool) -> None:
    shown = display(base, **STRADDLING)
    depth = make((20, 24))
    covered = np.random.default_rng(7).random(depth.shape) < (0.6 if holes else 2)
    assert_exact(picture(depth, 0.25, covered), shown)


# -- ties ---------------------------------------------------------------------------------------


def test_surface_exactly_at_the_leaving_depth_is_seen_one_ulp_below_it_is_not() -> None:
    # Panel column 3 is 1/16 mm left of the only lens: X(z) = z / 32 mm, one cell per 8 mm.
    # The ray leaves column 9 of 16, [1/4, 1/2] mm, at z = 8. Panel row 3 likewise, downwards.
    shown = display(lens_rows=1, lens_columns=1, depth_min_mm=-20.0, depth_max_mm=20.0)
    at = np.float32(8.0)
    for depth, seen in (
        (at, True),
        (np.nextafter(at, np.float32(99)), True),
        (np.nextafter(at, np.float32(-99)), False),
    ):
        found = find_sources(only((16, 16), (9, 9), depth, 0.25), shown)
        assert found[3, 3] == (9 * 16 + 9 if seen else HOLE), depth


@pytest.mark.parametrize("base", [BINARY, NOMINAL], ids=["binary", "nominal"])
def test_leaving_depths_split_the_float32_depths_next_to_them(base: dict[str, Any]) -> None:
    shown = display(base, lens_rows=1, lens_columns=1, depth_min_mm=-20.0, depth_max_mm=20.0)
    shape, cell_mm = (9, 11), 0.25
    pixels = shown.eia_shape[0]
    by_row, by_column = (oracle.rays(shown, pixels, 1, cells, cell_mm) for cells in shape)
    low, high = oracle.depth_range(shown)
    exact_ties = 0
    for i, j in [(1, 2), (pixels - 1, 5), (3, 3)]:
        rows = oracle.runs(by_row.start[i], by_row.slope[i], low, high)
        columns = oracle.runs(by_column.start[j], by_column.slope[j], low, high)
        for end in sorted({z for z, _ in rows + columns}):
            row = next(cell for z, cell in rows if z <= end)
            column = next(cell for z, cell in columns if z <= end)
            if not (0 <= row < shape[0] and 0 <= column < shape[1]):
                continue
            near = np.float32(float(end))
            for depth in (near, np.nextafter(near, np.float32(99)), np.nextafter(near, -near)):
                exact_ties += Fraction(float(depth)) == end
                found = find_sources(only(shape, (row, column), depth, cell_mm), shown)
                seen = Fraction(float(depth)) >= end
                assert found[i, j] == (row * shape[1] + column if seen else HOLE)
    assert exact_ties >= 4


def test_ray_along_a_border_belongs_to_the_larger_row_and_column() -> None:
    # Odd pixels: the middle one is under the lens centre and looks straight ahead, along the
    # corner of four cells where the picture is even.
    shown = display(pitch_mm=0.875, lens_rows=1, lens_columns=1)
    found = find_sources(picture(np.full((8, 10), 6.0), 0.25), shown)
    assert found[3, 3] == 4 * 10 + 5
    # The larger cell alone: a hole if it is not covered, whatever the others hold.
    covered = np.ones((8, 10), bool)
    covered[4, 5] = False
    assert find_sources(picture(np.full((8, 10), 6.0), 0.25, covered), shown)[3, 3] == HOLE


@pytest.mark.parametrize("base", [BINARY, NOMINAL], ids=["binary", "nominal"])
def test_ray_through_corners_never_shows_the_cells_beside_them(base: dict[str, Any]) -> None:
    # Equal offsets in x and y: the rays run along diagonals of cells, corner to corner.
    shown = display(base, lens_rows=4, lens_columns=4, **STRADDLING)
    pixels = round(shown.pixels_per_lens)
    shape = (24, 24)
    row, column = np.indices(shape)
    # Lens centres lie on corners 2, 6, 10 ... from the axis: their diagonals keep to one colour.
    same = (row - column) % 4 == 0
    found = find_sources(picture(np.full(shape, 9.0), 0.25, ~same), shown)
    elemental = found.reshape(4, pixels, 4, pixels)
    for v in range(pixels):
        if 2 * v + 1 != pixels:
            assert (elemental[:, v, :, v] == HOLE).all()


@pytest.mark.parametrize("panel_column", [3, 4])
def test_border_met_exactly_at_either_end_of_the_ray_adds_no_cell(panel_column: int) -> None:
    # Slopes of 1/8 cell per mm: from z_max = 16 to z_min = -16 the ray passes columns 6 to 9, up
    # or down, and meets the border of one more at each end. Rows alike.
    shown = display(lens_rows=1, lens_columns=1, depth_min_mm=-16.0, depth_max_mm=16.0)
    for cell in range(16):
        covered = np.zeros((16, 16), bool)
        covered[:, cell] = True
        rgbd = picture(np.full((16, 16), 16.0), 0.25, covered)
        turned = picture(np.full((16, 16), 16.0), 0.25, covered.T)
        passed = 6 <= cell <= 9
        assert (find_sources(rgbd, shown, SOLID)[3, panel_column] != HOLE) == passed, cell
        assert (find_sources(turned, shown, SOLID)[panel_column, 3] != HOLE) == passed, cell


def test_depth_equal_to_the_far_end_is_seen_below_it_is_not() -> None:
    shown = display(depth_min_mm=4.0, depth_max_mm=8.0)
    far = np.float32(4.0)
    assert hole_fraction(find_sources(picture(np.full((40, 48), far), 0.25), shown)) == 0
    below = np.nextafter(far, np.float32(-9))
    assert hole_fraction(find_sources(picture(np.full((40, 48), below), 0.25), shown)) == 1


# -- closed forms -------------------------------------------------------------------------------


@pytest.mark.parametrize("depth", [6.0, 5.0, -4.0, -7.25])
@pytest.mark.parametrize("base", [BINARY, NOMINAL], ids=["binary", "nominal"])
def test_flat_surface_shows_the_cell_at_its_depth(depth: float, base: dict[str, Any]) -> None:
    shown = display(base, depth_min_mm=-8.0, depth_max_mm=8.0)
    high, wide, cell = 60, 66, 0.1873
    found = find_sources(picture(np.full((high, wide), depth), cell), shown)
    y, x = ray_at(shown, depth)
    row = np.floor(high / 2 - y / cell).astype(int)
    column = np.floor(wide / 2 + x / cell).astype(int)
    assert row.min() >= 0 and row.max() < high and column.min() >= 0 and column.max() < wide
    assert np.array_equal(found, row[:, None] * wide + column)


def test_flat_surface_at_the_central_depth_plane_of_the_nominal_display() -> None:
    shown = display(NOMINAL)
    depth = shown.central_depth_mm
    cell = 0.2273
    found = find_sources(picture(np.full((70, 75), depth), cell), shown)
    y, x = ray_at(shown, float(np.float32(depth)))
    row, column = np.floor(35 - y / cell).astype(int), np.floor(37.5 + x / cell).astype(int)
    assert np.array_equal(found, row[:, None] * 75 + column)


@pytest.mark.parametrize("z", [4.0, 8.0, -4.0, -8.0])
def test_single_cell_appears_where_similar_triangles_put_it(z: float) -> None:
    # A thin slice of depth about z, so that the cell's walls show nothing.
    thin = 2.0**-12
    shown = display(depth_min_mm=z - thin, depth_max_mm=z + thin)
    cell, (row, column), (high, wide) = 0.5, (3, 9), (10, 14)
    x, y = (column + 0.5 - wide / 2) * cell, (high / 2 - row - 0.5) * cell
    found = find_sources(only((high, wide), (row, column), z - thin, cell), shown)
    expected = np.full((24, 32), HOLE)
    reach = cell / 2 * 2.0 / abs(z)  # half the size of the cell's image on the panel
    for m in range(3):
        for n in range(4):
            x0, y0 = n - 1.5, 1 - m
            image_x = (x0 - x) * 2.0 / z  # from the lens centre; x0 + (x0 - X) g / z
            image_y = (y0 - y) * 2.0 / z
            for v in range(8):
                for u in range(8):
                    dx, dy = (u - 3.5) / 8, (3.5 - v) / 8
                    if abs(dx - image_x) < reach and abs(dy - image_y) < reach:
                        expected[m * 8 + v, n * 8 + u] = row * wide + column
    assert 0 < (expected >= 0).sum() < expected.size
    assert np.array_equal(found, expected)


@pytest.mark.parametrize(("z", "way"), [(8.0, 1), (-8.0, -1)])
def test_image_of_a_near_point_moves_with_the_lens_that_of_a_far_point_against_it(
    z: float, way: int
) -> None:
    shown = display(lens_rows=1, depth_min_mm=z - 2**-12, depth_max_mm=z + 2**-12)
    found = find_sources(only((5, 13), (2, 6), z - 2**-12, 1.0), shown)
    centres = [np.nonzero(found[3, n * 8 : n * 8 + 8] >= 0)[0].mean() for n in range(4)]
    # One pitch of lens moves it by g / z of a pitch, two pixels here.
    assert np.allclose(np.diff(centres), way * 2.0)


def test_first_row_of_the_picture_is_the_upper_one() -> None:
    # In front of the array the image in each elemental image is turned, the lenses are not:
    # the top lens row of a far flat surface shows the top rows.
    shown = display(depth_min_mm=-0.01, depth_max_mm=0.01)
    found = find_sources(picture(np.zeros((3, 4)), 1.0), shown)
    lens = np.arange(12).reshape(3, 4)
    assert np.array_equal(found, np.kron(lens, np.ones((8, 8), int)))


@pytest.mark.parametrize("base", [BINARY, NOMINAL], ids=["binary", "nominal"])
@pytest.mark.parametrize(("near", "far"), [(7.0, 3.0), (2.0, -3.0), (-2.0, -6.0)])
def test_nearer_square_hides_farther_one(base: dict[str, Any], near: float, far: float) -> None:
    shown = display(base, depth_min_mm=-8.0, depth_max_mm=8.0)
    high, wide, cell = 30, 34, 0.2173
    depth = np.full((high, wide), far)
    square = (slice(11, 18), slice(13, 24))
    depth[square] = near
    covered = np.zeros((high, wide), bool)
    covered[8:25, 4:22] = True
    covered[square] = True
    found = find_sources(picture(depth, cell, covered), shown)
    shows_near = (found >= 0) & (depth.ravel()[np.maximum(found, 0)] == near)

    def in_square(z: float) -> np.ndarray:
        y, x = ray_at(shown, z)
        row, column = high / 2 - y / cell, wide / 2 + x / cell
        return ((row > 11) & (row < 18))[:, None] & ((column > 13) & (column < 24))

    assert in_square(near).any()
    assert shows_near[in_square(near)].all()
    # Nowhere else, but for the square's walls between the two depths.
    at_all = np.any([in_square(z) for z in np.linspace(near, -8.0, 2000)], axis=0)
    assert not shows_near[~at_all].any()
    y, x = ray_at(shown, far)
    row, column = high / 2 - y / cell, wide / 2 + x / cell
    far_square = ((row > 8) & (row < 25))[:, None] & ((column > 4) & (column < 22))
    clear = far_square & ~np.any([in_square(z) for z in np.linspace(near, far, 500)], axis=0)
    assert clear.any()
    assert (depth.ravel()[found[clear]] == far).all()
    assert (found[clear] >= 0).all()


def test_nothing_covered_is_all_holes() -> None:
    shown = display()
    found = find_sources(picture(np.full((9, 9), 6.0), 0.5, np.zeros((9, 9), bool)), shown)
    assert (found == HOLE).all()
    assert hole_fraction(found) == 1


def test_depths_of_uncovered_cells_mean_nothing() -> None:
    shown = display()
    covered = np.random.default_rng(3).random((16, 20)) < 0.7
    depth = np.random.default_rng(4).uniform(*shown.depth_range_mm, covered.shape)
    right = find_sources(picture(depth, 0.25, covered), shown)
    for filler in (np.nan, np.inf, -np.inf, 3e38, 6.0):
        other = picture(np.where(covered, depth, filler), 0.25, covered)
        assert np.array_equal(find_sources(other, shown), right), filler


def test_surfaces_nearer_than_the_range_show_the_cell_where_the_ray_starts() -> None:
    shown = display(**STRADDLING)
    cell, (high, wide) = 0.1873, (60, 66)
    found = find_sources(picture(np.full((high, wide), 1e6), cell), shown)
    y, x = ray_at(shown, 8.0)
    row, column = np.floor(high / 2 - y / cell), np.floor(wide / 2 + x / cell)
    assert np.array_equal(found, row[:, None] * wide + column)


# -- relations ----------------------------------------------------------------------------------

# Three cells to the pitch and an odd picture: lens centres lie in the middle of cells.
SYMMETRIC = {
    "pitch_mm": 0.75,
    "pixel_pitch_mm": 0.09375,
    "lens_columns": 3,
    "lens_rows": 5,
}


@pytest.mark.parametrize("depths", [REAL, VIRTUAL, STRADDLING], ids=["real", "virtual", "both"])
@pytest.mark.parametrize("axis", [0, 1], ids=["up-down", "left-right"])
@pytest.mark.parametrize("pixels", [7, 8])
def test_mirrored_picture_gives_the_mirrored_eia(
    depths: dict[str, float], axis: int, pixels: int
) -> None:
    shown = display(**{**SYMMETRIC, "pixel_pitch_mm": 0.75 / pixels, **depths})
    rgbd = rough((21, 17), 0.25, shown)
    mirrored = RGBD(
        np.flip(rgbd.color, axis), np.flip(rgbd.depth_mm, axis), np.flip(rgbd.covered, axis), 0.25
    )
    assert np.array_equal(generate(mirrored, shown), np.flip(generate(rgbd, shown), axis))


def test_rays_along_borders_are_what_breaks_the_mirror() -> None:
    # Odd pixels and lens centres on borders: the straight ray of each lens keeps to the right.
    shown = display(pitch_mm=0.875, lens_rows=1, lens_columns=2)
    depth = np.random.default_rng(5).uniform(*shown.depth_range_mm, (9, 14))
    rgbd, mirrored = picture(depth, 0.4375), picture(depth[:, ::-1], 0.4375)
    found, other = find_sources(rgbd, shown) % 14, find_sources(mirrored, shown) % 14
    straight = [3, 10]
    slanted = [c for c in range(14) if c not in straight]
    assert np.array_equal(found[:, slanted], 13 - other[:, ::-1][:, slanted])
    # Centres at -0.4375 and 0.4375 mm, on borders 6 and 8: columns 6 and 8 in either picture.
    for columns in (found, other):
        assert [set(columns[:, c]) for c in straight] == [{6}, {8}]


@pytest.mark.parametrize("base", [BINARY, NOMINAL], ids=["binary", "nominal"])
@pytest.mark.parametrize("cells", [2, 3, 4])
def test_transposed_picture_gives_the_transposed_eia(base: dict[str, Any], cells: int) -> None:
    shown = display(base, lens_rows=3, lens_columns=4)
    turned = display(base, lens_rows=4, lens_columns=3)
    rgbd = rough((22, 27), 1 / cells, shown)
    flipped = RGBD(rgbd.color.transpose(1, 0, 2), rgbd.depth_mm.T, rgbd.covered.T, rgbd.pixel_mm)
    expected = generate(rgbd, shown).transpose(1, 0, 2)
    assert np.array_equal(generate(flipped, turned), expected)


@pytest.mark.parametrize("base", [BINARY, NOMINAL], ids=["binary", "nominal"])
@pytest.mark.parametrize("cells", [2, 3, 4])
@pytest.mark.parametrize("axis", [0, 1], ids=["down", "right"])
def test_picture_moved_by_a_pitch_moves_the_eia_by_a_lens(
    base: dict[str, Any], cells: int, axis: int
) -> None:
    shown = display(base, lens_rows=5, lens_columns=6)
    pixels = round(shown.pixels_per_lens)
    rgbd = rough((40, 44), 1 / cells, shown)
    # Nothing covered in what is moved out of the picture, so that nothing is lost.
    covered = rgbd.covered.copy()
    np.moveaxis(covered, axis, 0)[-cells:] = False
    still = picture(rgbd.depth_mm, 1 / cells, covered)
    moved = RGBD(
        *(np.roll(a, cells, axis) for a in (still.color, still.depth_mm, still.covered)), 1 / cells
    )
    before = np.moveaxis(generate(still, shown), axis, 0)[:-pixels]
    after = np.moveaxis(generate(moved, shown), axis, 0)[pixels:]
    assert before.any()
    assert np.array_equal(after, before)


@pytest.mark.parametrize("power", [-20, -3, 1, 10, 30])
@pytest.mark.parametrize("base", [BINARY, NOMINAL], ids=["binary", "nominal"])
def test_scaling_every_length_by_a_power_of_two_changes_no_pixel(
    power: int, base: dict[str, Any]
) -> None:
    scale = 2.0**power
    shown = display(base)
    scaled = shown.replace(
        **{k: v * scale for k, v in shown.given().items() if k.endswith("_mm") and v is not None}
    )
    rgbd = rough((23, 26), 0.25, shown)
    larger = picture(rgbd.depth_mm * np.float32(scale), 0.25 * scale, rgbd.covered)
    assert np.array_equal(find_sources(larger, scaled), find_sources(rgbd, shown))


@settings(max_examples=25, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.01, 0.5))
def test_what_comes_nearer_changes_only_the_pixels_that_then_show_it(
    seed: int, share: float
) -> None:
    shown = display(NOMINAL, **STRADDLING)
    random = np.random.default_rng(seed)
    before = rough((18, 22), 0.25, shown, seed)
    raised = random.random(before.shape) < share
    depth = np.where(raised, before.depth_mm + random.uniform(0, 5), before.depth_mm)
    after = picture(depth, 0.25, before.covered | raised)
    old, new = find_sources(before, shown, SOLID), find_sources(after, shown, SOLID)
    shows_raised = (new >= 0) & raised.ravel()[np.maximum(new, 0)]
    assume(shows_raised.any())  # where rays reach
    assert ((old == new) | shows_raised).all()


def test_widening_the_range_in_front_of_everything_changes_nothing() -> None:
    shown = display(**STRADDLING)
    rgbd = rough((40, 48), 0.25, shown, covered=1)
    depth = np.minimum(rgbd.depth_mm, 7.9)
    deeper = shown.replace(depth_max_mm=64.0)
    inner = find_sources(picture(depth, 0.25), shown)
    assert np.array_equal(find_sources(picture(depth, 0.25), deeper), inner)


# -- the interface ------------------------------------------------------------------------------


def test_source_map_is_int32_of_the_panel_and_the_same_every_time() -> None:
    shown = display(NOMINAL)
    rgbd = rough((20, 24), 0.25, shown)
    found = find_sources(rgbd, shown)
    assert found.dtype == np.int32
    assert found.shape == shown.eia_shape
    assert found.min() >= NO_LENS and found.max() < 20 * 24
    assert all(np.array_equal(find_sources(rgbd, shown), found) for _ in range(3))


def test_colours_are_copied_and_nothing_is_black() -> None:
    shown = display(panel_columns=40, panel_rows=24)
    rgbd = rough((12, 16), 0.25, shown, covered=0.3)
    found, eia = find_sources(rgbd, shown), generate(rgbd, shown)
    assert {HOLE, NO_LENS} < set(np.unique(found))
    assert eia.dtype == np.float32 and eia.shape == (24, 40, 3)
    assert (eia[found < 0] == 0).all()
    assert np.array_equal(eia[found >= 0], rgbd.color.reshape(-1, 3)[found[found >= 0]])
    assert np.array_equal(eia, colour_of(found, rgbd))


def test_hole_fraction_counts_lensed_pixels_only() -> None:
    sources = np.array([[NO_LENS, NO_LENS, HOLE, 5], [NO_LENS, NO_LENS, 0, 1]], np.int32)
    assert hole_fraction(sources) == 0.25
    assert hole_fraction(np.full((2, 2), NO_LENS, np.int32)) == 0


def test_unknown_algorithm_is_refused_with_its_name_and_the_known_ones() -> None:
    shown = display()
    for name, words in (("li2013", "did you mean li2012?"), ("x", "use template or .* wang2024")):
        with pytest.raises(UsageError, match=rf"'{name}': {words}"):
            find_sources(rough((4, 4), 1.0, shown), shown, name)
