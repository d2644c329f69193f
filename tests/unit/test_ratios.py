"""Numbers of lenses, pixels and steps: ratios of lengths, whatever the unit and the rounding.

The same display in other units, or with lengths that are quotients, has the same numbers. Only
rounding differs, by a few ulp.
"""

import math
from fractions import Fraction

import numpy as np
import pytest

from inim.display import DISPLAYS, Display
from inim.display.lens.full import _Sheet
from inim.display.pixels import exact_ratio
from inim.generators import find_sources, gu2020
from inim.generators.base import HOLE
from inim.generators.raycast.phases import cells_per_pitch
from inim.image.files.light_field import view_grid
from inim.image.rgbd import RGBD
from tests import oracle
from tests.conftest import small_display
from tests.generator_cases import OFF_IN_EVERY_WAY

NOMINAL = DISPLAYS["nominal"]
EVERY = {
    **{name: DISPLAYS[name] for name in list(DISPLAYS)},
    "nominal, elemental pitch": NOMINAL.replace(elemental_pitch_mm=1.005),
    "hexagonal": small_display(12, 10, 17, lattice="hexagonal"),
    "hexagonal, off in every way": small_display(12, 10, 17, **OFF_IN_EVERY_WAY),
    "15.7 pixels, moved": small_display(12, 10, 17, pixel_pitch_mm=0.0636, shift_x_mm=-0.2),
    "2.5 pixels": small_display(12, 10, 17, pixel_pitch_mm=0.4, pitch_y_mm=1.4),
    "rows closer, in layers": small_display(12, 10, 17, pitch_y_mm=0.8, layers=((0.5, 1.52),)),
    "stated depths": small_display(12, 10, 17, depth_min_mm=-20.4, depth_max_mm=-13.6),
}
PER_PITCH = (1, 3, 5, 8.5)
RNG = np.random.default_rng(72)


def scaled(display: Display, factor: float) -> Display:
    """The display with all lengths multiplied."""
    lengths = {
        name: value * factor
        for name, value in display.parameters().items()
        if name.endswith("_mm") and value is not None
    }
    layers = tuple((thickness * factor, index) for thickness, index in display.layers)
    return display.replace(**lengths, layers=layers)


def counts(display: Display) -> dict[str, object]:
    """All numbers that follow from ratios of a display's lengths."""
    pictures = [(display.capture_shape(n), display.capture_pixel_mm(n)) for n in PER_PITCH]
    numbers: dict[str, object] = {
        "EIA": display.eia_shape,
        "captures": [shape for shape, _ in pictures],
        "lenses": (display.layout.grid, display.lenses_on_panel),
        "whole": display.has_integer_ratio,
        "cells": [cells_per_pitch(display, pixel) for _, pixel in pictures],
        "facets": _Sheet.of(display).counts,
    }
    if math.isfinite(display.scene_pixel_mm):
        numbers["steps"] = len(gu2020._sampled_depths(display, display.scene_pixel_mm))
    if display.is_separable:
        numbers["views"] = view_grid(display)
    if display.is_separable and display.eia_shape[1] < 300:
        numbers["lens of pixel"] = [axis.lens.tolist() for axis in (display.rows, display.columns)]
    return numbers


@pytest.mark.parametrize("factors", [20, pytest.param(200, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", EVERY)
def test_scaling_all_lengths_of_a_display_changes_no_number(name, factors):
    """Half of the random factors change numbers that depend on rounding."""
    display = EVERY[name]
    expected = counts(display)
    for factor in 10 ** np.random.default_rng(72).uniform(-2, 2, factors):
        scaled_counts = counts(scaled(display, float(factor)))
        differing = [key for key in expected if scaled_counts[key] != expected[key]]
        assert not differing, (factor, differing, [scaled_counts[key] for key in differing])


@pytest.mark.parametrize("pixels", range(2, 21))
def test_a_pixel_of_a_whole_part_of_the_pitch_gives_whole_elemental_images(pixels):
    for pitch in (0.1, 0.3, 0.5, 0.7, 1.0, 1.1, 1.7, 2.3, 0.125, 0.0636, 1.234, 9.9):
        for quotient in (pitch / pixels, pitch * (1 / pixels), 1 / (pixels / pitch)):
            display = small_display(8, 6, 17, pitch_mm=pitch, pixel_pitch_mm=quotient)
            assert display.eia_shape == (6 * pixels, 8 * pixels)
            assert display.has_integer_ratio and display.pixels_per_lens == pixels
            assert display.lenses_on_panel == (6, 8)
            assert view_grid(display) == (pixels, pixels)
            assert oracle.panel_pixels(display) == display.eia_shape


def test_the_panel_of_a_quotient_does_not_move():
    odd = Display(0.3, 3.0, 3.3, 0.3 / 3, 10, 8)
    even = odd.replace(pixel_pitch_mm=0.1)
    assert odd.eia_shape == even.eia_shape == (24, 30)
    for axis in ("rows", "columns"):
        assert np.array_equal(getattr(odd, axis).lens, getattr(even, axis).lens)
        slopes = [getattr(display, axis).slope for display in (odd, even)]
        assert np.allclose(*slopes, rtol=1e-14, atol=0)


def test_a_ratio_is_the_simple_one_within_eight_ulp_and_no_farther():
    for whole in (Fraction(3), Fraction(5, 2), Fraction(1000), Fraction(17, 999)):
        for ulp in range(-7, 8):
            assert exact_ratio(float(whole) * (1 + ulp * 2.0**-52)) == whole
        for ulp in (-20, 20):
            assert exact_ratio(float(whole) * (1 + ulp * 2.0**-52)) != whole
    assert exact_ratio(math.pi) == Fraction(math.pi)


@pytest.mark.parametrize("algorithm", ["template", "layered", "gu2020", "wang2024", "li2012"])
def test_quotients_of_lengths_give_the_sources_of_short_decimals(algorithm):
    even = Display(0.3, 3.0, 3.3, 0.1, 10, 8)
    odd = even.replace(pixel_pitch_mm=0.3 / 3)
    shape, pixel = even.capture_shape(3), even.capture_pixel_mm(3)
    assert odd.capture_shape(3) == shape
    depth = RNG.uniform(*even.depth_range_mm, shape).astype(np.float32)
    picture = RGBD(np.ones((*shape, 3), np.float32), depth, RNG.random(shape) < 0.7, pixel)
    sources = [find_sources(picture, display, algorithm) for display in (even, odd)]
    assert (sources[0] != HOLE).any()
    assert np.array_equal(*sources)
