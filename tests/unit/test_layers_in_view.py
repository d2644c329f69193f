"""Surfaces that no ray of a display can meet: leaving them out changes no pixel."""

from dataclasses import replace

import numpy as np
import pytest

from inim.generators import find_sources, generate
from inim.image.rgbd import Layer, LayeredRGBD
from inim.render.culling import layers_in_view
from tests.conftest import small_display

PER_PITCH = 4
DISPLAY = small_display(pixels=17)
LOW, HIGH = DISPLAY.depth_range_mm
ROWS, COLUMNS = DISPLAY.capture_shape(PER_PITCH)
PIXEL_MM = DISPLAY.pitch_mm / PER_PITCH
# Millimetres sideways for each of depth, of the steepest ray.
CONE = DISPLAY.pitch_mm / (2 * DISPLAY.gap_mm)
VIRTUAL = {"focal_length_mm": 3.3, "gap_mm": 3.0}


def at(share):
    """A depth, in shares of the range from far to near."""
    return np.float32(LOW + share * (HIGH - LOW))


def stacked(rgbd):
    layers = rgbd.layers
    fronts = [np.where(layer.covered, layer.front_mm, -np.inf) for layer in layers]
    return np.stack(fronts).astype(np.float32), np.stack([layer.back_mm for layer in layers])


def plate_before_a_wall(half_mm, plate=0.5, wall=0.25):
    """Fronts and backs of a thin square plate of a half width, floating before a wall."""
    y = (np.arange(ROWS) + 0.5 - ROWS / 2) * PIXEL_MM
    x = (np.arange(COLUMNS) + 0.5 - COLUMNS / 2) * PIXEL_MM
    middle = np.maximum(np.abs(y)[:, None], np.abs(x)[None, :]) < half_mm
    front = np.where(middle, [[[at(plate)]], [[at(wall)]]], [[[at(wall)]], [[-np.inf]]])
    back = np.where(middle, [[[at(plate - 0.1)]], [[-np.inf]]], -np.inf)
    return front.astype(np.float32), back.astype(np.float32), x[None, :], y[:, None]


def test_a_wall_behind_a_plate_is_visible_within_the_cone_of_directions():
    half = 3.0
    front, back, x, y = plate_before_a_wall(half)
    in_view = layers_in_view(front, back, DISPLAY, PIXEL_MM)
    assert np.array_equal(in_view[0], np.isfinite(front[0]))
    # Under the plate's edge the steepest ray gets so far in; a panel pixel more by its own width.
    inward = half - np.maximum(np.abs(x), np.abs(y))
    reach = (at(0.4) - at(0.25)) * CONE
    more = (at(0.4) - at(0.25)) * DISPLAY.pixel_pitch_mm / DISPLAY.gap_mm
    behind = np.isfinite(front[1])
    assert in_view[1][behind & (inward < reach - PIXEL_MM)].all()
    hidden = behind & (inward > reach + more + 3 * PIXEL_MM)
    assert hidden.sum() > 50
    assert not in_view[1][hidden].any()


def test_the_inside_of_a_closed_box_is_not_visible():
    """Walls all around: the gap between lid and floor is open nowhere."""
    front, back, *_ = plate_before_a_wall(3.0)
    lid = np.isfinite(front[1])
    ring = np.zeros_like(lid)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            ring |= np.roll(lid, (down, right), (0, 1))
    front[0][ring & ~lid] = at(0.5)
    in_view = layers_in_view(front, back, DISPLAY, PIXEL_MM)
    assert lid.any()
    assert not in_view[1].any()


def plates_before_a_relief(display, seed):
    """Some thick plates, closely before a rough wall: little of what they hide is in view."""
    rows, columns = display.capture_shape(PER_PITCH)
    low, high = display.depth_range_mm
    random = np.random.default_rng(seed)
    plate = np.full((rows, columns), -np.inf)
    for _ in range(6):
        r, c = random.integers(0, rows), random.integers(0, columns)
        here = np.s_[r : r + rows // 3, c : c + columns // 3]
        plate[here] = np.maximum(plate[here], 0.4 + 0.2 * random.random())
    wall = 0.2 + 0.1 * random.random((rows, columns))
    color = random.random((2, rows, columns, 3), dtype=np.float32)
    covered = np.isfinite(plate)
    front = np.where(covered, plate, wall)
    back = np.where(covered, 0.33, -1)
    layers = [(low + (high - low) * share).astype(np.float32) for share in (front, back, wall)]
    behind = Layer(color[1], layers[2], np.full_like(layers[2], low - 1), covered)
    everywhere = np.ones_like(covered)
    return LayeredRGBD(
        color[0], layers[0], everywhere, display.pitch_mm / PER_PITCH, layers[1], (behind,)
    )


@pytest.mark.parametrize("mode", [{}, VIRTUAL], ids=["real", "virtual"])
@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("seed", range(4))
def test_culled_layers_change_no_pixel(mode, samples, seed):
    display = small_display(8, 7, pixels=17, **mode)
    rgbd = plates_before_a_relief(display, seed)
    front, back = stacked(rgbd)
    in_view = layers_in_view(front, back, display, rgbd.pixel_mm)
    (behind,) = rgbd.deeper
    culled = replace(rgbd, deeper=(replace(behind, covered=in_view[1]),))
    assert 0.1 < in_view[1].sum() / behind.covered.sum() < 0.9
    options = {"samples": samples, "colour": "nearest"}
    eias = [generate(layered, display, "layered", **options) for layered in (rgbd, culled)]
    assert np.array_equal(*eias)
    is_deeper = find_sources(rgbd, display, "layered", samples=1) >= rgbd.covered.size
    assert is_deeper.sum() > 50, "or nothing behind is in view anyway"
