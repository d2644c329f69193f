"""Colour and depth files: what is read, what is noticed, and one line for each way to be wrong."""

import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from inim.apps.own_picture.depth_values import (
    DepthConvention,
    interpret_depth,
    parse_unit,
)
from inim.apps.own_picture.fit import Pinhole, check_pinhole, parse_intrinsics
from inim.apps.own_picture.picture import resample_nearest
from inim.apps.own_picture.picture_files import DepthFile, read_color, read_depth
from inim.image.files.eia_file import write_eia, write_true_size_pdf
from inim.image.files.image import write_exr, write_exr_parts
from inim.system.errors import FileError, UsageError
from tests.conftest import small_display

MM = DepthConvention(1.0)


def room(rows=60, columns=80):
    """A floor that comes nearer towards the bottom, a box in the middle: millimetres."""
    depth = np.tile(np.linspace(3000, 1500, rows)[:, None], (1, columns)).round()
    depth[rows // 3 : 2 * rows // 3, columns // 3 : 2 * columns // 3] = 1200
    return depth.astype(np.uint16)


def write_pfm(path: Path, values, little=True, color=False):
    kind = "<f4" if little else ">f4"
    header = f"{'PF' if color else 'Pf'}\n{values.shape[1]} {values.shape[0]}\n"
    header += f"{'-1.0' if little else '1.0'}\n"
    path.write_bytes(header.encode() + values[::-1].astype(kind).tobytes())


def saved(folder: Path, kind: str) -> tuple[Path, np.ndarray]:
    depth = room()
    path = folder / f"depth.{kind}"
    if kind in ("png", "tif"):
        Image.fromarray(depth).save(path)
    elif kind == "pgm":
        path.write_bytes(b"P5\n80 60\n65535\n" + depth.astype(">u2").tobytes())
    elif kind == "exr":
        write_exr_parts(path, [({"Z": depth}, "depth")], {})
    elif kind == "pfm":
        write_pfm(path, depth.astype(np.float32))
    else:
        np.save(path, depth)
    return path, depth


@pytest.mark.parametrize("kind", ["png", "tif", "pgm", "exr", "pfm", "npy"])
def test_every_kind_of_depth_file_gives_its_numbers_upright(tmp_path, kind):
    path, depth = saved(tmp_path, kind)
    np.testing.assert_array_equal(read_depth(path).values, depth)


def test_bytes_are_swapped_on_request(tmp_path):
    path, depth = tmp_path / "depth.pgm", room()
    path.write_bytes(b"P5\n80 60\n65535\n" + depth.astype("<u2").tobytes())
    np.testing.assert_array_equal(read_depth(path, swap_bytes=True).values, depth)
    np.save(tmp_path / "floats.npy", depth.astype(np.float32))
    with pytest.raises(FileError, match="--swap-bytes is for 16-bit depth"):
        read_depth(tmp_path / "floats.npy", swap_bytes=True)


@pytest.mark.parametrize(
    ("name", "make", "says"),
    [
        ("d.txt", lambda p: p.write_text("1"), "a depth picture is a .png"),
        ("d.png", lambda p: None, "no such file"),
        ("d.png", lambda p: p.write_bytes(b"\x89PNG"), "not a readable picture"),
        ("d.pfm", lambda p: p.write_bytes(b"Pf\n3 3\n-1\n123"), "cut short"),
        ("d.pfm", lambda p: write_pfm(p, np.zeros((2, 2, 3)), color=True), "in colour"),
        ("d.npy", lambda p: np.save(p, np.zeros((2, 2, 2))), "one number per pixel"),
        ("d.npy", lambda p: np.save(p, np.zeros((2, 2), complex)), "complex128"),
        ("d.npy", lambda p: np.save(p, np.array([None])), "not a readable .npy"),
        (
            "d.png",
            lambda p: Image.fromarray(np.eye(3, dtype=np.uint8)[None] * 255).save(p),
            "is coloured",
        ),
        ("d.exr", lambda p: write_exr(p, np.ones((2, 2, 3))), None),
    ],
)
def test_a_bad_depth_file_is_one_line(tmp_path, name, make, says):
    path = tmp_path / name
    make(path)
    if says is None:  # grey saved as colour is readable
        assert read_depth(path).values.shape == (2, 2)
        return
    with pytest.raises(FileError, match=says) as raised:
        read_depth(path)
    assert "\n" not in str(raised.value)
    assert str(raised.value).startswith(str(path))


@pytest.mark.parametrize(
    ("text", "unit_mm"), [("mm", 1), ("cm", 10), ("m", 1000), ("5000", 0.2), ("none", 0)]
)
def test_units_are_words_or_numbers_per_metre(text, unit_mm):
    assert parse_unit(text) == unit_mm


def as_file(values, integer=True):
    return DepthFile(np.asarray(values, np.float32), 65535 if integer else None)


@pytest.mark.parametrize("unit_mm", [1e-3, 10.0, 1000.0])
def test_a_wrong_unit_is_found_by_the_range(unit_mm):
    with pytest.raises(FileError, match=r"d.png: implausible distances, .* by a --depth-unit of"):
        interpret_depth(as_file(room()), DepthConvention(unit_mm), "d.png")
    confirmed = DepthConvention(unit_mm, has_range=True)
    largest = np.nanmax(interpret_depth(as_file(room()), confirmed, "d.png").depth)
    assert largest == pytest.approx(3000 * unit_mm)


@pytest.mark.parametrize(
    "depth", [room(), np.full((20, 30), 2047), 700 + np.indices((40, 60)).sum(axis=0) // 2]
)
@pytest.mark.parametrize("stated", [False, True])
def test_a_wrong_byte_order_is_found_by_the_range(depth, stated):
    """Swapped bytes turn 2047 into 65287."""
    swapped = as_file(depth.astype(np.uint16).byteswap())
    remedy = "no --swap-bytes" if stated else "--swap-bytes for the other byte order"
    with pytest.raises(FileError, match=f"d.png: implausible distances.*{remedy}"):
        interpret_depth(swapped, DepthConvention(1.0, swap_bytes=stated), "d.png")
    own = interpret_depth(as_file(depth), DepthConvention(1.0, swap_bytes=stated), "d.png")
    np.testing.assert_array_equal(own.depth, depth)


def test_depth_that_is_all_missing_is_named():
    for values in (np.zeros((5, 5)), np.full((5, 5), np.nan), np.full((5, 5), -1.0)):
        with pytest.raises(FileError, match="no pixel has a depth"):
            interpret_depth(as_file(values), MM, "d.png")
    with pytest.raises(FileError, match="no pixel has a depth"):
        interpret_depth(as_file(np.full((5, 5), 7)), DepthConvention(1.0, missing=(7.0,)), "d.png")


def test_depth_of_another_size_is_taken_from_the_nearest_pixel_and_never_mixed():
    depth = np.float32([[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(resample_nearest(depth, (4, 6)), depth.repeat(2, 0).repeat(2, 1))
    np.testing.assert_array_equal(resample_nearest(depth.repeat(3, 0).repeat(3, 1), (2, 3)), depth)
    assert set(np.unique(resample_nearest(depth, (5, 7)))) <= set(range(1, 7))


def test_intrinsics_are_four_numbers_of_this_picture():
    assert parse_intrinsics("525,525,319.5,239.5") == Pinhole(525, 525, 319.5, 239.5)
    for text in ("525", "a,b,c,d", "0,525,1,1", "525,525,nan,1", "1,2,3,4,5"):
        with pytest.raises(UsageError, match="--intrinsics"):
            parse_intrinsics(text)
    with pytest.raises(UsageError, match="principal point"):
        check_pinhole(Pinhole(525, 525, 319.5, 239.5), (120, 160))
    with pytest.raises(UsageError, match=r"fx = 4.2 pixels over 640 pixels"):
        check_pinhole(Pinhole(4.2, 4.2, 319.5, 239.5), (480, 640))


def test_a_colour_picture_is_read_upright_and_over_black(tmp_path):
    pixels = np.arange(24, dtype=np.uint8).reshape(2, 4, 3) * 10
    picture = Image.fromarray(pixels)
    exif = Image.Exif()
    exif[0x0112] = 6  # turned by a quarter: rows are columns
    picture.save(tmp_path / "turned.png", exif=exif)
    assert read_color(tmp_path / "turned.png").shape == (4, 2, 3)
    clear = np.dstack([pixels, np.uint8([[255] * 4, [0] * 4])])
    Image.fromarray(clear).save(tmp_path / "clear.png")
    read_back = read_color(tmp_path / "clear.png")
    np.testing.assert_array_equal(read_back[0], pixels[0])
    assert not read_back[1].any()
    grey = np.uint16([[0, 257, 32896, 65535]])
    Image.fromarray(grey).save(tmp_path / "grey.png")
    np.testing.assert_array_equal(read_color(tmp_path / "grey.png")[0, :, 1], [0, 1, 128, 255])
    with pytest.raises(FileError, match="no such file"):
        read_color(tmp_path / "none.jpg")
    (tmp_path / "text.jpg").write_text("no picture")
    with pytest.raises(FileError, match="not a colour picture"):
        read_color(tmp_path / "text.jpg")


def eia_of(display):
    eia = np.random.default_rng(0).random((*display.eia_shape, 3)).astype(np.float32)
    empty = np.zeros(display.eia_shape, bool)
    empty[:3, :5] = True
    eia[empty] = 0
    return eia, empty


def test_a_pdf_page_is_as_large_as_the_panel_and_holds_its_pixels(tmp_path):
    display = small_display(columns=7, rows=5)
    eia, _ = eia_of(display)
    write_true_size_pdf(tmp_path / "sheet.pdf", eia, display.pixel_pitch_mm)
    data = (tmp_path / "sheet.pdf").read_bytes()
    box = data.split(b"/MediaBox [")[1].split(b"]")[0].split()
    points = [float(v) for v in box]
    assert points[:2] == [0, 0]
    assert points[2] == pytest.approx(7 / 25.4 * 72, abs=1e-5)  # 7 mm, 72 points an inch
    assert points[3] == pytest.approx(5 / 25.4 * 72, abs=1e-5)
    stream = data.split(b"stream\n")[3].split(b"\nendstream")[0]
    pixels = np.frombuffer(zlib.decompress(stream), np.uint8).reshape(40, 56, 3)
    write_eia(tmp_path / "eia.png", eia, None, display.pixel_pitch_mm)
    np.testing.assert_array_equal(pixels, np.asarray(Image.open(tmp_path / "eia.png")))
    start = int(data.split(b"startxref\n")[1].split()[0])
    assert data[start : start + 4] == b"xref"
    for number, line in enumerate(data[start:].splitlines()[3:8], 1):
        place = int(line[:10])
        assert data[place:].startswith(b"%d 0 obj" % number)
