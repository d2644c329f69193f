"""Simulated photographs decode to where their rays land."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from inim.calibration.decode import decode
from inim.calibration.patterns import read_positions, write_patterns
from reports.calibration.cases import Motion, draw_case
from reports.calibration.landing import MARGIN_PX, Camera, Sheet, look_at
from reports.calibration.photographs import photograph_case
from tests.conftest import small_display

DISPLAY = small_display(
    12, 10, 17, rotation_deg=1.3, shift_x_mm=0.2, shift_y_mm=-0.3, tilt_x_deg=0.4, tilt_y_deg=-0.3
)
PINHOLE = Camera(320, 260, 4200.0, 163.0, 128.0, 0.05, -0.03, 0.0)
OBLIQUE = look_at(np.array([60.0, -25.0, 170.0]), np.array([0.5, 0.2, 0.0]), 3.0, 1.0)


@pytest.fixture(scope="module")
def case():
    """A small display before a small camera."""
    settings = draw_case(0)
    camera = replace(PINHOLE, pupil_mm=2.5)
    return replace(
        settings,
        design=small_display(12, 10, 17),
        display=DISPLAY,
        camera=camera,
        poses=(OBLIQUE,),
        zooms=(1.0,),
        motions=(Motion(),),
    )


def by_pixel(rays: np.ndarray) -> np.ndarray:
    """Quarters of the sensor's pixels, (rows, columns, SAMPLES)."""
    inside = rays[2 * MARGIN_PX : -2 * MARGIN_PX, 2 * MARGIN_PX : -2 * MARGIN_PX]
    return np.stack([inside[i::2, j::2] for i in (0, 1) for j in (0, 1)], axis=-1)


def test_photographs_decode_to_where_their_rays_land(case, tmp_path):
    write_patterns(case.design, tmp_path / "patterns")
    photograph_case(case, tmp_path / "patterns", tmp_path / "photographs")
    (position,) = read_positions(tmp_path / "photographs", case.design)
    diagonal = np.hypot(case.camera.columns, case.camera.rows)
    assert position.focal_length_px == pytest.approx(
        case.camera.focal_length_px, abs=0.51 * diagonal / np.hypot(36, 24)
    )
    decoded = decode(position)
    landing = Sheet(case.display).trace(case.camera, case.poses[0], seed=9).landing
    decoded_pixels = np.isfinite(decoded.column)
    assert decoded_pixels.mean() > 0.3
    for actual, rays, period, size in zip(
        (decoded.column, decoded.row),
        (landing.column, landing.row),
        position.periods_px,
        case.design.eia_shape[::-1],
        strict=True,
    ):
        four = by_pixel(rays)
        lit = (by_pixel(landing.weight) > 0).all(axis=-1)
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
