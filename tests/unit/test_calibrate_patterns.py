"""The pictures for calibration: what they code, and that files say the same."""

import errno
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from inim.calibration.patterns import PAGE, has_mark, patterns, periods_px, write_patterns
from inim.display import DISPLAYS
from inim.errors import FileError, UsageError
from inim.image.color import linear_from_srgb
from tests.conftest import small_display
from tests.schemas import read_document

DISPLAY = small_display(30, 24, 17)
NAMES = [
    "white",
    *(f"{axis}-phase-{shift:03d}" for axis in ("column", "row") for shift in (0, 120, 240)),
]


def by_name(display):
    return {pattern.name.partition("-")[2]: pattern.codes for pattern in patterns(display)}


@pytest.mark.parametrize("display", [DISPLAYS["phone"], DISPLAY])
def test_there_are_seven_patterns_whose_names_sort_in_the_order_of_display(display):
    names = [pattern.name for pattern in patterns(display)]
    assert names == sorted(names)
    assert [name.partition("-")[2] for name in names] == NAMES


@pytest.mark.parametrize("axis", ["row", "column"])
def test_phases_give_every_pixel_modulo_the_period_in_linear_light(axis):
    codes = by_name(DISPLAY)
    steps = [codes[f"{axis}-phase-{shift:03d}"].ravel() / 255 for shift in (0, 120, 240)]
    light = linear_from_srgb(np.stack(steps))
    assert np.allclose(light.sum(axis=0), 1.5, atol=0.015), "a cosine of linear light"
    wave = np.exp(2j * np.pi / 3 * np.arange(3)) @ light
    period = periods_px(DISPLAY)[0 if axis == "column" else 1]
    size = DISPLAY.eia_shape[axis == "column"]
    centre = np.arange(size) + 0.5 - size / 2
    off = np.angle(wave * np.exp(-2j * np.pi * centre / period)) / (2 * np.pi) * period
    assert np.abs(off).max() < 0.05


def test_lenses_next_to_each_other_are_far_apart_in_phase_and_gamma_s_error_does_not_repeat():
    period = periods_px(DISPLAYS["phone"])[0]
    step = DISPLAYS["phone"].pitch_mm / DISPLAYS["phone"].pixel_pitch_mm / period
    assert 0.3 < step < 0.4, "of a period: as far from 0 as from the step back"
    assert abs(3 * step - 1) > 0.05, "three periods of the error in one of the cosine"


def test_marks_number_the_periods_in_any_view_of_ten_by_seven():
    period = periods_px(DISPLAYS["phone"])
    x, y = np.meshgrid(np.arange(-25, 26), np.arange(-12, 13))
    marks = has_mark(x, y, period)
    views = np.lib.stride_tricks.sliding_window_view(marks, (7, 10)).reshape(-1, 70).astype(float)
    differing = views @ (1 - views).T
    differing += differing.T
    np.fill_diagonal(differing, 70)
    # With two more lenses of each period that show its mark, two periods are four contradictions.
    assert differing.min() >= 2
    assert (has_mark(x, y, period + 3) != marks).mean() > 0.1, "another display has others"


def test_the_white_pattern_is_dark_only_in_the_middle_of_marked_periods():
    white = by_name(DISPLAY)["white"]
    assert set(np.unique(white)) == {0, 255} and (white == 0).mean() < 0.1
    rows, columns = np.nonzero(white == 0)
    for places, period, size in zip(
        (columns, rows), periods_px(DISPLAY), DISPLAY.eia_shape[::-1], strict=True
    ):
        cycles = (places + 0.5 - size / 2) / period
        assert np.abs(cycles - np.rint(cycles)).max() < 0.3


def test_files_are_the_pictures_and_the_document_names_them(tmp_path):
    display = small_display(5, 4, 17)
    page = write_patterns(display, tmp_path / "patterns")
    assert page == tmp_path / "patterns" / PAGE
    document = read_document(page.with_name("patterns.json"))
    assert (document["panel_rows"], document["panel_columns"]) == display.eia_shape
    assert document["pixel_pitch_mm"] == display.pixel_pitch_mm
    expected = patterns(display)
    assert document["pictures"] == sorted(p.name for p in page.parent.glob("*.png"))
    for pattern, name in zip(expected, document["pictures"], strict=True):
        with Image.open(page.with_name(name)) as picture:
            pixels = np.asarray(picture)
        assert np.array_equal(pixels, np.broadcast_to(pattern.codes, display.eia_shape))


def test_another_display_in_the_same_folder_leaves_none_of_the_first_ones_pictures(tmp_path):
    write_patterns(DISPLAYS["phone"], tmp_path)
    write_patterns(small_display(5, 4, 17), tmp_path)
    names = sorted(path.name for path in tmp_path.glob("*.png"))
    assert names == [f"{p.name}.png" for p in patterns(small_display(5, 4, 17))]


def test_pictures_of_another_origin_are_kept_and_named(tmp_path):
    (tmp_path / "1-white.png").write_bytes(b"mine")
    with pytest.raises(FileError, match=r"1-white\.png.*in the way"):
        write_patterns(small_display(5, 4, 17), tmp_path)
    assert (tmp_path / "1-white.png").read_bytes() == b"mine"


def test_panel_and_disk_that_are_too_small_or_large_are_named(tmp_path, monkeypatch):
    with pytest.raises(UsageError, match=r"panel of 70000 x 80 pixels.* at most 32767"):
        write_patterns(small_display(10, 10, 8).replace(lens_columns=8750), tmp_path / "wide")

    def is_full(path: Path, _data: bytes) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", is_full)
    with pytest.raises(FileError, match=r"cannot be written .No space left on device"):
        write_patterns(small_display(3, 2, 5), tmp_path / "full")
    assert not list(tmp_path.iterdir())


def test_the_page_needs_no_network_and_takes_a_displays_name_as_text(tmp_path):
    display = small_display(5, 4, 17, name='<script src="https://example.org">')
    text = write_patterns(display, tmp_path).read_text("utf-8")
    assert "https://example.org" not in text.replace("&quot;https://example.org&quot;", "")
    assert "<script src" not in text
    assert "@" not in text.partition("<script>")[0].partition('<div id="images">')[0]
