"""Every layout keeps the promises of its interface: cells, neighbours and extent are those of rays.

`tests/unit/test_real_arrays.py` compares the rays themselves with lists of all lens centres.
"""

from fractions import Fraction
from typing import get_args

import numpy as np
import pytest

from inim.display import DISPLAYS as PRESETS
from inim.display.layouts import LAYOUTS, NUMPY_OPS, Lenticular
from inim.display.lens import lens_array, lens_centre, lens_traits
from inim.display.parameters import Lattice
from inim.display.pixels import CENTRE, PixelOffset, pixel_rays, ray_starts
from inim.generators import prepare
from inim.generators.raycast.ray_by_ray import RayByRay
from inim.image.rgbd import RGBD
from inim.system.errors import DisplayError
from tests.conftest import small_display
from tests.skewed_layout import Skewed

# Cylinders have no rows, and do not end: tests/unit/test_lenticular.py.
OF_LENSES = [name for name in LAYOUTS if name != Lenticular.name]
DISPLAYS = {name: small_display(9, 7, 16, lattice=name) for name in OF_LENSES}


def points_and_centres(name):
    """Points of the array and around it, and the lens centre of each, (n,) complex; if any."""
    display = DISPLAYS[name]
    x, y = np.meshgrid(*(np.linspace(-0.7, 0.7, 1501) * size for size in (
        display.width_mm, display.height_mm
    )))  # fmt: skip
    array, traits = lens_array(display), lens_traits(display)
    centre_x, centre_y, inside = lens_centre(array, traits, NUMPY_OPS, x, y)
    return x + 1j * y, centre_x + 1j * centre_y, inside


def test_each_layout_has_its_name_in_the_display_s_parameter():
    assert set(LAYOUTS) == {*get_args(Lattice), Skewed.name}
    with pytest.raises(
        DisplayError, match="lattice = 'round': use 'square' or 'hexagonal' or 'lenticular'"
    ):
        small_display(lattice="round")


@pytest.mark.parametrize("name", OF_LENSES)
def test_the_array_has_as_many_lenses_as_stated_within_its_size(name):
    display = DISPLAYS[name]
    points, centres, inside = points_and_centres(name)
    rows, columns = display.layout.grid
    assert len(np.unique(np.round(centres[inside], 9))) == rows * columns == 63
    # A point of the array is in its bounding box, except in the tips of pointed cells.
    tips = max(display.layout.cell_height(1.0, display.row_pitch_mm) - display.row_pitch_mm, 0)
    assert np.abs(points.real[inside]).max() <= display.width_mm / 2 + 1e-9
    assert np.abs(points.imag[inside]).max() <= (display.height_mm + tips) / 2 + 1e-9
    assert np.abs(points.real[inside]).max() > display.width_mm / 2 - 0.02


@pytest.mark.parametrize("name", OF_LENSES)
def test_a_cell_is_as_high_and_reaches_as_far_as_stated(name):
    display, (points, centres, inside) = DISPLAYS[name], points_and_centres(name)
    layout, step = display.layout, 0.02
    offset = (points - centres)[inside]
    height = layout.cell_height(display.pitch_mm, display.row_pitch_mm)
    assert height / 2 - step < np.abs(offset.imag).max() <= height / 2 + 1e-9
    reach = layout.reach_squared(lens_array(display), NUMPY_OPS) ** 0.5
    assert reach - step < np.abs(offset).max() <= reach + 1e-9
    assert layout.cell_size_mm == (display.pitch_mm, height)


@pytest.mark.parametrize("name", OF_LENSES)
def test_cells_next_to_a_cell_are_its_neighbours(name):
    display, (_, centres, inside) = DISPLAYS[name], points_and_centres(name)
    steps = set()
    for axis in (0, 1):
        pair = [np.roll(centres, shift, axis) for shift in (0, 1)]
        on_array = inside & np.roll(inside, 1, axis)
        steps |= set(np.round((pair[1] - pair[0])[on_array], 6).tolist())
    listed = [complex(right, up * display.row_pitch_mm) for right, up in display.layout.neighbours]
    assert len(set(listed)) == len(listed)
    for step in steps - {0j}:
        assert min(abs(step - neighbour) for neighbour in listed) < 1e-5, step


#: Displays of every layout, with parameters that move rays away from their pixels' own cells.
MOVED = {
    **{f"{name}, turned": d.replace(rotation_deg=7.0, shift_x_mm=0.3, tilt_x_deg=1.5)
       for name, d in DISPLAYS.items()},
    **{f"{name}, wide cells": d.replace(elemental_pitch_mm=1.2 * d.pitch_mm, rotation_deg=1.0)
       for name, d in DISPLAYS.items()},
    **{f"{name}, narrow cells": d.replace(elemental_pitch_mm=0.8 * d.pitch_mm, rotation_deg=1.0)
       for name, d in DISPLAYS.items()},
    **{name: PRESETS[name].replace(panel_columns=240, panel_rows=160, lens_columns=40)
       for name in ("looking-glass-portrait-typical", "looking-glass-16-typical")},
    "tilted cylinders": PRESETS["looking-glass-go-typical"].replace(
        panel_columns=240, panel_rows=160, lens_columns=40, tilt_y_deg=0.5, shift_y_mm=2.0
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MOVED)
def test_no_ray_moves_farther_from_its_pixel_to_the_array_than_stated(name):
    display = MOVED[name]
    rows = slice(0, display.eia_shape[0])
    centres = pixel_rays(display, rows)
    movements = []
    channel = 0 if display.subpixel_cells else None
    for offset in (CENTRE, PixelOffset(Fraction(-1, 4), Fraction(5, 12), channel)):
        rays, (x, y, *_) = pixel_rays(display, rows, offset), ray_starts(display, rows, offset)
        lensed = centres.lens >= 0
        movements.append([np.abs(rays.x0 - x)[lensed].max(), np.abs(rays.y0 - y)[lensed].max()])
    most, stated = np.max(movements, axis=0), display.layout.farthest_crossings_mm
    assert (most <= stated).all(), (most, stated)
    assert (most + 3 * display.pixel_pitch_mm > 0.5 * np.array(stated)).all(), (most, stated)


@pytest.mark.parametrize("name", MOVED)
def test_rays_that_are_not_traced_would_meet_nothing(name, monkeypatch):
    display = MOVED[name]
    shape, pixel = display.capture_shape(3), display.capture_pixel_mm(3)
    generator = np.random.default_rng(7)
    z_min, z_max = display.depth_range_mm
    covered = np.zeros(shape, bool)
    for row, column in generator.integers(0, shape, (3, 2)):
        covered[row : row + 4, column : column + 3] = True
    depth = generator.uniform(z_min, z_max, shape).astype(np.float32)
    rgbd = RGBD(generator.random((*shape, 3), np.float32), depth, covered, pixel)

    def eia():
        return prepare(display, "template", shape=shape, pixel_mm=pixel).generate(rgbd)

    traced = eia()
    whole = slice(0, display.eia_shape[1])
    monkeypatch.setattr(RayByRay, "_columns_in_reach", lambda *_: lambda _: whole)
    assert traced.any()
    assert np.array_equal(eia(), traced)
