"""Photographs in, panel pixels out; and a line for each way to photograph the patterns wrong."""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter, shift

from inim.calibration.decode import Decoded, decode
from inim.calibration.lattice import find_lenses
from inim.calibration.patterns import patterns, periods_px, read_photograph, read_positions
from inim.display import Display
from inim.errors import FileError
from inim.image.color import srgb_from_linear, srgb_to_uint8
from tests.conftest import small_display

DISPLAY = small_display(18, 14, 17)
LENS_PX = 16  # camera pixels a lens
SHAPE = (14 * LENS_PX, 18 * LENS_PX)


def seen_through_lenses() -> tuple[np.ndarray, np.ndarray]:
    """Panel column and row of each camera pixel: a lens shows some of the panel, mirrored.

    From lens to lens it goes on by 16.9 panel pixels, within one back by 2.
    """
    maps = []
    for y, x in (np.indices(SHAPE) + 0.5,):
        for along in (x, y):
            lens, within = np.divmod(along, LENS_PX)
            maps.append(16.9 * (lens + 0.5) - 2 * (within / LENS_PX - 0.5))
    return maps[0], maps[1]


def photograph_all(
    folder: Path,
    *,
    display: Display = DISPLAY,
    maps: tuple[np.ndarray, np.ndarray] | None = None,
    gain: float = 0.7,
    gamma: float = 2.3,
    blur: float = 0.5,
    noise: float = 0.004,
    ending: str = "jpg",
    change: Callable[[int, np.ndarray], np.ndarray] = lambda _, light: light,
    **options: Any,
) -> Path:
    """A folder of photographs, in order; `change` gets each one's number and linear light."""
    column, row = seen_through_lenses() if maps is None else maps
    random = np.random.default_rng(0)
    folder.mkdir(parents=True, exist_ok=True)
    places = row.astype(int), column.astype(int)
    panel = display.eia_shape
    inside = (places[0] < panel[0]) & (places[1] < panel[1])
    rows, columns = np.where(inside, places[0], 0), np.where(inside, places[1], 0)
    for number, pattern in enumerate(patterns(display)):
        lit = np.broadcast_to(pattern.codes, panel)[rows, columns] / 255
        light = gain * (0.003 + 0.997 * lit**gamma) * inside
        light = change(number, gaussian_filter(light, blur))
        light = light + random.normal(0, noise, light.shape) * np.sqrt(light + 0.05)
        codes = srgb_to_uint8(srgb_from_linear(light))
        rgb = np.repeat(codes[..., None], 3, axis=-1)
        Image.fromarray(rgb).save(folder / f"IMG_{number + 95}.{ending}", quality=90, **options)
    return folder


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return photograph_all(tmp_path_factory.mktemp("photographs") / "a").parent


def decoded(folder: Path, display=DISPLAY):
    (position,) = read_positions(folder, display)
    return decode(position)


def interior() -> np.ndarray:
    """Camera pixels two or more inside their lens."""
    y, x = np.indices(SHAPE)
    within = [np.minimum(k % LENS_PX, LENS_PX - 1 - k % LENS_PX) for k in (x, y)]
    return (within[0] >= 2) & (within[1] >= 2)


def errors(position: Decoded) -> np.ndarray:
    """Decoded less true panel points, (2, H, W), in pixels."""
    off = []
    for actual, true, period, size in zip(
        (position.column, position.row),
        seen_through_lenses(),
        periods_px(DISPLAY),
        DISPLAY.eia_shape[::-1],
        strict=True,
    ):
        difference = actual - (true - size / 2)
        off.append(difference - period * np.rint(difference / period))
    return np.array(off)


def test_interior_pixels_are_decoded_to_what_they_see(good):
    position = decoded(good)
    assert position.column.dtype == position.row.dtype == np.float32
    assert position.motion_px < 0.02 and position.warnings == ()
    inner = interior()
    assert np.isfinite(position.column[inner]).mean() > 0.99
    off = errors(position)[:, inner & np.isfinite(position.column)]
    # A panel pixel is one: what is seen is its middle.
    assert (np.sqrt((off**2).mean(axis=1)) < 0.4).all()
    assert np.abs(off.mean(axis=1)).max() < 0.03
    assert (np.isfinite(position.column) == np.isfinite(position.row)).all()


def test_lenses_are_numbered_by_the_marks_that_they_show(good):
    lenses = find_lenses(decoded(good), DISPLAY, "a")
    assert not lenses.period_px.any()
    column, row = seen_through_lenses()
    x, y = np.floor(lenses.centre_px).astype(int).T
    true = np.stack([column[y, x], row[y, x]], axis=-1)
    assert len(lenses.index) > 200
    assert np.abs(lenses.middle_px - true).max() < 1.5


def test_a_pixel_of_two_lenses_is_undecoded_rather_than_wrong(tmp_path):
    photograph_all(tmp_path / "a", blur=1.5)
    position = decoded(tmp_path)
    decoded_pixels = np.isfinite(position.column)
    assert 0.2 < decoded_pixels.mean() < 0.9
    assert np.abs(errors(position)[:, decoded_pixels]).max() < 5, "much less than to the next lens"


def test_photographs_without_noise_are_decoded_without_warnings(tmp_path):
    photograph_all(tmp_path / "a", noise=0, ending="png")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isfinite(decoded(tmp_path).column[interior()]).mean() > 0.9


@pytest.mark.parametrize("gamma", [1.8, 2.6])
def test_a_wrong_gamma_moves_a_point_by_a_fifth_of_a_pixel_and_none_on_average(tmp_path, gamma):
    photograph_all(tmp_path / "a", gamma=gamma)
    position = decoded(tmp_path)
    for off, true in zip(errors(position), seen_through_lenses(), strict=True):
        middle = np.floor(true) + 0.5
        # Away from the borders of panel pixels, where blur mixes two.
        sure = interior() & (np.abs(true - middle) < 0.25) & np.isfinite(off)
        phase = np.floor(np.mod(middle[sure], 16)).astype(int)
        left = (off + true - middle)[sure]
        means = np.bincount(phase, left, 16) / np.maximum(np.bincount(phase, minlength=16), 1)
        assert np.abs(means).max() < 0.2
        assert abs(left.mean()) < 0.02


def test_half_the_sheet_behind_a_thumb_still_decodes(tmp_path):
    def thumb(_: int, light: np.ndarray) -> np.ndarray:
        light[:, : SHAPE[1] // 2] = 0.02
        return light

    photograph_all(tmp_path / "a", change=thumb)
    position = decoded(tmp_path)
    decoded_pixels = np.isfinite(position.column)
    assert not decoded_pixels[:, : SHAPE[1] // 2 - 4].any()
    assert decoded_pixels[:, SHAPE[1] // 2 + 4 :].mean() > 0.6


def test_photographs_of_a_shaken_camera_are_aligned(good, tmp_path):
    def shaken(number: int, light: np.ndarray) -> np.ndarray:
        moved = np.random.default_rng(number).normal(0, 0.7, 2)
        return shift(light, moved, order=3, mode="nearest")

    photograph_all(tmp_path / "a", change=shaken)
    position, still = decoded(tmp_path), decoded(good)
    assert 0.2 < position.motion_px < 1.5
    inner = interior() & np.isfinite(position.column) & np.isfinite(still.column)
    off = errors(position)[:, inner]
    assert (np.sqrt((off**2).mean(axis=1)) < 0.4).all()


# -- a missing or bad photograph ------------------------------------------------------------------


@pytest.mark.parametrize("number", range(7))
def test_one_missing_photograph_is_replaced(good, tmp_path, number):
    photograph_all(tmp_path / "a")
    (tmp_path / "a" / f"IMG_{95 + number}.jpg").write_bytes(b"")
    position = decoded(tmp_path)
    (warning,) = position.warnings
    assert warning.endswith("a: a photograph is missing; the others replace it")
    off = errors(position)[:, interior() & np.isfinite(position.column)]
    assert off.shape[1] > 0.9 * interior().sum()
    assert (np.sqrt((off**2).mean(axis=1)) < 0.6).all()


def test_a_gap_in_the_numbers_of_the_names_is_a_missing_photograph(tmp_path):
    photograph_all(tmp_path / "a")
    (tmp_path / "a" / "IMG_98.jpg").unlink()
    (position,) = read_positions(tmp_path, DISPLAY)
    assert [path is None for path in position.photographs] == [False] * 3 + [True] + [False] * 3


@pytest.mark.parametrize("number", [1, 3, 5])
def test_a_photograph_that_does_not_fit_the_others_is_replaced(tmp_path, number):
    def unsharp(n: int, light: np.ndarray) -> np.ndarray:
        return gaussian_filter(light, 8) if n == number else light

    photograph_all(tmp_path / "a", change=unsharp)
    position = decoded(tmp_path)
    (warning,) = position.warnings
    assert f"IMG_{95 + number}.jpg: does not fit the other photographs" in warning
    off = errors(position)[:, interior() & np.isfinite(position.column)]
    assert (np.sqrt((off**2).mean(axis=1)) < 0.6).all()


def test_two_missing_photographs_are_refused(tmp_path):
    photograph_all(tmp_path / "a")
    for number in (96, 99):
        (tmp_path / "a" / f"IMG_{number}.jpg").write_bytes(b"")
    with pytest.raises(FileError, match=r"IMG_99\.jpg"):
        decoded(tmp_path)


# -- files ----------------------------------------------------------------------------------------


def test_names_sort_in_shooting_order_and_hidden_files_do_not_count(good):
    (good / "a" / ".DS_Store").write_bytes(b"x")
    (position,) = read_positions(good, DISPLAY)
    names = [path.name for path in position.photographs]
    assert names == [f"IMG_{number}.jpg" for number in range(95, 102)]
    assert (position.name, position.shape) == ("a", SHAPE)
    assert position.focal_length_px is None


def test_exif_gives_the_focal_length_and_its_rotation_is_not_applied(tmp_path):
    exif = Image.Exif()
    exif.get_ifd(0x8769)[41989] = 70
    exif[0x0112] = 6  # a quarter turn
    photograph_all(tmp_path / "a", exif=exif.tobytes())
    (position,) = read_positions(tmp_path, DISPLAY)
    assert position.shape == SHAPE
    assert read_photograph(position.photographs[0]).shape == SHAPE
    expected = 70 / np.hypot(36, 24) * np.hypot(*SHAPE)
    assert position.focal_length_px == pytest.approx(expected)


def test_png_of_8_and_16_bits_is_read_as_linear_light(tmp_path):
    codes = np.arange(256, dtype=np.uint8)[None]
    Image.fromarray(codes).save(tmp_path / "8.png")
    Image.fromarray(codes.astype(np.uint16) * 257).save(tmp_path / "16.png")
    eight, sixteen = (read_photograph(tmp_path / name) for name in ("8.png", "16.png"))
    assert np.allclose(eight, sixteen, atol=1e-6)
    assert (eight[0, 0], eight[0, -1]) == (0, 1)
    assert eight[0, 128] == pytest.approx(0.2159, abs=1e-3)


def assert_refused(folder: Path, words: str, display=DISPLAY) -> None:
    with pytest.raises(FileError, match=words) as caught:
        find_lenses(decoded(folder, display), display, str(folder / "a"))
    message = str(caught.value)
    assert "\n" not in message
    assert str(folder) in message and ";" in message, "names the file and the way out"


def test_pictures_of_two_sizes_are_refused(good, tmp_path):
    photograph_all(tmp_path / "a")
    Image.new("RGB", (10, 10)).save(tmp_path / "a" / "IMG_99.jpg")
    assert_refused(tmp_path, r"IMG_99\.jpg: has 10 x 10 pixels, but the others")


def test_a_missing_or_empty_folder_is_refused(tmp_path):
    assert_refused(tmp_path / "none", "no such folder")
    photograph_all(tmp_path)
    assert_refused(tmp_path, "contains no folders")
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "IMG_1.HEIC").write_bytes(b"x")
    assert_refused(tmp_path, r"IMG_1\.HEIC: not a JPEG or PNG")


def test_files_that_are_no_pictures_are_refused(tmp_path):
    photograph_all(tmp_path / "a")
    for number in (97, 99):
        (tmp_path / "a" / f"IMG_{number}.jpg").write_text("no picture")
    assert_refused(tmp_path, r"IMG_99\.jpg: not a JPEG or PNG")


def test_another_number_of_pictures_is_refused(tmp_path):
    photograph_all(tmp_path / "a")
    for number in (96, 99):
        (tmp_path / "a" / f"IMG_{number}.jpg").unlink()
        pictures = len(list((tmp_path / "a").iterdir()))
        if pictures < 6 or number == 101:
            assert_refused(tmp_path, f"a: {pictures} pictures, but there are 7 patterns")


def test_patterns_of_another_display_are_refused(tmp_path):
    photograph_all(tmp_path / "a")
    other = small_display(18, 14, 19)
    assert_refused(tmp_path, "a: the marks .* are not those of display", other)


# -- light ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"gain": 1.6}, r"a: saturated in \d+% of the lit area"),
        ({"gain": 0.01}, r"a: the waves are hardly visible"),
        ({"blur": 6.0}, r"a: blurred by \d\.\d pixels"),
    ],
)
def test_badly_exposed_or_unsharp_photographs_are_refused(tmp_path, options, words):
    photograph_all(tmp_path / "a", **options)
    assert_refused(tmp_path, words)


def renumbered(folder: Path, order: Callable[[list[Path]], list[Path]]) -> Path:
    photograph_all(folder / "a")
    paths = sorted((folder / "a").iterdir(), key=lambda path: int(path.stem[4:]))
    contents = [path.read_bytes() for path in order(list(paths))]
    for path, content in zip(paths, contents, strict=True):
        path.write_bytes(content)
    return folder


def swap(i: int, j: int) -> Callable[[list[Path]], list[Path]]:
    def order(paths: list[Path]) -> list[Path]:
        paths[i], paths[j] = paths[j], paths[i]
        return paths

    return order


@pytest.mark.parametrize(
    "order",
    [
        swap(0, 1),
        swap(0, 4),
        lambda paths: paths[::-1],
        lambda paths: [*paths[1:], paths[0]],
        # A phase more or less, for columns, rows and both.
        lambda paths: [paths[0], paths[2], paths[3], paths[1], *paths[4:]],
        lambda paths: [*paths[:4], paths[6], *paths[4:6]],
        lambda paths: [paths[0], *paths[2:4], paths[1], *paths[5:], paths[4]],
        # Columns and rows, and two phases of each, exchanged.
        lambda paths: [paths[0], paths[5], paths[4], paths[6], paths[2], paths[1], paths[3]],
    ],
)
def test_photographs_in_another_order_are_refused(tmp_path, order):
    renumbered(tmp_path, order)
    assert_refused(tmp_path, "order|no lattice")


def test_an_exposure_that_changes_is_corrected(good, tmp_path):
    def brighter(number: int, light: np.ndarray) -> np.ndarray:
        return light * (1.3 if number == 3 else 1.0)

    photograph_all(tmp_path / "a", change=brighter, gain=0.5)
    position = decoded(tmp_path)
    off = errors(position)[:, interior() & np.isfinite(position.column)]
    assert (np.sqrt((off**2).mean(axis=1)) < 0.4).all()
