"""A photograph against its simulation: what was changed on purpose is found, in its own row."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift

from inim.calibration.model import Intrinsics, Pose, rotation
from inim.calibration.photo import BLOCK_PX, compare, simulate
from inim.errors import FileError
from inim.lens import trace_to_panel
from tests.conftest import small_display

SHAPE = (260, 330)


@pytest.fixture(scope="module")
def light() -> np.ndarray:
    """A picture with detail of a few pixels, as lenses make it."""
    random = np.random.default_rng(1)
    parts = [gaussian_filter(random.random(SHAPE), s) * s for s in (1.2, 3, 9)]
    grey = sum(
        (part - part.mean()) / part.std() * w for part, w in zip(parts, (1, 1, 1), strict=True)
    )
    grey = np.clip(0.45 + 0.12 * grey, 0.02, 0.95)
    return (grey[..., None] * [1.0, 0.9, 0.7]).astype(np.float32)


@pytest.fixture(scope="module")
def is_array() -> np.ndarray:
    inside = np.zeros(SHAPE, bool)
    inside[10:-10, 20:-5] = True
    return inside


def photograph(
    light: np.ndarray,
    moved: tuple[float, float] = (0.0, 0.0),
    blur: float = 0.0,
    gamma: float = 1.0,
    gain: float = 0.8,
    black: float = 0.0,
) -> np.ndarray:
    there = np.stack(
        [shift(light[..., c], moved[::-1], order=5, mode="nearest") for c in range(3)], axis=-1
    )
    soft = gaussian_filter(there, (blur, blur, 0)) if blur else there
    noise = np.random.default_rng(2).normal(0, 0.003, light.shape)
    return (black + gain * np.maximum(soft, 0) ** gamma + noise).astype(np.float32)


@pytest.mark.parametrize("moved", [(-0.5, 0.25), (3.2, -2.7)])
@pytest.mark.parametrize(
    "others", [{}, pytest.param({"gamma": 1.3, "blur": 1.0}, marks=pytest.mark.slow)]
)
def test_a_known_shift_is_found_and_is_no_blur(light, is_array, moved, others):
    comparison = compare(photograph(light, moved, **others), light, is_array, "photo")
    assert (comparison.right_px, comparison.down_px) == pytest.approx(moved, abs=0.02)
    assert comparison.blur_px == pytest.approx(others.get("blur", 0.0), abs=0.15)
    assert comparison.tones[1].gamma == pytest.approx(others.get("gamma", 1.0), abs=0.03)
    assert np.nanmedian(comparison.flow, axis=(0, 1)) == pytest.approx(moved, abs=0.03)


@pytest.mark.parametrize("gamma", [pytest.param(0.8, marks=pytest.mark.slow), 1.25])
def test_a_known_gamma_and_black_level_are_found_and_move_nothing(light, is_array, gamma):
    comparison = compare(photograph(light, gamma=gamma, black=0.02), light, is_array, "photo")
    for tone in comparison.tones:
        assert tone.gamma == pytest.approx(gamma, abs=0.02)
        assert tone.gain == pytest.approx(0.8, abs=0.02)
        assert tone.black == pytest.approx(0.02, abs=0.01)
    assert np.hypot(comparison.right_px, comparison.down_px) < 0.02
    assert comparison.blur_px < 0.15


@pytest.mark.parametrize("blur", [pytest.param(0.7, marks=pytest.mark.slow), 1.5])
def test_a_known_blur_is_found_and_is_neither_shift_nor_tone(light, is_array, blur):
    comparison = compare(photograph(light, blur=blur), light, is_array, "photo")
    assert comparison.blur_px == pytest.approx(blur, abs=0.05)
    assert np.hypot(comparison.right_px, comparison.down_px) < 0.02
    assert comparison.tones[0].gamma == pytest.approx(1.0, abs=0.03)


def test_each_cause_takes_its_share_of_the_error_and_noise_is_left(light, is_array):
    comparison = compare(photograph(light, (0.8, -0.6), 1.0, 1.2), light, is_array, "photo")
    errors = [
        float(np.mean((stage.picture - comparison.photograph)[comparison.counts] ** 2))
        for stage in comparison.stages
    ]
    assert comparison.stages[0].name == "exposure only"
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 3e-5 < errors[0] / 20, "the noise is 0.003"


def test_a_movement_of_one_part_shows_in_the_flow_there(light, is_array):
    straight, moved = photograph(light), photograph(light, (0.6, 0.0))
    mixed = np.where(np.arange(SHAPE[1])[None, :, None] < 170, straight, moved)
    comparison = compare(mixed, light, is_array, "photo")
    left = (170 - comparison.window[1].start) // BLOCK_PX
    assert np.nanmedian(comparison.flow[:, :left, 0]) == pytest.approx(0.0, abs=0.05)
    assert np.nanmedian(comparison.flow[:, left + 1 :, 0]) == pytest.approx(0.6, abs=0.05)


def test_a_photograph_without_the_display_or_of_one_value_is_refused(light, is_array):
    with pytest.raises(FileError, match="hardly shows the display"):
        compare(light, light, is_array & False, "photo")
    with pytest.raises(FileError, match="is uniform"):
        compare(np.full_like(light, 0.5), light, is_array, "photo")


def test_the_simulation_is_the_panel_pixel_that_the_thick_lens_shows():
    display = small_display(10, 8, 17, rotation_deg=1.0, shift_x_mm=0.1)
    camera = Intrinsics(2000.0, 100.0, 80.0, 0.02)
    eye = np.array([2.0, -1.0, 220.0])
    pose = Pose(rotation([0.01, 0.005, 0.03]) @ np.diag([1.0, -1.0, -1.0]), eye)
    rows, columns = display.eia_shape
    eia = np.zeros((rows, columns, 3), np.float32)
    eia[..., 0] = (np.arange(columns) + 0.5) / columns
    eia[..., 1] = (np.arange(rows)[:, None] + 0.5) / rows
    eia[..., 2] = 1.0
    light, is_array = simulate(eia, display, camera, pose, (160, 200))
    assert 0.1 < is_array.mean() < 0.9
    # A point of the sheet, projected by hand, to its panel pixel.
    x, y = 1.27, -0.83
    at = pose.turn @ (np.array([x, y, 0.0]) - eye)
    tangent = at[:2] / at[2]
    pixel = tangent * (1 + camera.k1 * tangent @ tangent) * camera.focal_px + (100.0, 80.0)
    slope = (x - eye[0]) / eye[2], (y - eye[1]) / eye[2]
    px, py, weight = trace_to_panel(display, "thick", x, y, *slope)
    color = light[int(pixel[1]), int(pixel[0])]
    assert color[2] == pytest.approx(float(weight), abs=0.01)
    column = px / display.pixel_pitch_mm + columns / 2
    row = rows / 2 - py / display.pixel_pitch_mm
    assert color[0] / color[2] * columns == pytest.approx(column, abs=1.0)
    assert color[1] / color[2] * rows == pytest.approx(row, abs=1.0)
