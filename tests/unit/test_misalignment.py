"""Misalignment of an array."""

import pytest

from inim.display import DISPLAYS
from inim.display.misalignment import (
    MISALIGNMENTS,
    misaligned,
    one_pixel_errors,
)
from inim.system.errors import DisplayError, UsageError

NOMINAL = DISPLAYS["nominal"]


def test_offsets_add_to_the_design_s_own():
    turned = NOMINAL.replace(rotation_deg=2.0, shift_y_mm=-0.3)
    off = misaligned(turned, "rotation_deg = -0.5, shift_y_mm=0.1,gap_mm=0.2")
    assert off.rotation_deg == 1.5
    assert off.shift_y_mm == pytest.approx(-0.2)
    assert off.gap_mm == pytest.approx(3.5)


def test_slanted_cylinders_move_sideways_with_a_shift_up_and_upright_ones_do_not():
    slanted = DISPLAYS["looking-glass-portrait-typical"]
    errors = one_pixel_errors(slanted)
    off = misaligned(slanted, {"shift_y_mm": errors["shift_y_mm"]})
    moved, still = (d.layout.eye_offset(0.0, 0.0)[0] for d in (off, slanted))
    assert abs(moved - still) == pytest.approx(slanted.pixel_pitch_mm)
    assert "shift_y_mm" not in one_pixel_errors(slanted.replace(rotation_deg=0.0))
    assert set(one_pixel_errors(NOMINAL)) == set(MISALIGNMENTS)


def test_picture_and_panel_stay_as_designed():
    off = misaligned(NOMINAL, "gap_mm=0.2, shift_x_mm=3")
    assert off.depth_range_mm == NOMINAL.depth_range_mm
    assert off.eia_shape == NOMINAL.eia_shape
    assert off.central_depth_mm != NOMINAL.central_depth_mm


def test_a_pitch_error_only_stretches_the_lattice():
    aimed = NOMINAL.replace(elemental_pitch_mm=1.01, pitch_y_mm=0.9)
    off = misaligned(aimed, "pitch_mm=0.02")
    assert (off.pitch_mm, off.row_pitch_mm) == pytest.approx((1.02, 0.918))
    # What is made for the array as it lies aims at the same distance.
    assert off.elemental_image_pitch_mm / off.pitch_mm == pytest.approx(1.01)
    assert off.eia_shape == aimed.eia_shape
    assert (off.focal_length_mm, off.lens_thickness_mm) == (3.0, 1.0)
    assert misaligned(NOMINAL, "pitch_mm=0.02").elemental_image_pitch_mm == 1.02


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("rotation=1", "did you mean rotation_deg"),
        ("rotation_deg", "KEY=NUMBER"),
        ("focal_length_mm=1", "misalign 'focal_length_mm=1'"),
        ("gap_mm=wide", "'wide' is not a number"),
        ("gap_mm=1, gap_mm=1", "given twice"),
        ({"rotation": 1}, "did you mean rotation_deg"),
        ({"gap_mm": None}, "None is not a number"),
        (0.5, "misalign: 0.5 is a float; give a mapping"),
    ],
)
def test_invalid_text_is_named(text, says):
    with pytest.raises(UsageError, match=says):
        misaligned(NOMINAL, text)


@pytest.mark.parametrize("text", ["gap_mm=-4", "pitch_mm=-1", "tilt_x_deg=80", "shift_x_mm=nan"])
def test_an_impossible_mount_names_misalignment_and_value(text):
    with pytest.raises(DisplayError, match=f"misalign '{text}"):
        misaligned(NOMINAL, text)
