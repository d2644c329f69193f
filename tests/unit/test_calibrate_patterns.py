"""The pictures for calibration: what they code, and that files say the same."""

import errno
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from inim.calibration.patterns import CELL, PAGE, PERIOD, bit_count, patterns, write_patterns
from inim.display import DISPLAYS
from inim.errors import FileError, UsageError
from inim.image.color import linear_from_srgb
from tests.conftest import small_display
from tests.schemas import read_document

PANELS = [(1080, 2400), (1088, 1088), (9, 8)]


def by_name(panel):
    return {pattern.name.partition("-")[2]: pattern.codes for pattern in patterns(panel)}


def cells(panel, axis):
    """Gray code along an axis, most significant bit first, as the pictures have it."""
    codes = by_name(panel)
    bits = [name for name in codes if name.startswith(f"{axis}-bit") and "inverse" not in name]
    return np.stack([codes[name].ravel() == 255 for name in bits])


@pytest.mark.parametrize("panel", PANELS)
@pytest.mark.parametrize("axis", ["row", "column"])
def test_gray_codes_are_unique_and_neighbours_differ_in_one_bit(panel, axis):
    code = cells(panel, axis)
    pixels = panel[axis == "column"]
    assert code.shape == (bit_count(pixels), pixels)
    starts = np.arange(0, pixels, CELL)
    for pixel in range(pixels):
        assert (code[:, pixel] == code[:, pixel // CELL * CELL]).all()
    assert (np.count_nonzero(np.diff(code[:, starts].astype(int)), axis=0) == 1).all()
    assert np.unique(code[:, starts], axis=1).shape[1] == len(starts)
    # The coarsest comes first: it changes once.
    assert np.count_nonzero(np.diff(code[0].astype(int))) == (len(starts) > 1)


@pytest.mark.parametrize("panel", PANELS)
def test_each_bit_is_followed_by_its_inverse_and_names_sort_in_the_order_of_display(panel):
    pictures = patterns(panel)
    names = [pattern.name for pattern in pictures]
    assert names == sorted(names)
    assert [name[3:] for name in names[:2]] == ["white", "black"]
    first_row = next(k for k, name in enumerate(names) if "-row-" in name)
    assert all("-row-" in name for name in names[first_row:])
    assert not any("-row-" in name for name in names[:first_row])
    for picture, other in pairwise(pictures):
        if "-bit-" in picture.name and "inverse" not in picture.name:
            assert other.name[3:] == picture.name[3:] + "-inverse"
            assert (picture.codes.astype(int) + other.codes == 255).all()


@pytest.mark.parametrize("axis", ["row", "column"])
def test_phase_and_cell_name_every_pixel_in_linear_light(axis):
    panel = (131, 160)
    codes = by_name(panel)
    steps = [codes[f"{axis}-phase-{shift:03d}"].ravel() / 255 for shift in (0, 90, 180, 270)]
    light = linear_from_srgb(np.stack(steps))
    assert np.allclose(light[0] + light[2], 1, atol=0.01), "a cosine of linear light"
    angle = np.arctan2(light[1] - light[3], light[0] - light[2])
    within = np.mod(angle / (2 * np.pi) * PERIOD, PERIOD)
    centre = np.arange(panel[axis == "column"]) + 0.5
    assert np.allclose(within, np.mod(centre, PERIOD), atol=0.02)


def test_files_are_the_pictures_and_the_document_names_them(tmp_path):
    display = small_display(5, 4, 17)
    page = write_patterns(display, tmp_path / "patterns")
    assert page == tmp_path / "patterns" / PAGE
    document = read_document(page.with_name("patterns.json"))
    assert (document["panel_rows"], document["panel_columns"]) == display.eia_shape
    assert document["pixel_pitch_mm"] == display.pixel_pitch_mm
    expected = patterns(display.eia_shape)
    assert document["pictures"] == sorted(p.name for p in page.parent.glob("*.png"))
    for pattern, name in zip(expected, document["pictures"], strict=True):
        with Image.open(page.with_name(name)) as picture:
            pixels = np.asarray(picture)
        assert np.array_equal(pixels, np.broadcast_to(pattern.codes, display.eia_shape))


def test_another_display_in_the_same_folder_leaves_none_of_the_first_ones_pictures(tmp_path):
    write_patterns(DISPLAYS["phone"], tmp_path)
    write_patterns(small_display(5, 4, 17), tmp_path)
    names = sorted(path.name for path in tmp_path.glob("*.png"))
    assert names == [f"{p.name}.png" for p in patterns(small_display(5, 4, 17).eia_shape)]


def test_pictures_of_another_origin_are_kept_and_named(tmp_path):
    (tmp_path / "00-white.png").write_bytes(b"mine")
    with pytest.raises(FileError, match=r"00-white\.png.*in the way"):
        write_patterns(small_display(5, 4, 17), tmp_path)
    assert (tmp_path / "00-white.png").read_bytes() == b"mine"


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
