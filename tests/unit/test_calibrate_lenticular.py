"""Slanted lenticular displays from the fringes of their views.

Expected: near the axis, cylinders show the bare panel at the depth of the gap; far from it, the
fringes are those of rays that another program traces; hidden parameters are found within their
standard errors; one position leaves the gap open; other patterns and ambiguous gaps are refused.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from inim.calibration.fit import CYLINDER_LIMITS, fit_display
from inim.calibration.fringes import FringeObservations, Fringes, begin_fringes, see_through
from inim.calibration.lattice import check_marks, period_numbers
from inim.calibration.model import Deviations, Guess, Intrinsics, Pose
from inim.calibration.output import calibration_document, next_positions, residual_maps
from inim.calibration.patterns import has_mark, marks_begin, patterns, periods_px, view_phase
from inim.calibration.result import Calibration
from inim.display import Display
from inim.display.looking_glass import LookingGlass
from inim.documents.display import CalibrationDocument
from inim.documents.document import decode, encode
from inim.errors import DisplayError, FileError
from inim.image.color import linear_from_srgb
from reports.calibration.landing import Assembly, Sheet
from tests.calibration_photographs import look_at

FILE = LookingGlass(47.6, -5.48, 0.3, 40.0, 338.0, 1000, 800)
DESIGN = FILE.display(name="small")
HIDDEN = replace(FILE, pitch=47.9, slope=-5.6, center=0.8, view_cone=37.0).display(name="hidden")
CAMERA = Intrinsics(900.0, 325.0, 250.0, 0.03, -0.02)
SHAPE = (512, 640)
EYES = {
    "straight": ((2.0, -3.0, 130.0), 2.0),
    "left": ((-32.0, 4.0, 140.0), -1.0),
    "right": ((30.0, 2.0, 145.0), 1.0),
    "far left": ((-91.0, 4.0, 130.0), 0.0),
    "far right": ((91.0, 4.0, 130.0), 0.0),
}
NEAR = ("straight", "left", "right")


# -- patterns -------------------------------------------------------------------------------------


def test_a_view_pattern_shows_the_vendor_s_views_with_fringes():
    file = FILE
    x, y = np.meshgrid((np.arange(1000) + 0.5) / 1000, 1 - (np.arange(800) + 0.5) / 800)
    pitch = file.pitch * 1000 / file.dpi * np.cos(np.arctan(1 / file.slope))
    names = [pattern.name for pattern in patterns(DESIGN)]
    assert names[0] == "01-white" and names[7:] == [
        f"{n:02}-view-phase-{shift}" for n, shift in ((8, "000"), (9, "120"), (10, "240"))
    ]
    codes = patterns(DESIGN)[8].codes
    assert codes.shape == (800, 1000, 3)
    fringes = (y - 0.5) * 800 / file.dpi * file.pitch / 30
    for c in range(3):
        phase = (x + c / 3000 + y * 800 / (1000 * file.slope)) * pitch - file.center
        light = 0.5 + 0.5 * np.cos(2 * np.pi * (phase + fringes - 1 / 3))
        off = linear_from_srgb(codes[..., c] / np.float32(255)) - light
        assert np.abs(off).max() < 0.005, "one code"


def test_marks_tell_displays_with_other_views_apart():
    period = periods_px(DESIGN)
    rows, columns = DESIGN.eia_shape
    x, y = np.random.default_rng(0).uniform(-0.5, 0.5, (2, 4000)) * [[columns], [rows]]
    at = np.stack([x, y], axis=-1)
    cell = np.rint(at / period)
    marked = has_mark(*cell.T, period, marks_begin(DESIGN))
    offset, _ = period_numbers(at - period, marked, DESIGN)
    np.testing.assert_array_equal(offset, [1, 1])
    other = DESIGN.replace(rotation_deg=DESIGN.rotation_deg - 0.5)
    offset, is_contradicted = period_numbers(at, marked, other)
    assert offset is None and is_contradicted
    with pytest.raises(FileError, match=r"^left: the marks of the white pattern are not those of"):
        check_marks(True, other, "left")


# -- the model ------------------------------------------------------------------------------------


def test_near_the_axis_the_bare_panel_shows_at_the_depth_of_the_gap():
    x, y = np.random.default_rng(1).uniform(-30, 30, (2, 500))
    sx, sy = np.random.default_rng(2).uniform(-1e-3, 1e-3, (2, 500))
    panel, wave, lens = see_through(HIDDEN, np.stack([x, y, sx, sy]), Deviations())
    straight = np.stack([x + HIDDEN.gap_mm * sx, y + HIDDEN.gap_mm * sy], axis=-1)
    np.testing.assert_allclose(panel, wave, atol=1e-4)
    # A seam is seen a sag deeper.
    angle, sag = np.radians(HIDDEN.rotation_deg), HIDDEN.pitch_mm * 0.3
    across = np.cos(angle) * (x - HIDDEN.shift_x_mm) + np.sin(angle) * y
    np.testing.assert_allclose(lens, across / HIDDEN.pitch_mm, atol=1e-3 * sag / HIDDEN.pitch_mm)
    assert np.abs(panel - straight).max() < 1e-3 * 0.5 * HIDDEN.gap_mm


@pytest.mark.parametrize("slopes", [(0.0, 0.0), (0.2, -0.1), (-0.35, 0.2), (0.4, 0.3)])
def test_fringes_are_those_of_rays_traced_by_other_formulas(slopes):
    """Light of parallel rays over fifty lenses, weighted as by the smoothing."""
    display = HIDDEN.replace(refractive_index=1.52, focal_length_mm=1.03 * HIDDEN.gap_mm)
    glass = 0.1
    random, pitch = np.random.default_rng(3), display.pitch_mm
    count, (sx, sy) = 400_000, slopes
    angle = np.radians(display.rotation_deg)
    off = random.normal(0.0, 1.5 * pitch, count)
    offs = np.stack([off * np.cos(angle), off * np.sin(angle)])
    full = np.full(count, 1.0)
    for x, y in ((0.0, 0.0), (11.3, -7.9), (-20.1, 3.3)):
        landing = Sheet(display, Assembly(glass)).land(
            x + offs[0], y + offs[1], sx * full, sy * full
        )
        rows, columns = display.eia_shape
        place = landing.column - columns / 2, rows / 2 - landing.row
        at_panel = [p * display.pixel_pitch_mm for p in place]
        light = landing.weight * np.exp(2j * np.pi * view_phase(DESIGN, *at_panel))
        arriving = np.array([[x], [y], [sx], [sy]])
        _, wave, lens = see_through(display, arriving, Deviations(glass_mm=glass))
        expected = view_phase(DESIGN, *wave.T) - lens
        difference = np.angle(light.sum() * np.exp(-2j * np.pi * expected[0])) / (2 * np.pi)
        assert abs(difference) < 0.004, "lenses"


# -- the fit --------------------------------------------------------------------------------------


@cache
def fringes(name: str, display: Display = HIDDEN) -> Fringes:
    """Samples of a position as the model has them, with noise."""
    eye, roll = EYES[name]
    pose = Pose(look_at(eye, (0.5, 0.3, 0.0), roll), np.array(eye))
    guess = Guess(display, CAMERA, (pose,))
    samples = FringeObservations(DESIGN, (), (), (), ()).seen_from(guess, SHAPE)
    assert samples is not None
    (panel,), (phase,) = samples.panel, samples.phase
    random, count = np.random.default_rng(len(name)), len(panel)
    panel_px = panel / DESIGN.pixel_pitch_mm * [1, -1] + np.array(DESIGN.eia_shape[::-1]) / 2
    noisy = phase + random.normal(0, 0.002, count)
    # Continuous over the panel, as those of a photograph, from the middle.
    angle = np.radians(display.rotation_deg)
    turned = np.array([np.cos(angle), np.sin(angle)]) / display.pitch_mm
    near = view_phase(DESIGN, *panel.T) - (1 - display.gap_mm / eye[2]) * panel @ turned
    return Fringes(
        samples.index[0],
        samples.pixel[0],
        panel_px + random.normal(0, 0.1, panel.shape),
        noisy + np.rint(near - near.mean() - (noisy - noisy[len(noisy) // 2])),
        0.0,
        SHAPE,
    )


@cache
def fitted(*names: str) -> Calibration:
    positions = {name: fringes(name) for name in names}
    return fit_display(positions, DESIGN, focal_px=1.02 * CAMERA.focal_px)


def test_a_hidden_display_is_found_within_its_errors():
    result = fitted(*NEAR)
    assert result.undetermined == [] and result.failures == []
    assert {*result.estimates} == {*CYLINDER_LIMITS, *Intrinsics._fields}
    for name in CYLINDER_LIMITS:
        estimate, true = result.estimates[name], getattr(HIDDEN, name)
        if name == "shift_x_mm":  # all cylinders are equal
            step = HIDDEN.pitch_mm / np.cos(np.radians(HIDDEN.rotation_deg))
            true += step * round((estimate.value - true) / step)
        assert abs(estimate.value - true) < 4 * estimate.error, name
    assert abs(HIDDEN.pitch_mm - DESIGN.pitch_mm) > 20 * result.estimates["pitch_mm"].error
    assert abs(HIDDEN.gap_mm - DESIGN.gap_mm) > 2 * result.estimates["gap_mm"].error
    file, true_file = LookingGlass.of(result.display), LookingGlass.of(HIDDEN)
    assert file.pitch == pytest.approx(true_file.pitch, rel=2e-4)
    assert file.view_cone == pytest.approx(true_file.view_cone, abs=1.5)
    assert result.view_error is not None and result.view_error < 0.03
    document = calibration_document(result, "Calibration", "inim calibrate")
    assert decode(encode(document), CalibrationDocument) == document
    labels, maps = residual_maps(result)
    assert [unit for _, unit in labels] == ["µm", "µm", "‰ of a lens"]
    assert {*maps} == {*NEAR} and all(a.shape[2] == 3 for a in maps.values())


def test_one_position_leaves_the_gap_open_and_sides_determine_it():
    straight, two_sides = fitted("straight"), fitted("left", "right")
    assert {*straight.undetermined} == {"pitch_mm", "gap_mm"}
    assert straight.display.gap_mm == DESIGN.gap_mm
    assert abs(straight.display.rotation_deg - HIDDEN.rotation_deg) < 0.01
    assert two_sides.undetermined == []
    gain = straight.estimates["gap_mm"].error / two_sides.estimates["gap_mm"].error
    assert gain > 5
    best = next_positions(straight)[0]
    assert "left" in best.description or "right" in best.description
    assert best.standard_errors["gap_mm"] < straight.estimates["gap_mm"].error / 3


def test_sides_too_far_apart_leave_several_gaps():
    names = ("far left", "far right", "straight")
    display = HIDDEN.replace(gap_mm=1.25 * DESIGN.gap_mm)
    positions = {name: fringes(name, display) for name in names}
    middle = positions.pop("straight")
    with pytest.raises(FileError, match=r"^far left, far right: several gaps explain the fringes"):
        begin_fringes(positions, DESIGN, CAMERA, None)
    guess = begin_fringes(positions | {"straight": middle}, DESIGN, CAMERA, None)
    assert guess.display.gap_mm == pytest.approx(display.gap_mm, rel=0.1)


def test_mirrored_photographs_are_refused():
    position = fringes("left")
    mirrored = replace(position, pixel=[SHAPE[1], 0] + position.pixel * [-1, 1])
    with pytest.raises(FileError, match=r"^left: the photographs are mirrored"):
        begin_fringes({"left": mirrored}, DESIGN, CAMERA, None)


def test_cylinders_too_steep_for_their_material_are_refused():
    with pytest.raises(DisplayError, match="use a longer focal_length_mm or a higher"):
        fit_display({}, DESIGN.replace(focal_length_mm=0.4))
