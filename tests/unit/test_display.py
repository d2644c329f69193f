"""A display is what its lengths say, and refuses lengths that say nothing."""

import math
import re
from dataclasses import fields
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inim.display import DISPLAYS, Display, Viewpoint
from inim.display.pixels import pixel_rays
from inim.generators.accuracy_limits import accuracy_warnings
from inim.report.diagram import plan_view
from inim.scores.document_parts import EyePosition
from inim.system.errors import DisplayError
from tests import oracle

NOMINAL = DISPLAYS["nominal"]
PHONE = DISPLAYS["phone"]


def display(**changes: Any) -> Display:
    return NOMINAL.replace(**changes)


# -- formulas -----------------------------------------------------------------------------------


def test_nominal_display_by_hand():
    # D = 3 * 3.3 / 0.3; P_I = 33 / 17 / 3.3; span = 2 * 33 * P_I / 1.
    assert NOMINAL.central_depth_mm == pytest.approx(33, rel=1e-12)
    assert NOMINAL.scene_pixel_mm == pytest.approx(10 / 17, rel=1e-12)
    assert NOMINAL.scene_pixel_mm == pytest.approx(0.58824, abs=5e-6)
    assert NOMINAL.depth_span_mm == pytest.approx(660 / 17, rel=1e-12)
    assert NOMINAL.depth_span_mm == pytest.approx(38.82, abs=5e-3)
    assert NOMINAL.depth_range_mm == pytest.approx((33 - 330 / 17, 33 + 330 / 17), rel=1e-12)
    assert not NOMINAL.depth_range_is_cut
    assert NOMINAL.viewing_half_angle_deg == pytest.approx(math.degrees(math.atan(1 / 6.6)))
    assert (NOMINAL.width_mm, NOMINAL.height_mm) == (64, 64)
    assert NOMINAL.pixels_per_lens == pytest.approx(17)
    assert NOMINAL.has_integer_ratio
    assert NOMINAL.eia_shape == (1088, 1088)


def test_gap_below_the_focal_length_shows_virtual_images_behind_the_array():
    virtual = display(gap_mm=2.7)
    assert virtual.central_depth_mm == pytest.approx(-27, rel=1e-12)
    assert virtual.scene_pixel_mm == pytest.approx(10 / 17, rel=1e-12)
    assert virtual.depth_span_mm == pytest.approx(540 / 17, rel=1e-12)
    low, high = virtual.depth_range_mm
    assert low < -27 < high < 0
    assert (low + high) / 2 == pytest.approx(-27)


def test_focused_display_needs_a_depth_range():
    with pytest.raises(DisplayError, match=r"gap_mm = focal_length_mm = 3\.0.*depth_min_mm"):
        display(gap_mm=3.0)
    focused = display(gap_mm=3.0, depth_min_mm=-5, depth_max_mm=20)
    assert math.isinf(focused.central_depth_mm) and math.isinf(focused.depth_span_mm)
    assert focused.depth_range_mm == (-5.0, 20.0)
    assert focused.derived_quantities()["central_depth_mm"] is None
    assert focused.derived_quantities()["depth_span_mm"] is None


def test_a_gap_that_differs_by_rounding_is_the_focal_length():
    with pytest.raises(DisplayError, match="focused display has no depth range"):
        display(gap_mm=3.0 * (1 + 2.0**-52))


@pytest.mark.parametrize(("gap", "side"), [(3.3, 1), (2.7, -1)])
@pytest.mark.parametrize("pixels", [2, 4, 7, 9, 10, 13])
def test_a_range_across_the_array_is_cut_in_front_of_it_and_marked(gap, side, pixels):
    # Half the span is 10 / pixels of |D|, for either gap: 10 pixels and fewer reach the array.
    device = display(gap_mm=gap, pixel_pitch_mm=1 / pixels)
    centre, half = device.central_depth_mm, device.depth_span_mm / 2
    low, high = device.depth_range_mm
    assert low < centre < high
    assert low * side > 0 and high * side > 0
    as_formula = (low, high) == pytest.approx((centre - half, centre + half), rel=1e-12)
    assert device.depth_range_is_cut == (not as_formula)
    assert (half >= abs(centre)) <= device.depth_range_is_cut


# -- refusals -----------------------------------------------------------------------------------

LENGTHS = ["pitch_mm", "focal_length_mm", "gap_mm", "pixel_pitch_mm"]


@pytest.mark.parametrize("name", [*LENGTHS, "pitch_y_mm", "shift_x_mm", "depth_max_mm"])
@pytest.mark.parametrize("value", [1e39, 1e200, -1e300])
def test_length_beyond_float32_is_refused_before_an_overflow(name, value):
    if value < 0 and name in [*LENGTHS, "pitch_y_mm"]:
        value = -value
    with pytest.raises(DisplayError, match=re.escape(f"{name} = {value:g}: at most 1e+38 mm")):
        display(**{"depth_min_mm": -1.0, "depth_max_mm": 1.0, name: value})


@pytest.mark.parametrize("name", [*LENGTHS, "elemental_pitch_mm", "lens_thickness_mm"])
@pytest.mark.parametrize("value", [0, -1.5, math.nan, math.inf, True, "1"])
def test_an_invalid_length_is_refused_by_name_and_value(name, value):
    reason = "must be a (positive length|finite number)"
    expected = rf"^{name} = '?{re.escape(str(value))}(\.0)?'?: {reason}$"
    with pytest.raises(DisplayError, match=expected):
        display(**{name: value})


@pytest.mark.parametrize("name", ["lens_columns", "lens_rows", "panel_columns", "panel_rows"])
@pytest.mark.parametrize("value", [0, -3, 2.5, 2.0, True, "4"])
def test_an_invalid_count_is_refused_by_name_and_value(name, value):
    with pytest.raises(DisplayError, match=rf"^{name} = {value!r}: must be a whole number"):
        display(**{name: value})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pixel_pitch_mm": 1.5}, r"pixel_pitch_mm = 1\.5 exceeds pitch_mm = 1\.0"),
        ({"refractive_index": 1.0}, r"refractive_index = 1\.0: a lens needs an index above 1"),
        ({"refractive_index": math.nan}, r"refractive_index = nan"),
        ({"curved_side": "left"}, r"curved_side = 'left': use 'viewer' or 'panel'"),
        ({"depth_min_mm": 1.0}, r"depth_min_mm = 1\.0, depth_max_mm = None: give both or"),
        ({"depth_max_mm": 1.0}, r"depth_min_mm = None, depth_max_mm = 1\.0: give both or"),
        ({"depth_min_mm": 5.0, "depth_max_mm": 5.0}, r"\[5, 5\] mm is empty"),
        ({"depth_min_mm": 6.0, "depth_max_mm": 5.0}, r"\[6, 5\] mm is empty"),
        ({"depth_min_mm": math.nan, "depth_max_mm": 5.0}, r"depth_min_mm = nan"),
        ({"depth_min_mm": 0.0, "depth_max_mm": math.inf}, r"depth_max_mm = inf"),
    ],
)
def test_impossible_display_is_refused_in_one_line_with_the_value(changes, message):
    with pytest.raises(DisplayError, match=message) as caught:
        display(**changes)
    assert "\n" not in str(caught.value)


def test_the_text_of_a_display_has_only_what_differs_from_the_defaults():
    text = "Display(pitch_mm=1.0, focal_length_mm=3.0, gap_mm=3.3, pixel_pitch_mm=0.1, "
    text += "lens_columns=8, lens_rows=6, layers=((0.5, 1.5),))"
    assert repr(Display(1, 3, 3.3, 0.1, 8, 6, layers="0.5 1.5")) == text


def test_an_unknown_preset_suggests_those_with_similar_names():
    with pytest.raises(KeyError, match=r"no display 'fone'; did you mean fine or phone\?"):
        DISPLAYS["fone"]
    assert DISPLAYS.get("fone") is None


def test_the_text_of_a_viewpoint_has_only_what_differs_from_the_defaults():
    assert repr(Viewpoint("a", 1, 2, 300)) == "Viewpoint(name='a', x_mm=1, y_mm=2, z_mm=300)"
    assert repr(Viewpoint("a", 1, 2, 300, pupil_mm=4)).endswith("z_mm=300, pupil_mm=4)")


def test_plan_view_names_eyes_only_if_it_draws_them():
    assert b">eyes<" not in plan_view(NOMINAL, ())
    assert b">eyes<" in plan_view(NOMINAL, [EyePosition(name="a", position_mm=(1, 2, 300))])


# -- pixels -------------------------------------------------------------------------------------


def test_phone_addresses_every_pixel_by_position_without_drift():
    # 159 / 2500 mm pixels under 1 mm lenses, the panel centred under the array.
    ratio = 1 / Fraction(159, 2500)
    for axis, pixels, lenses in ((PHONE.columns, 2400, 152), (PHONE.rows, 1080, 68)):
        expected = []
        for i in range(pixels):
            place = (i - Fraction(pixels - 1, 2)) / ratio + Fraction(lenses, 2)
            expected.append(math.floor(place) if 0 <= place < lenses else -1)
        assert axis.lens.tolist() == expected
    # 2400 columns are 152.64 mm: five columns on each side have no lens; no row is without.
    assert (PHONE.columns.lens < 0).sum() == 10
    assert (PHONE.columns.lens[:5] < 0).all() and (PHONE.columns.lens[-5:] < 0).all()
    counts = np.bincount(PHONE.columns.lens[PHONE.columns.lens >= 0], minlength=152)
    assert set(counts) == {15, 16}
    assert not PHONE.has_integer_ratio


@settings(max_examples=80, deadline=None, derandomize=True)
@given(
    pixel_um=st.integers(20, 900),
    pitch_um=st.integers(900, 2500),
    lenses=st.integers(1, 60),
    panel=st.none() | st.integers(1, 900),
    elemental_um=st.none() | st.integers(900, 2600),
)
def test_lens_of_every_pixel_is_that_of_its_exact_position(
    pixel_um, pitch_um, lenses, panel, elemental_um
):
    device = display(
        pitch_mm=pitch_um / 1000, pixel_pitch_mm=pixel_um / 1000,
        lens_columns=lenses, lens_rows=1, panel_columns=panel,
        elemental_pitch_mm=None if elemental_um is None else elemental_um / 1000,
    )  # fmt: skip
    ratio = Fraction(elemental_um or pitch_um, pixel_um)
    pixels = panel or math.ceil(lenses * ratio)
    assert device.eia_shape[1] == pixels
    expected = [oracle.lens_of_pixel(i, pixels, lenses, ratio) for i in range(pixels)]
    assert device.columns.lens.tolist() == expected
    whole = ratio.denominator == 1 and pixels == lenses * ratio
    rows = math.ceil(ratio)
    assert device.has_integer_ratio == (whole and device.eia_shape[0] == rows == ratio)


@pytest.mark.parametrize(
    "device",
    [
        NOMINAL,
        PHONE,
        display(lens_columns=7, lens_rows=6, pixel_pitch_mm=1 / 6),
        display(lens_columns=5, lens_rows=4, pixel_pitch_mm=0.0637, pitch_mm=1.1),
        display(lens_columns=3, lens_rows=5, elemental_pitch_mm=1.0066),
    ],
    ids=["nominal", "phone", "even", "odd lengths", "elemental pitch"],
)
def test_halves_of_an_axis_mirror_each_other_bit_for_bit(device):
    for axis, lenses in ((device.columns, device.lens_columns), (device.rows, device.lens_rows)):
        inside = axis.lens >= 0
        assert np.array_equal(inside, inside[::-1])
        assert np.array_equal(axis.position_mm, -axis.position_mm[::-1])
        assert np.array_equal(axis.lens[inside], (lenses - 1 - axis.lens[::-1])[inside])
        assert np.array_equal(axis.centre_mm[inside], -axis.centre_mm[::-1][inside])
        assert np.array_equal(axis.slope[inside], -axis.slope[::-1][inside])


def test_rows_run_down_and_columns_to_the_right():
    assert (np.diff(NOMINAL.columns.position_mm) > 0).all()
    assert (np.diff(NOMINAL.rows.position_mm) < 0).all()
    assert NOMINAL.rows.lens[0] == 0 and NOMINAL.rows.centre_mm[0] == 31.5
    # The uppermost pixel of a lens sends its ray down, the leftmost to the right.
    assert NOMINAL.rows.slope[0] < 0 < NOMINAL.columns.slope[0]
    assert NOMINAL.columns.slope[0] == pytest.approx(8 / 17 / 3.3)


# -- viewing ------------------------------------------------------------------------------------


def shows_a_flipped_view(device: Display, eye: float, distance: float, lenses: int) -> bool:
    """Follow the ray from the eye through every lens centre to the panel."""
    for n in range(lenses):
        x0 = (n - (lenses - 1) / 2) * device.pitch_mm
        lands = x0 + (x0 - eye) * device.gap_mm / distance
        own = (n - (lenses - 1) / 2) * device.elemental_image_pitch_mm
        if abs(lands - own) > device.elemental_image_pitch_mm / 2:
            return True
    return False


@pytest.mark.parametrize("elemental", [None, 1.0066, 1.003, 1.02, 0.999])
@pytest.mark.parametrize("distance", [300.0, 500.0, 2000.0])
def test_flip_limit_is_where_the_first_lens_looks_under_its_neighbour(elemental, distance):
    device = display(elemental_pitch_mm=elemental, lens_columns=15, lens_rows=40)
    limits = device.flip_limit_mm(distance)
    for limit, lenses in zip(limits, (15, 40), strict=True):
        if limit < 0:
            assert shows_a_flipped_view(device, 0.0, distance, lenses)
            continue
        for sign in (-1, 1):
            inside, outside = sign * limit * (1 - 1e-9), sign * limit * (1 + 1e-9)
            assert not shows_a_flipped_view(device, inside, distance, lenses)
            assert shows_a_flipped_view(device, outside, distance, lenses)
    assert limits[0] >= limits[1]


@pytest.mark.parametrize("elemental", [None, 1.0066, 0.999])
def test_nearest_viewing_distance_is_where_the_flip_limit_reaches_zero(elemental):
    device = display(elemental_pitch_mm=elemental)
    nearest = device.nearest_viewing_distance_mm
    assert device.flip_limit_mm(nearest) == pytest.approx((0, 0), abs=1e-9)
    assert not shows_a_flipped_view(device, 0.0, nearest * (1 + 1e-9), 64)
    assert shows_a_flipped_view(device, 0.0, nearest * (1 - 1e-9), 64)


def test_elemental_pitch_without_any_viewing_distance_is_an_error():
    with pytest.raises(DisplayError, match=r"elemental_pitch_mm = 0\.9 against pitch_mm = 1"):
        _ = display(elemental_pitch_mm=0.9).nearest_viewing_distance_mm


# -- plain data ---------------------------------------------------------------------------------


# Every parameter of the lenses alone, and others that a ray through a lens's centre depends on.
LENSES: dict[str, Any] = {
    "refractive_index": 1.7, "lens_thickness_mm": 1.4, "curved_side": "panel", "conic": -0.5,
    "asphere_a4": 1e-3, "asphere_a6": 1e-4, "abbe_number": 57.0, "aperture": "round",
    "fill_factor": 0.8, "between_lenses": "clear", "layers": ((0.5, 1.52),), "black_level": 0.001,
    "ambient_reflection": 0.01, "veiling_glare": 0.01, "white_point_k": 9300.0, "name": "theirs",
}  # fmt: skip
RAYS: dict[str, Any] = {
    "pitch_mm": 1.1, "focal_length_mm": 3.1, "gap_mm": 3.4, "pixel_pitch_mm": 0.05,
    "lens_columns": 60, "lens_rows": 61, "panel_columns": 1000, "panel_rows": 1001,
    "depth_min_mm": 20.0, "depth_max_mm": 40.0, "elemental_pitch_mm": 1.01, "pitch_y_mm": 1.2,
    "lattice": "hexagonal", "shift_x_mm": 0.1, "shift_y_mm": 0.2, "rotation_deg": 1.0,
    "tilt_x_deg": 0.5, "tilt_y_deg": 0.4, "subpixels": "rgb-stripe", "pixel_fill": 0.9,
    "subpixel_cells": ((-0.3, 0.2, 0.3, 0.2, 0.0, -0.2),), "cell_pattern": "rows",
}  # fmt: skip


def test_every_parameter_is_declared_as_one_of_lenses_or_of_rays():
    assert {*LENSES, *RAYS} == {field.name for field in fields(Display)}
    assert not LENSES.keys() & RAYS.keys()


def test_rays_through_pinholes_are_those_of_the_display():
    """The pickup of the true EIA, the depth camera and the viewing zone know no lens."""
    for misaligned in ({}, {"rotation_deg": 2.0, "tilt_x_deg": 1.0}):
        theirs = display(**LENSES, **misaligned)
        point = theirs.through_pinholes()
        ours, others = (pixel_rays(d, slice(0, d.eia_shape[0])) for d in (theirs, point))
        for name in ("lens", "x0", "y0", "slope_x", "slope_y", "gap_mm"):
            assert np.array_equal(getattr(ours, name), getattr(others, name))
        assert theirs.capture_shape(5) == point.capture_shape(5)
        assert theirs.depth_range_mm == point.depth_range_mm
        assert theirs.flip_limit_mm(500) == point.flip_limit_mm(500)


def test_a_picture_s_pixel_is_the_float_of_the_quotient_that_was_meant():
    wide = display(pitch_mm=1.7)
    assert wide.pitch_mm / 5 != 0.34
    assert wide.capture_pixel_mm(5) == 0.34
    for hundredths in range(30, 300, 5):
        device = display(pitch_mm=hundredths / 100, pixel_pitch_mm=hundredths / 1700)
        assert not accuracy_warnings(device, pixel_mm=device.capture_pixel_mm(5)), hundredths
