"""Photographs with depth inside: each format, the same way up, and a line for each damage."""

import io
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from inim.apps.own_picture.depth_photo import read_depth_photo
from inim.apps.own_picture.depth_photo.codes import rotate_upright
from inim.system.errors import FileError
from tests.depth_photographs import (
    EXTENDED,
    RDF,
    apple_jpeg,
    apple_xml,
    dynamic,
    edited,
    gdepth,
    heic,
    picture,
    room,
    segment,
    with_segments,
    with_xmp,
)

COLOR, CODES = room()
SMALL = np.ascontiguousarray(CODES[::2, ::2])
DEPTH_PNG = picture(SMALL, "PNG")
#: Of a JPEG at its best; chroma is rounded on the way there and back.
JPEG_CODES = 3


def read_photo(tmp_path: Path, data: bytes, name="photo.jpg"):
    (tmp_path / name).write_bytes(data)
    return read_depth_photo(tmp_path / name)


def inverse(codes, near, far, most=255):
    """GDepth's own words for RangeInverse."""
    v = codes.astype(np.float64) / most
    return far * near / (far - v * (far - near))


def linear(codes, near, far, most=255):
    return near + codes.astype(np.float64) / most * (far - near)


WRITERS = {"gdepth": gdepth, "dynamic": dynamic}
UNITS = {"gdepth": "m", "dynamic": "Meters"}


@pytest.mark.parametrize("kind", WRITERS)
@pytest.mark.parametrize(("form", "closed"), [("RangeInverse", inverse), ("RangeLinear", linear)])
@pytest.mark.parametrize("most", [255, 65535])
def test_near_and_far_give_the_distances_of_the_closed_form(tmp_path, kind, form, closed, most):
    codes = SMALL if most == 255 else SMALL.astype(np.uint16) * 257
    metadata = {"Format": form, "Near": 0.4, "Far": 6, "Units": UNITS[kind]}
    data = WRITERS[kind](picture(COLOR), picture(codes, "PNG"), **metadata)
    photo = read_photo(tmp_path, data)
    assert photo.values.has_unit
    assert not photo.values.near_is_large
    np.testing.assert_allclose(photo.values.depth, 1000 * closed(codes, 0.4, 6, most), rtol=1e-6)
    assert np.abs(photo.color.astype(int) - COLOR).max() <= JPEG_CODES
    assert photo.notes[0].endswith("metric")


@pytest.mark.parametrize("units", [None, "None", "Diopters"])
def test_depth_without_a_unit_is_relative_and_marked_so(tmp_path, units):
    photo = read_photo(tmp_path, gdepth(picture(COLOR), DEPTH_PNG, Units=units, Near=2, Far=9))
    assert not photo.values.has_unit
    assert photo.values.near_is_large
    np.testing.assert_allclose(1 / photo.values.depth, inverse(SMALL, 2, 9), rtol=1e-5)
    assert "relative, no millimetres" in photo.notes[0]
    assert ("not given" in photo.notes[0]) == (units is None)


def test_parts_of_extended_metadata_are_joined_in_any_order(tmp_path):
    for order in (1, -1):
        data = gdepth(picture(COLOR), DEPTH_PNG, extended=order, Units="m")
        assert data.count(EXTENDED) > 3
        depth = read_photo(tmp_path, data).values.depth
        np.testing.assert_allclose(depth, 1000 * inverse(SMALL, 1, 4), rtol=1e-6)


@pytest.mark.parametrize("order", "<>")
def test_apple_s_disparity_is_found_among_the_pictures_of_a_jpeg(tmp_path, order):
    depth = picture(SMALL)
    photo = read_photo(tmp_path, apple_jpeg(picture(COLOR), depth, apple_xml(), order))
    codes = np.asarray(Image.open(io.BytesIO(depth))).astype(float)
    np.testing.assert_allclose(photo.values.depth, 0.5 + codes / 255 * 2, rtol=1e-6)
    assert photo.values.near_is_large
    assert "accuracy relative: relative" in photo.notes[0]


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", ["gdepth", "dynamic", "apple", "heic"])
def test_colour_depth_and_camera_are_rotated_equally(tmp_path, kind, orientation):
    camera = (100, 60, 40, 128, 96)
    jpeg = picture(COLOR, orientation=orientation)
    if kind == "heic":
        pytest.importorskip("pillow_heif")
        data = heic(COLOR, SMALL, apple_xml(camera=camera), orientation)
    elif kind == "apple":
        data = apple_jpeg(jpeg, picture(SMALL), apple_xml(camera=camera))
    else:
        data = WRITERS[kind](jpeg, DEPTH_PNG)
    photo = read_photo(tmp_path, data, f"photo.{kind}")
    np.testing.assert_allclose(photo.color, rotate_upright(COLOR, orientation), atol=JPEG_CODES)
    # Red is the code: depth has to be where its colour is.
    red = photo.color[::2, ::2, 0].astype(float)
    depth = photo.values.depth
    assert depth.shape == red.shape
    order = np.corrcoef(red.ravel(), depth.ravel())[0, 1]
    assert abs(order) > 0.9
    stored = rotate_upright(SMALL, orientation).astype(float)
    assert abs(np.corrcoef(stored.ravel(), depth.ravel())[0, 1]) > abs(order) - 0.01
    if kind in ("apple", "heic"):
        # The camera's middle goes where the pixel under it goes.
        mark = np.zeros((96, 128))
        mark[40, 60] = 1
        y, x = np.argwhere(rotate_upright(mark, orientation))[0]
        assert photo.camera is not None
        assert (photo.camera.cx, photo.camera.cy) == (
            pytest.approx(x, abs=0.51),
            pytest.approx(y, abs=0.51),
        )


JPEG = picture(COLOR)
BOMB = '<!DOCTYPE a [<!ENTITY b "bbbb"><!ENTITY c "&b;&b;&b;">]>' + RDF.format("&c;")
HEADER = b"IHDR" + struct.pack(">IIBBBBB", 13_000, 13_000, 16, 0, 0, 0, 0)
HUGE = DEPTH_PNG[:12] + HEADER + struct.pack(">I", zlib.crc32(HEADER)) + DEPTH_PNG[33:]
APPLE = apple_jpeg(JPEG, picture(SMALL), apple_xml())
DAMAGES = {
    "no depth": (JPEG, "no depth inside"),
    "another kind": (b"GIF89a" + bytes(50), "neither HEIC nor JPEG"),
    "empty": (b"", "neither HEIC nor JPEG"),
    "entities": (with_xmp(JPEG, BOMB), "DOCTYPE, which is refused"),
    "broken XML": (with_xmp(JPEG, "<x:xmpmeta>"), "XMP metadata are damaged"),
    "wide XML": (
        gdepth(JPEG, DEPTH_PNG, extended=1).replace(b"Near=", b"Nope="),
        "GDepth:Near of its depth is missing",
    ),
    "near beyond far": (
        gdepth(JPEG, DEPTH_PNG, Near=5, Far=2),
        "an invalid range from Near 5 to Far 2",
    ),
    "far infinite": (gdepth(JPEG, DEPTH_PNG, Far="inf"), "GDepth:Far of its depth is 'inf'"),
    "format": (gdepth(JPEG, DEPTH_PNG, Format="RangeOther"), "GDepth:Format 'RangeOther'"),
    "base64": (
        edited(gdepth(JPEG, DEPTH_PNG), b'Data="iVBOR', b'Data="iVBO'),
        "GDepth:Data is not base64",
    ),
    "no picture": (gdepth(JPEG, b"nonsense"), "its depth is not JPEG or PNG"),
    "huge": (gdepth(JPEG, HUGE), "unfolds from"),
    "coloured": (gdepth(JPEG, picture(COLOR, "PNG")), "is coloured"),
    "extension cut": (
        gdepth(JPEG, DEPTH_PNG, extended=1).replace(b"xmp/extension/", b"xmp/extensioX/", 1),
        "its extended XMP metadata have",
    ),
    "cut off": (dynamic(JPEG, DEPTH_PNG)[:-10], "truncated: .* bytes of depth"),
    "not listed": (dynamic(JPEG, DEPTH_PNG, uri="other"), "is missing from its directory"),
    "length": (
        edited(dynamic(JPEG, DEPTH_PNG), b"<Item:Length>", b"<Item:Length>-"),
        "Item:Length '-17' is not a size",
    ),
    "length beyond": (
        edited(dynamic(JPEG, DEPTH_PNG), b"<Item:Length>", b"<Item:Length>99999999"),
        "truncated: .* bytes of depth",
    ),
    "segmentation": (dynamic(JPEG, DEPTH_PNG, ItemSemantic="Segmentation"), "no depth inside"),
    "no end": (JPEG[:-2], "no end marker, as it is truncated"),
    "segment": (JPEG[:2] + b"\xff\xe1\xff\xff", "ends beyond the file"),
    "segments": (with_segments(JPEG, segment(0xE5, b"") * 10_001), "more than 10000 segments"),
    "pictures cut": (APPLE[:-20], "truncated: an image of"),
    "list": (APPLE.replace(b"MPF\0MM", b"MPF\0XX"), "list of images .MPF. is damaged"),
    "list beyond": (
        APPLE.replace(b"MM\0*\0\0\0\x08", b"MM\0*\xff\xff\xff\x08"),
        "list of images .MPF. is damaged",
    ),
    "disparity": (
        apple_jpeg(JPEG, picture(SMALL), apple_xml(least=3, most=1)),
        "disparity has an invalid range from 3 to 1",
    ),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_each_damage_has_its_line(tmp_path, name):
    data, says = DAMAGES[name]
    with pytest.raises(FileError, match=says) as caught:
        read_photo(tmp_path, data)
    assert "photo.jpg" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_damaged_heic_has_its_line(tmp_path):
    """Cut off, without its depth, with damaged EXIF, or of a size that it does not hold."""
    pytest.importorskip("pillow_heif")
    data = heic(COLOR, SMALL, apple_xml())
    tiff, size = b"MM\0*\0\0\0\x08", struct.pack(">II", 128, 96)
    assert data.count(tiff) == data.count(size) == 1
    unreadable = r"photo\.heic: not a readable HEIC"
    for damaged, says in (
        *((data[:cut], unreadable) for cut in (20, 100, 700, len(data) - 400)),
        (data.replace(b"auxl", b"xuxl"), "no depth inside"),
        (data.replace(tiff, b"MM\0?\0\0\0\x08"), r"not a readable HEIC \(not a TIFF"),
        (data.replace(size, struct.pack(">II", 30_000, 30_000)), f"unfolds from|{unreadable}"),
    ):
        with pytest.raises(FileError, match=says):
            read_photo(tmp_path, damaged, "photo.heic")


def _stereo_jpeg():
    """Two pictures in the multi-picture format, as stereo cameras write them (CIPA DC-007)."""
    stream = io.BytesIO()
    Image.fromarray(COLOR).save(
        stream, "MPO", save_all=True, append_images=[Image.fromarray(COLOR[:, ::-1])]
    )
    data, pair = stream.getvalue(), struct.pack("<HHI", 0xB002, 7, 32)
    place = data.index(b"MPF\0") + 4
    assert data[place : place + 2] == b"II"
    at = data.index(pair, place) + len(pair)
    entries = place + int.from_bytes(data[at : at + 4], "little")
    words = bytearray(data)
    for entry in (entries, entries + 16):
        words[entry : entry + 3] = (0x020002).to_bytes(3, "little")
    return bytes(words)


def test_a_spatial_photograph_has_its_line(tmp_path):
    """A stereo pair has no depth: the message names both pictures and what to add."""
    expected = "a spatial photograph: it contains a left and a right picture.* --estimate-depth"
    with pytest.raises(FileError, match=expected):
        read_photo(tmp_path, _stereo_jpeg())
    stream = io.BytesIO()  # two pictures, but no pair
    Image.fromarray(COLOR).save(
        stream, "MPO", save_all=True, append_images=[Image.new("RGB", (9, 9))]
    )
    with pytest.raises(FileError, match="no depth inside"):
        read_photo(tmp_path, stream.getvalue())


def test_a_spatial_heic_has_its_line(tmp_path):
    """The group of type `ster` (ISO/IEC 23008-12) is a pair; one of another type is none."""
    pytest.importorskip("pillow_heif")
    plain = heic(COLOR, SMALL, apple_xml()).replace(b"auxl", b"xuxl")
    for kind, expected in ((b"ster", "a spatial photograph"), (b"altr", "no depth inside")):
        group = struct.pack(">I4sIIIII", 28, kind, 0, 1, 2, 1, 2)
        box = struct.pack(">I4sI", 12 + len(group), b"grpl", 0) + group
        with pytest.raises(FileError, match=expected):
            read_photo(tmp_path, plain + box, "photo.heic")
