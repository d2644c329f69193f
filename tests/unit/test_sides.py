"""Sides: which solids show them, what they are cut into, and their colours."""

from dataclasses import replace

import numpy as np
import pytest

from inim.generators import find_sources, generate
from inim.image.rgbd import Layer, LayeredRGBD
from inim.image.sides import PIECES, Sides
from tests.conftest import small_display, sphere
from tests.unit.test_depth_peeling import PER_PITCH, PIXEL_MM, around, cube

DISPLAY = small_display()
LOW, HIGH = DISPLAY.depth_range_mm
# Depth that the steepest ray takes across a pixel: what a side is taller than.
LEAST_MM = PIXEL_MM / max(DISPLAY.steepest_slopes)
# Of the five faces that a display may see, (r, g, b).
FRONT, LEFT, RIGHT, ABOVE, BELOW = (
    (0.6, 0.6, 0.6), (0.8, 0.1, 0.1), (0.1, 0.8, 0.1), (0.1, 0.1, 0.8), (0.05, 0.1, 0.05)
)  # fmt: skip


def face(centre, half, turn, rgb):
    """A rectangle, turned from facing the viewer."""
    axis, angle = turn
    x, y, z = centre
    return f"""<shape type="rectangle"><transform name="to_world">
        <scale x="{half[0]}" y="{half[1]}"/><rotate {axis}="1" angle="{angle}"/>
        <translate x="{x}" y="{y}" z="{z}"/></transform>
        <bsdf type="twosided"><bsdf type="diffuse">
        <rgb name="reflectance" value="{", ".join(map(str, rgb))}"/></bsdf></bsdf></shape>"""


def box(half_x, half_y, half_z):
    """A box about the origin, each face in a colour of its own."""
    return (
        face((0, 0, half_z), (half_x, half_y), ("y", 0), FRONT),
        face((0, 0, -half_z), (half_x, half_y), ("y", 180), FRONT),
        face((-half_x, 0, 0), (half_z, half_y), ("y", -90), LEFT),
        face((half_x, 0, 0), (half_z, half_y), ("y", 90), RIGHT),
        face((0, half_y, 0), (half_x, half_z), ("x", -90), ABOVE),
        face((0, -half_y, 0), (half_x, half_z), ("x", 90), BELOW),
    )


def captured(open_fitted, *shapes, spp=16, text=around):
    from inim.render.depth_peeling import peel
    from inim.render.ground_truth import capture_layers

    fitted = open_fitted(text(*shapes), DISPLAY)
    layers = peel(fitted, DISPLAY, pixels_per_pitch=PER_PITCH)
    return fitted, layers, capture_layers(fitted, layers, spp=spp, seed=1)


def random_solids(seed, solids=3, rows=9, columns=11):
    """Fronts and backs, (solids, rows, columns) float32, -inf where there is none."""
    random = np.random.default_rng(seed)
    ends = np.sort(random.uniform(LOW, HIGH, (2 * solids, rows, columns)), axis=0)[::-1]
    ends = ends.astype(np.float32)
    front, back = ends[::2].copy(), ends[1::2].copy()
    back[0, ::3] = front[1, ::3]  # some touch
    absent = np.arange(solids)[:, None, None] >= random.integers(0, solids + 1, (rows, columns))
    front[absent], back[absent] = -np.inf, -np.inf
    return front, back


def gaps(front, back, row, column, low, high):
    """Lengths of what a pixel's solids leave open of a span of depths."""
    inside = 0 <= row < front.shape[1] and 0 <= column < front.shape[2]
    ends, lengths = [high], []
    for k in range(len(front) if inside else 0):
        if np.isfinite(front[k, row, column]):
            ends += [front[k, row, column], back[k, row, column]]
    ends = np.clip([*ends, low], low, high)
    for upper, lower in zip(ends[::2], ends[1::2], strict=True):
        lengths.append(upper - lower)
    return lengths


@pytest.mark.parametrize("seed", range(3))
def test_open_sides_are_cut_into_pieces_that_fill_them(seed):
    front, back = random_solids(seed)
    sides = Sides.of(front, back, (LOW, HIGH), DISPLAY.steepest_slopes, PIXEL_MM)
    tall = (HIGH - LOW) / PIECES
    pieces = set()
    for k, r, c in np.argwhere(np.isfinite(front)):
        high, low = front[k, r, c], back[k, r, c]
        beside = [(r, c - 1), (r, c + 1), (r - 1, c), (r + 1, c)]
        tallest = max(max(gaps(front, back, *there, low, high)) for there in beside)
        own = (sides.solid == k) & (sides.row == r) & (sides.column == c)
        assert own.any() == (tallest > LEAST_MM)
        if not own.any():
            continue
        pieces.add(int(own.sum()))
        ends = [*sides.front_mm[own], sides.back_mm[own][-1]]
        assert (np.diff(ends) < 0).all() and ends[-1] == low and ends[0] <= high
        assert np.array_equal(ends[1:-1], sides.back_mm[own][:-1]), "nothing slips between"
        assert np.array_equal(sides.order[own], sides.order[own][0] + np.arange(own.sum()))
        for n in np.flatnonzero(own):
            begin, end = sides.low_mm[n], sides.high_mm[n]
            assert (begin >= sides.back_mm[n]).all() and (end <= sides.front_mm[n]).all()
            assert (begin < end).any()
            if sides.front_mm[n] - sides.back_mm[n] < 1.001 * tall:  # not followed by what is shut
                span = sides.back_mm[n], sides.front_mm[n]
                most = [max(gaps(front, back, *there, *span)) for there in beside]
                assert end - begin == pytest.approx(most, abs=1e-5)
    assert len(pieces) > 2
    assert sides.is_first.sum() == len({*zip(sides.solid, sides.row, sides.column, strict=True)})


@pytest.mark.usefixtures("renderer")
def test_each_side_of_a_box_has_its_colour(open_fitted):
    _, captured_layers, rgbd = captured(open_fitted, *box(4, 3, 3))
    sides, layers = captured_layers.sides, rgbd.layers
    assert len(layers) > 4
    assert np.array_equal(
        layers[0].back_mm[sides.row, sides.column], layers[0].front_mm[sides.row, sides.column]
    )
    light = layers[0].color[layers[0].covered]
    assert np.abs(light / light[:, :1] - 1).max() < 1e-4, "the front is grey"
    low_row, low_column = sides.row.min(), sides.column.min()
    high_row, high_column = sides.row.max(), sides.column.max()
    number = sides.solid + 1 + sides.order
    color = np.stack([layer.color for layer in layers])[number, sides.row, sides.column]
    # Some of the rays that come to a side's upper end meet the front's edge before it.
    below = ~sides.is_first
    inner_row = below & (sides.row > low_row) & (sides.row < high_row)
    inner_column = below & (sides.column > low_column) & (sides.column < high_column)
    for expected, own in (
        (LEFT, (sides.column == low_column) & inner_row),
        (RIGHT, (sides.column == high_column) & inner_row),
        (ABOVE, (sides.row == low_row) & inner_column),
        (BELOW, (sides.row == high_row) & inner_column),
    ):
        assert own.sum() > 100
        shares = color[own] / color[own].sum(axis=1, keepdims=True)
        pure = np.abs(shares - np.array(expected) / sum(expected)).max(axis=1) < 1e-4
        assert pure.mean() > 0.95


@pytest.mark.usefixtures("renderer")
@pytest.mark.parametrize("samples", [1, 4])
def test_sides_move_no_ray(open_fitted, samples):
    """Pieces in the colour of their front: an EIA is that of the solids, bit for bit."""
    _, layers, rgbd = captured(open_fitted, *box(3, 3, 1), sphere((1, 0, 5), 2), spp=1)
    rows, columns = rgbd.shape
    color = np.random.default_rng(1).random((rows, columns, 3), dtype=np.float32)
    there = layers.covered
    assert len(layers.sides.row) > 500 and len(rgbd.layers) > len(there)
    solids = LayeredRGBD(
        color, np.where(there[0], layers.front_mm[0], 0), there[0], rgbd.pixel_mm,
        np.where(there[0], layers.back_mm[0], 0),
        tuple(_layer(color, layers, k) for k in range(1, len(there))),
    )  # fmt: skip
    deeper = tuple(replace(layer, color=color) for layer in rgbd.deeper)
    cut = LayeredRGBD(color, rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm, rgbd.back_mm, deeper)
    options = {"samples": samples, "colour": "nearest"}
    eias = [generate(layered, DISPLAY, "layered", **options) for layered in (solids, cut)]
    assert np.array_equal(*eias)
    behind = find_sources(cut, DISPLAY, "layered", samples=1) >= rows * columns
    assert behind.mean() > 0.005, "or no ray meets a side anyway"


def _layer(color, layers, number):
    own = layers.covered[number]
    front, back = (np.where(own, v[number], 0) for v in (layers.front_mm, layers.back_mm))
    return Layer(color, front, back, own)


@pytest.mark.usefixtures("renderer")
def test_a_relief_has_no_sides(open_fitted):
    """A plate as thin as the steepest ray is deep across a pixel, before a wide one."""
    _, layers, rgbd = captured(
        open_fitted, cube((0, 0, 0), (5, 5, 0.01)), cube((0, 0, 9), (3, 3, 0.01)), spp=1
    )
    assert not len(layers.sides.row)
    assert len(rgbd.layers) == len(layers.front_mm) == 2


@pytest.mark.usefixtures("renderer")
def test_an_eye_that_looks_at_a_side_gets_its_colour(open_fitted):
    """The base of a bust is dark, seen from below, whatever its front is."""
    from inim.render.ground_truth import pickup

    fitted, _, rgbd = captured(open_fitted, *box(3, 4, 4))
    truth = pickup(fitted, DISPLAY, spp=16, seed=2).image
    rendered = generate(rgbd, DISPLAY, "layered", colour="nearest")
    for rgb in (LEFT, RIGHT, ABOVE, BELOW):
        at = [_is_of(rgb, eia) for eia in (truth, rendered)]
        assert at[0].sum() > 100
        assert (at[0] & at[1]).sum() > 0.8 * at[0].sum()


def _is_of(rgb, eia):
    """Mask of light of a single colour, at any intensity."""
    total = eia.sum(axis=-1, keepdims=True)
    shares = np.divide(eia, total, out=np.zeros_like(eia), where=total > 1e-3)
    return np.abs(shares - np.array(rgb) / sum(rgb)).max(axis=-1) < 1e-3
