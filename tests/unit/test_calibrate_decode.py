"""Photographs in, panel pixels out; and a line for each way to photograph the patterns wrong."""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter

from inim.calibration.decode import decode
from inim.calibration.patterns import patterns, read_photograph, read_positions
from inim.display import DISPLAYS
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
    panel: tuple[int, int] = DISPLAY.eia_shape,
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
    inside = (places[0] < panel[0]) & (places[1] < panel[1])
    rows, columns = np.where(inside, places[0], 0), np.where(inside, places[1], 0)
    for number, pattern in enumerate(patterns(panel)):
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


def test_interior_pixels_are_known_and_right_within_the_error_that_they_state(good):
    position = decoded(good)
    assert position.column.dtype == position.row.dtype == position.error_px.dtype == np.float32
    inner = interior()
    assert np.isfinite(position.column[inner]).mean() > 0.99
    for actual, true in zip((position.column, position.row), seen_through_lenses(), strict=True):
        off = (actual - true)[inner & np.isfinite(actual)]
        error = position.error_px[inner & np.isfinite(actual)]
        # A panel pixel is one: what is seen is its middle.
        assert np.sqrt(np.mean(off**2)) < 1.15 * np.sqrt(np.mean(error**2)) < 0.4
        assert abs(np.mean(off)) < 0.03
        assert np.quantile(np.abs(off) / error, 0.99) < 3
    assert (np.isfinite(position.column) == np.isfinite(position.row)).all()
    assert position.lit[inner].min() > 0.4


def test_a_pixel_of_two_lenses_is_undecoded_rather_than_wrong(tmp_path):
    photograph_all(tmp_path / "a", blur=1.5)
    position = decoded(tmp_path)
    decoded_pixels = np.isfinite(position.column)
    assert 0.2 < decoded_pixels.mean() < 0.9
    for actual, true in zip((position.column, position.row), seen_through_lenses(), strict=True):
        assert np.abs(actual - true)[decoded_pixels].max() < 4, "much less than from lens to lens"


def test_noise_makes_the_error_larger(good, tmp_path):
    photograph_all(tmp_path / "a", noise=0.05)
    quiet, noisy = decoded(good), decoded(tmp_path)
    inner = interior()
    more = [np.nanmedian(position.error_px[inner] ** 2) - 1 / 12 for position in (noisy, quiet)]
    assert more[0] > 50 * more[1] > 0, "noise is 12 times as large"
    assert np.nanmin(quiet.error_px) >= np.float32(1 / np.sqrt(12))


def test_photographs_without_noise_are_decoded_without_warnings(tmp_path):
    photograph_all(tmp_path / "a", noise=0, ending="png")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isfinite(decoded(tmp_path).error_px[interior()]).mean() > 0.9


@pytest.mark.parametrize("gamma", [1.8, 2.6])
def test_a_wrong_gamma_moves_nothing_by_a_tenth_of_a_pixel(tmp_path, gamma):
    photograph_all(tmp_path / "a", gamma=gamma)
    position = decoded(tmp_path)
    column, row = seen_through_lenses()
    for actual, true in ((position.column, column), (position.row, row)):
        middle = np.floor(true) + 0.5
        # Away from the borders of panel pixels, where blur mixes two.
        sure = interior() & (np.abs(true - middle) < 0.25) & np.isfinite(actual)
        phase = np.floor(np.mod(middle[sure], 16)).astype(int)
        off = (actual - middle)[sure]
        means = np.bincount(phase, off, 16) / np.maximum(np.bincount(phase, minlength=16), 1)
        assert np.abs(means).max() < 0.1


def test_half_the_sheet_behind_a_thumb_still_decodes(tmp_path):
    def thumb(_: int, light: np.ndarray) -> np.ndarray:
        light[:, : SHAPE[1] // 2] = 0.02
        return light

    photograph_all(tmp_path / "a", change=thumb)
    position = decoded(tmp_path)
    decoded_pixels = np.isfinite(position.column)
    assert not decoded_pixels[:, : SHAPE[1] // 2 - 4].any()
    assert decoded_pixels[:, SHAPE[1] // 2 + 4 :].mean() > 0.6


# -- files ----------------------------------------------------------------------------------------


def test_names_sort_in_shooting_order_and_hidden_files_do_not_count(good):
    (good / "a" / ".DS_Store").write_bytes(b"x")
    (position,) = read_positions(good, DISPLAY)
    names = [path.name for path in position.photographs]
    assert names[:6] == [f"IMG_{number}.jpg" for number in range(95, 101)]
    assert (position.name, position.shape, position.panel) == ("a", SHAPE, DISPLAY.eia_shape)
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
        decoded(folder, display)
    message = str(caught.value)
    assert "\n" not in message
    assert str(folder) in message and ";" in message, "names the file and the way out"


def test_pictures_of_two_sizes_are_refused(good, tmp_path):
    photograph_all(tmp_path / "a")
    Image.new("RGB", (10, 10)).save(tmp_path / "a" / "IMG_99.jpg")
    assert_refused(tmp_path, r"IMG_99\.jpg: has 10 x 10 pixels, but IMG_95")


def test_a_missing_or_empty_folder_is_refused(tmp_path):
    assert_refused(tmp_path / "none", "no such folder")
    photograph_all(tmp_path)
    assert_refused(tmp_path, "contains no folders")
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "IMG_1.HEIC").write_bytes(b"x")
    assert_refused(tmp_path, r"IMG_1\.HEIC: not a JPEG or PNG")


def test_files_that_are_no_pictures_are_refused(tmp_path):
    photograph_all(tmp_path / "a")
    (tmp_path / "a" / "IMG_99.jpg").write_text("no picture")
    assert_refused(tmp_path, r"IMG_99\.jpg: not a JPEG or PNG")


def test_a_picture_too_few_or_another_displays_number_is_refused(tmp_path):
    photograph_all(tmp_path / "a")
    assert_refused(tmp_path, "display phone has 44 patterns", DISPLAYS["phone"])
    (tmp_path / "a" / "IMG_99.jpg").unlink()
    count = len(patterns(DISPLAY.eia_shape))
    assert_refused(tmp_path, f"a: {count - 1} pictures, .* has {count} patterns")


def test_patterns_of_a_larger_panel_with_as_many_bits_are_refused(tmp_path):
    photograph_all(tmp_path / "a")
    smaller = small_display(16, 12, 17)
    assert len(patterns(smaller.eia_shape)) == len(patterns(DISPLAY.eia_shape))
    assert_refused(tmp_path, "see columns beyond the panel's 272", smaller)


# -- light ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"gain": 1.6}, r"IMG_95\.jpg: saturated in \d+% of the lit area"),
        ({"gain": 0.01}, r"IMG_95\.jpg: hardly brighter than IMG_96\.jpg"),
        ({"blur": 6.0}, "blurred"),
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
    ("order", "words"),
    [
        (swap(0, 1), "darker than"),
        (lambda paths: paths[::-1], "."),
        (lambda paths: [*paths[1:], paths[0]], "."),
        (lambda paths: [*paths[:4], paths[3], *paths[4:-1]], "not a pattern and its inverse"),
        (swap(2, 4), "not a pattern and its inverse"),
        # A bit and its inverse: half of the panel moves.
        (swap(2, 3), "agree in|in no order|beyond"),
        # Two bits with their inverses.
        (lambda paths: [*paths[:2], *paths[4:6], *paths[2:4], *paths[6:]], "in no order|beyond"),
        # First and third phase, second and fourth: half a period.
        (swap(-3, -1), "agree in"),
        (swap(-4, -3), "not a pattern and its inverse"),
        (lambda paths: [*paths[:2], *paths[18:], *paths[2:18]], "."),
    ],
)
def test_photographs_in_another_order_are_refused(tmp_path, order, words):
    assert_refused(renumbered(tmp_path, order), words)


def test_an_exposure_that_changes_between_a_pattern_and_its_inverse_is_refused(tmp_path):
    def brighter(number: int, light: np.ndarray) -> np.ndarray:
        return light * (1.4 if number == 7 else 1.0)

    photograph_all(tmp_path / "a", change=brighter, gain=0.5)
    assert_refused(tmp_path, r"IMG_101\.jpg and IMG_102\.jpg: are not a pattern and its inverse")
