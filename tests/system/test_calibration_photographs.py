"""Simulated photographs: rays land where the thick lens has them, and pictures decode to that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from inim.calibration.decode import decode
from inim.calibration.patterns import read_positions, write_patterns
from inim.lens import trace_to_panel
from reports.calibration.cases import draw_case
from reports.calibration.landing import SAMPLES, Camera, Pose, Sheet, look_at
from reports.calibration.photographs import photograph_case
from tests.conftest import small_display

DISPLAY = small_display(
    12, 10, 17, rotation_deg=1.3, shift_x_mm=0.2, shift_y_mm=-0.3, tilt_x_deg=0.4, tilt_y_deg=-0.3
)
PINHOLE = Camera(320, 260, 4200.0, 163.0, 128.0, 0.05, -0.03, 0.0)
OBLIQUE = look_at(np.array([60.0, -25.0, 170.0]), np.array([0.5, 0.2, 0.0]), 3.0, 1.0)


def distorted(camera: Camera, pose: Pose, points: np.ndarray) -> np.ndarray:
    """Pixels of points of the display frame, by OpenCV."""
    cv2 = pytest.importorskip("cv2")
    focal = camera.focal_length_px
    matrix = np.array([[focal, 0, camera.centre_x_px], [0, focal, camera.centre_y_px], [0, 0, 1.0]])
    find_placement, _ = cv2.Rodrigues(pose.turn)
    moved = -pose.turn @ pose.eye_mm
    coefficients = np.array([camera.k1, camera.k2, 0.0, 0.0])
    image_points, _ = cv2.projectPoints(points, find_placement, moved, matrix, coefficients)
    return image_points[:, 0]


@pytest.mark.parametrize("side", ["viewer", "panel"])
def test_rays_land_where_the_thick_lens_has_them_but_for_the_facets(side):
    """A pinhole camera's rays, found again by OpenCV's projection and traced as formulas."""
    display = DISPLAY.replace(curved_side=side)
    sheet = Sheet(display)
    landing = sheet.trace(PINHOLE, OBLIQUE, seed=1)
    # Rays of the formula, through random points of the sheet, to the camera's eye.
    random = np.random.default_rng(2)
    x, y = random.uniform(-4.5, 4.5, (2, 60_000)) * [[1.2], [1.0]]
    eye = OBLIQUE.eye_mm
    slopes = (x - eye[0]) / eye[2], (y - eye[1]) / eye[2]
    panel_x, panel_y, weight = trace_to_panel(display, "thick", x, y, *slopes)
    column = panel_x / display.pixel_pitch_mm + display.eia_shape[1] / 2
    row = display.eia_shape[0] / 2 - panel_y / display.pixel_pitch_mm
    pixel = distorted(PINHOLE, OBLIQUE, np.stack([x, y, 0 * x], -1))
    inside = (pixel > 1).all(axis=1) & (pixel < (PINHOLE.columns - 1, PINHOLE.rows - 1)).all(axis=1)
    lens_px = PINHOLE.focal_length_px / np.linalg.norm(eye)
    assert inside.mean() > 0.9 and lens_px > 15
    # The landing of the camera pixel's four rays that are nearest on average: their middle.
    places = np.floor(pixel[inside]).astype(int)
    index = places[:, 1] * PINHOLE.columns + places[:, 0]
    off = []
    for actual, true in ((landing.column, column), (landing.row, row)):
        four = actual.reshape(-1, SAMPLES)[index]
        lit = (landing.weight.reshape(-1, SAMPLES)[index] > 0).all(axis=1) & (weight[inside] > 0)
        smooth = lit & (np.ptp(four, axis=1) < 1.0)  # all four through one lens
        assert smooth.mean() > 0.6
        off.append((four.mean(axis=1) - true[inside])[smooth])
    for axis in off:
        # A camera pixel is a sixteenth of a lens, which shows 2 panel pixels and more.
        assert abs(np.median(axis)) < 0.01
        assert np.quantile(np.abs(axis), 0.95) < 0.5


def test_each_ray_lands_within_the_facets_error_of_the_formula():
    """The very rays: through the sheet by the renderer, and by `thick` in float64."""
    sheet = Sheet(DISPLAY)
    random = np.random.default_rng(3)
    x, y = random.uniform(-4, 4, (2, 200_000))
    sx, sy = random.uniform(-0.3, 0.3, (2, 200_000))
    column, row, weight = sheet.land(x, y, sx, sy)
    panel_x, panel_y, thick = trace_to_panel(DISPLAY, "thick", x, y, sx, sy)
    pixel = DISPLAY.pixel_pitch_mm
    rows, columns = DISPLAY.eia_shape
    off = np.hypot(column - panel_x / pixel - columns / 2, row - rows / 2 + panel_y / pixel)
    in_both = (weight > 0) & (thick > 0)
    assert in_both.mean() > 0.99
    facets = sheet.mesh.facet_error_mm / pixel
    # As `inim.lens.full` states of its facets; float32 adds some 1e-3 pixels.
    assert np.quantile(off[in_both], 0.99) < facets + 2e-3
    assert (off[in_both] > 2 * facets + 2e-3).mean() < 1e-3
    assert np.quantile(np.abs(weight - thick)[in_both], 0.999) < 2e-3


@pytest.fixture(scope="module")
def case():
    """A small display before a small camera."""
    settings = draw_case(0)
    camera = replace(PINHOLE, pupil_mm=2.5)
    return replace(
        settings, design=small_display(12, 10, 17), display=DISPLAY, camera=camera, poses=(OBLIQUE,)
    )


def test_photographs_decode_to_where_their_rays_land(case, tmp_path):
    write_patterns(case.design, tmp_path / "patterns")
    photograph_case(case, tmp_path / "patterns", tmp_path / "photographs")
    (position,) = read_positions(tmp_path / "photographs", case.design)
    diagonal = np.hypot(case.camera.columns, case.camera.rows)
    assert position.focal_length_px == pytest.approx(
        case.camera.focal_length_px, abs=0.51 * diagonal / np.hypot(36, 24)
    )
    decoded = decode(position)
    landing = Sheet(case.display).trace(case.camera, case.poses[0], seed=9)
    decoded_pixels = np.isfinite(decoded.column)
    assert decoded_pixels.mean() > 0.3
    for actual, rays, period, size in zip(
        (decoded.column, decoded.row),
        (landing.column, landing.row),
        position.periods_px,
        case.design.eia_shape[::-1],
        strict=True,
    ):
        four = rays.reshape(*actual.shape, SAMPLES)
        lit = (landing.weight.reshape(four.shape) > 0).all(axis=-1)
        chosen = decoded_pixels & lit & (np.ptp(four, axis=-1) < 3)
        off = (actual - four.mean(axis=-1) + size / 2)[chosen]
        off -= period * np.rint(off / period)
        assert off.size > 10_000
        assert abs(off.mean()) < 0.03
        assert np.sqrt(np.mean(off**2)) < 0.5


def test_a_case_follows_from_its_number_and_photographs_do_not_reveal_it(case, tmp_path):
    assert draw_case(7).display == draw_case(7).display != draw_case(9).display
    assert draw_case(7).design.name == "phone"
    write_patterns(case.design, tmp_path / "patterns")
    for name in ("a", "b"):
        photograph_case(case, tmp_path / "patterns", tmp_path / name)
    files = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*.*"))
    assert all(path.suffix == ".jpg" for path in files)
    for path in files[:3]:
        assert (tmp_path / "a" / path).read_bytes() == (tmp_path / "b" / path).read_bytes()
        with Image.open(tmp_path / "a" / path) as picture:
            assert dict(picture.getexif())[0x0110] == "simulated"
