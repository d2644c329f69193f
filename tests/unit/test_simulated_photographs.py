"""Simulated photographs: rays, panel, camera and motion against closed forms."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from inim.lens import trace_to_panel
from reports.calibration.cases import Motion, draw_case, draw_disturbed
from reports.calibration.landing import (
    MARGIN_PX,
    Assembly,
    Camera,
    CameraRays,
    Landing,
    Sheet,
    distort,
    look_at,
    undistort,
)
from reports.calibration.photographs import STILL, Movement, Shot, demosaic, draw_movements
from reports.calibration.video import shares, video_movements
from tests.conftest import small_display

DISPLAY = small_display(13, 11, 17, rotation_deg=1.3, shift_x_mm=0.2, shift_y_mm=-0.3)
ALIGNED = small_display(13, 11, 17)
PINHOLE = Camera(320, 260, 4200.0, 163.0, 128.0, 0.05, -0.03, 0.0, 0.002, -0.001)


def random_rays(count: int, reach_mm: float, slope: float) -> np.ndarray:
    """Crossings of z = 0 and slopes, (4, count)."""
    random = np.random.default_rng(3)
    return np.concatenate(
        [random.uniform(-reach_mm, reach_mm, (2, count)), random.uniform(-slope, slope, (2, count))]
    )


def panel_mm(landing: Landing) -> tuple[np.ndarray, np.ndarray]:
    """Places on the panel from its middle, right and up."""
    rows, columns = DISPLAY.eia_shape
    pixel = DISPLAY.pixel_pitch_mm
    return (landing.column - columns / 2) * pixel, (rows / 2 - landing.row) * pixel


def axial_ray(slope: float, height: float = 0.0) -> tuple[np.ndarray, ...]:
    """A ray in the plane y = 0 through the axis of the middle lens, at a height over z = 0."""
    return tuple(np.array([value]) for value in (height * slope, 0.0, slope, 0.0))


def test_rays_land_where_the_thick_lens_has_them():
    rays = random_rays(50_000, 4.0, 0.3)
    landing = Sheet(DISPLAY).land(*rays)
    x, y, weight = trace_to_panel(DISPLAY, "thick", *rays)
    arrived = (landing.weight > 0) & (weight > 0)
    assert arrived.mean() > 0.98
    for actual, expected in zip((*panel_mm(landing), landing.weight), (x, y, weight), strict=True):
        np.testing.assert_allclose(actual[arrived], expected[arrived], atol=1e-12)


def test_a_tilted_panel_has_its_pitch_in_its_own_plane():
    tilted = DISPLAY.replace(tilt_x_deg=3.0, tilt_y_deg=-2.0)
    rays = random_rays(1000, 3.0, 0.2)
    landing = Sheet(tilted).land(*rays)
    x, y, _ = trace_to_panel(tilted, "thick", *rays)
    u, v = panel_mm(landing)
    arrived = landing.weight > 0
    depth = tilted.tilt_slopes[0] * x + tilted.tilt_slopes[1] * y
    np.testing.assert_allclose((u**2 + v**2)[arrived], (x**2 + y**2 + depth**2)[arrived])
    # The rotation's axis is in the sheet's plane: points move along the panel's slope only.
    sideways = (u - x) * tilted.tilt_slopes[1] - (v - y) * tilted.tilt_slopes[0]
    np.testing.assert_allclose(sideways[arrived], 0, atol=1e-12)


@pytest.mark.parametrize("slope", [0.01, 0.3])
def test_an_axial_ray_crosses_sheet_air_and_glass_at_snells_angles(slope):
    glass = Assembly(glass_mm=0.7, glass_index=1.52)
    sine = slope / math.hypot(1, slope)
    n, t = ALIGNED.refractive_index, ALIGNED.pitch_mm
    inside, below = (sine / index / math.sqrt(1 - (sine / index) ** 2) for index in (n, 1.52))
    air = ALIGNED.gap_mm - t / n - 0.7 / 1.52
    x, _ = panel_mm(Sheet(ALIGNED, glass).land(*axial_ray(slope)))
    assert x[0] == pytest.approx(t * inside + air * slope + 0.7 * below, abs=1e-12)


def test_a_glass_counts_as_its_air_equivalent_thickness_and_index_1_as_air():
    near_axis = random_rays(1000, 3.0, 0.2)
    plain = Sheet(DISPLAY).land(*near_axis)
    for left, right in zip(Sheet(DISPLAY, Assembly(0.7, 1.0)).land(*near_axis), plain, strict=True):
        np.testing.assert_allclose(left, right, atol=1e-12)
    paraxial = axial_ray(1e-3)
    with_glass, without = (
        panel_mm(Sheet(ALIGNED, assembly).land(*paraxial))[0][0]
        for assembly in (Assembly(0.7, 1.52), Assembly())
    )
    assert with_glass == pytest.approx(without, rel=1e-5)
    deep = panel_mm(Sheet(ALIGNED.replace(gap_mm=3.3 + 0.7)).land(*paraxial))[0][0]
    assert deep - without == pytest.approx(0.7e-3, rel=1e-4)


def test_a_bow_changes_the_gap_of_each_lens_and_not_their_mean():
    bow, slope = Assembly(bow_mm=(0.06, 0.0, 0.0)), 0.1
    centres = np.arange(13) - 6.0
    heights = 0.06 * ((centres / 6.5) ** 2 - 1 / 3)
    # Through the vertices of a row of lenses, across the bow.
    slopes = 0 * centres, np.full(13, slope)
    _, bowed = panel_mm(Sheet(ALIGNED, bow).land(centres, slope * heights, *slopes))
    _, flat = panel_mm(Sheet(ALIGNED).land(centres, 0 * centres, *slopes))
    # A tilt by up to 0.017 adds a displacement of second order.
    np.testing.assert_allclose(bowed - flat, slope * heights, atol=1e-6)
    # The mean of 13 squares differs from the integral's by a third of 1 / 13^2.
    assert np.mean(bowed - flat) == pytest.approx(-slope * 0.06 / 3 / 13**2, rel=0.05)


def test_a_glass_thicker_than_the_gap_and_other_lattices_are_refused():
    with pytest.raises(ValueError, match="of air between"):
        Sheet(ALIGNED, Assembly(glass_mm=5.0))
    with pytest.raises(ValueError, match="lattice"):
        Sheet(ALIGNED.replace(lattice="hexagonal"))


def test_distortion_is_opencvs_and_has_an_inverse():
    cv2 = pytest.importorskip("cv2")
    lens = replace(PINHOLE, k1=-0.25).lens
    points = np.random.default_rng(1).uniform(-0.25, 0.25, (50, 2))
    matrix = np.array([[lens.focal, 0, lens.centre_x], [0, lens.focal, lens.centre_y], [0, 0, 1]])
    pixels, _ = cv2.projectPoints(
        np.column_stack([points, np.ones(50)]), np.zeros(3), np.zeros(3), matrix, np.array(lens[3:])
    )
    for point, pixel in zip(points, pixels[:, 0], strict=True):
        assert distort(lens, *point) == pytest.approx(tuple(pixel), abs=1e-9)
        assert undistort(lens, *pixel) == pytest.approx(tuple(point), abs=1e-10)


def test_a_camera_traces_the_rays_of_its_pixels():
    """The mean landing of a pixel's quarters is that of the ray through its centre."""
    pose = look_at(np.array([60.0, -25.0, 170.0]), np.array([0.5, 0.2, 0.0]), 3.0, 1.0)
    sheet = Sheet(DISPLAY)
    rays = sheet.trace(PINHOLE, pose, seed=1)
    pixels = np.random.default_rng(2).integers(20, 240, (4000, 2))
    tangents = [undistort(PINHOLE.lens, column + 0.5, row + 0.5) for column, row in pixels]
    direction = np.column_stack([tangents, np.ones(len(pixels))]) @ pose.turn
    slopes = direction[:, :2].T / -direction[:, 2]
    expected = sheet.land(*(pose.eye_mm[:2, None] + pose.eye_mm[2] * slopes), *slopes)
    i, j = 2 * (pixels[:, 1] + MARGIN_PX), 2 * (pixels[:, 0] + MARGIN_PX)
    for k in range(2):
        quarters = np.stack([rays.landing[k][i + a, j + b] for a in (0, 1) for b in (0, 1)])
        smooth = (np.ptp(quarters, axis=0) < 0.5) & (quarters > 0).all(axis=0)
        assert smooth.mean() > 0.5
        error = (quarters.mean(axis=0) - expected[k])[smooth]
        assert abs(np.median(error)) < 0.003 and np.quantile(np.abs(error), 0.95) < 0.1


# -- panel and camera --------------------------------------------------------------------------

# A camera that looks straight at a panel of 6 x 20 pixels, 20 camera pixels wide each.
PANEL, MAGNIFICATION = (6, 20), 20
FLAT = Camera(400, 120, 1e6, 200.0, 60.0, 0.0, 0.0, 0.0)


def flat_shot(**changes) -> Shot:
    shape = (2 * (FLAT.rows + 2 * MARGIN_PX), 2 * (FLAT.columns + 2 * MARGIN_PX))
    y, x = ((np.indices(shape) + 0.5) / 2 - MARGIN_PX).astype(np.float32)
    inside = (x > 0) & (x < FLAT.columns) & (y > 0) & (y < FLAT.rows)
    landing = Landing(x / MAGNIFICATION, y / MAGNIFICATION, inside.astype(np.float32))
    focal = np.float32(FLAT.focal_length_px)
    rays = CameraRays(landing, (x - 200) / focal, (y - 60) / focal, 0.05)
    sensor = replace(draw_case(0).sensor, blur_px=0.5, panel_black=0.0, **changes)
    return Shot(rays, FLAT, sensor, PANEL)


def one_pixel() -> np.ndarray:
    codes = np.zeros(PANEL, np.uint8)
    codes[3, 9] = 255
    return codes


def centroids(light: np.ndarray) -> np.ndarray:
    """Columns and rows of the centroids of red, green and blue, (3, 2) camera pixels."""
    rows, columns = np.indices(light.shape[1:]) + 0.5
    return np.array([[np.average(columns, weights=c), np.average(rows, weights=c)] for c in light])


@pytest.mark.parametrize(("subpixels", "direction"), [("rgb", 1), ("bgr", -1), ("none", 0)])
def test_stripes_shine_a_third_of_a_pixel_apart_with_their_share_of_the_area(subpixels, direction):
    fill = 0.8
    light = flat_shot(subpixels=subpixels, pixel_fill=fill).light(one_pixel(), STILL)
    offsets = centroids(light) - np.array([9.5, 3.5]) * MAGNIFICATION
    expected = np.array([-1, 0, 1]) * direction * MAGNIFICATION / 3
    # The trapezoidal rule with steps of 1/2 over a lit width of 5.3 pixels.
    quadrature = 0.5**2 / 12 / (fill * MAGNIFICATION / 3)
    np.testing.assert_allclose(offsets, np.stack([expected, np.zeros(3)], 1), atol=quadrature)
    area = fill**2 * MAGNIFICATION**2 / (3 if direction else 1)
    np.testing.assert_allclose(light.sum(axis=(1, 2)), area, rtol=2e-3)


def test_crosstalk_moves_light_between_colours_and_a_coloured_picture_has_its_own():
    mix = ((0.9, 0.1, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    codes = np.zeros((*PANEL, 3), np.uint8)
    codes[..., 1] = 255
    red, green, blue = flat_shot(subpixels="rgb", crosstalk=mix).light(codes, STILL)
    assert red.sum() == pytest.approx(0.1 * green.sum(), rel=1e-5) and blue.sum() == 0


def test_rotation_zoom_and_skew_displace_the_light_and_conserve_it():
    shot = flat_shot()
    still = shot.light(one_pixel(), STILL)
    x, y = centroids(still)[0]
    focal, angle = FLAT.focal_length_px, 1.7e-6
    turn = np.array([[1, 0, angle], [0, 1, 0], [-angle, 0, 1]])
    moved = shot.light(one_pixel(), Movement(turn, 1.01, 0.02))
    expected = 200 + 1.01 * (x - 200 + focal * angle) + 0.02 * (y - 60) * 1.01, 60 + 1.01 * (y - 60)
    np.testing.assert_allclose(centroids(moved)[0], expected, atol=2e-3)
    np.testing.assert_allclose(moved.sum(), still.sum(), rtol=1e-5)


def test_shake_has_its_rms_and_drift_ends_at_its_length():
    random = np.random.default_rng(1)
    shaken = draw_movements(Motion(shake_px=0.5), 3400.0, 4000, random)
    places = np.array([3400 * m.turn[:2, 2] / m.turn[2, 2] for m in shaken])
    assert np.sqrt(np.mean(places**2, axis=0)) == pytest.approx([0.5, 0.5], rel=0.05)
    first, *_, last = draw_movements(Motion(drift_px=3.0), 3400.0, 7, random)
    assert np.array_equal(first.turn, np.eye(3))
    assert np.hypot(*(3400 * last.turn[:2, 2])) == pytest.approx(3.0, rel=1e-6)


def test_a_frame_shares_its_exposure_among_the_pictures_that_it_shows():
    exposure_s = 1 / 60
    assert shares(0.1, exposure_s, 0.5, 3) == pytest.approx({0: 1.0})
    # The exposure starts 1/240 s before the change.
    assert shares(0.5 - 1 / 240, exposure_s, 0.5, 3) == pytest.approx({0: 0.25, 1: 0.75})
    assert shares(1.5 - 1 / 240, exposure_s, 0.5, 3) == pytest.approx({2: 0.25, 0: 0.75})
    assert shares(4.2, exposure_s, 0.5, 3) == pytest.approx({2: 1.0})
    random = np.random.default_rng(1)
    movements = video_movements(Motion(shake_px=0.5), 3400.0, 20_000, random)
    places = np.array([3400 * m.turn[:2, 2] for m in movements])
    assert np.sqrt(np.mean(places**2, axis=0)) == pytest.approx([0.5, 0.5], rel=0.05)
    assert np.abs(np.diff(places, axis=0)).max() < 0.5


def test_demosaicing_reproduces_colours_that_vary_linearly():
    row, column = np.indices((24, 30)).astype(np.float32)
    colours = np.stack([0.2 + 0.01 * row, 0.5 - 0.005 * column, 0.1 + 0.002 * (row + column)])
    raw = colours[1].copy()
    raw[::2, ::2], raw[1::2, 1::2] = colours[0, ::2, ::2], colours[2, 1::2, 1::2]
    inside = np.s_[:, 1:-1, 1:-1]
    np.testing.assert_allclose(demosaic(raw)[inside], colours[inside], atol=1e-6)


def test_a_photograph_of_a_grey_panel_has_its_exposure_and_sharpening_keeps_areas():
    white = np.full(PANEL, 255, np.uint8)
    settings = {"pixel_fill": 1.0, "tint": (1.0, 1.0, 1.0), "exposure": 0.5}
    plain = flat_shot(**settings).photograph(white, 1)
    sharp = flat_shot(**settings, sharpening=0.8, has_mosaic=True).photograph(white, 1)
    middle = np.s_[20:-20, 20:-20]
    for photograph in (plain, sharp):
        # sRGB of half the light is 188.
        assert photograph[middle].mean() == pytest.approx(188, abs=1)
    assert sharp[middle][..., 1].std() > plain[middle][..., 1].std()


# -- cases -------------------------------------------------------------------------------------


def test_sixty_disturbed_cases_have_every_disturbance_and_room_for_their_sheets():
    cases = [draw_disturbed(number) for number in range(60)]
    counts = Counter(name for case in cases for name in case.disturbances)
    assert len(counts) == 14 and min(counts.values()) >= 2
    assert sum(not {*case.disturbances} - {"steady"} for case in cases) == 6
    for case in cases:
        Sheet(case.display, case.assembly)
    again = draw_disturbed(7, positions=4)
    assert again.display == cases[7].display and again.sensor == cases[7].sensor
    assert again.zooms[:2] == cases[7].zooms
