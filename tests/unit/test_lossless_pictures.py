"""Depth is found in any part of a picture's file, and what is no surface is missing."""

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from inim.apps.own_picture.depth_values import DepthConvention, interpret_depth
from inim.apps.own_picture.options import option_defaults
from inim.apps.own_picture.picture import CameraPicture
from inim.apps.own_picture.picture_files import DepthFile, read_color, read_depth
from inim.system.errors import FileError

SHAPE = (6, 8)
DEPTH = np.linspace(0.5, 0.9, 48, dtype=np.float32).reshape(SHAPE)
COLOR = {name: np.full(SHAPE, 0.1 * k, np.float32) for k, name in enumerate("RGB", 1)}
VECTOR = {f"Normal.{axis}": -DEPTH for axis in "XYZ"}


def exr(path, *parts):
    """An EXR of parts: a name and channels each."""
    OpenEXR.File([OpenEXR.Part({}, dict(channels), name) for name, channels in parts]).write(
        str(path)
    )
    return path


@pytest.mark.parametrize(
    "parts",
    [
        [("rgba", COLOR), ("depth", {"Z": DEPTH})],
        [("ViewLayer.Combined", COLOR), ("ViewLayer.Depth", {"ViewLayer.Depth.Z": DEPTH})],
        [("main", {**COLOR, **VECTOR, "ViewLayer.Depth.Z": DEPTH})],
        [("main", {**COLOR, "dd.T": DEPTH})],
        [("main", {**COLOR, "layer.depth": DEPTH})],
        [("main", {**COLOR, "Depth.V": DEPTH})],
        [("main", {"V": DEPTH})],
        [("main", {"Y": DEPTH, "A": DEPTH})],
        [("main", dict.fromkeys("RGB", DEPTH))],
    ],
)
def test_depth_of_an_exr_is_found_by_the_last_part_of_a_name(tmp_path, parts):
    assert np.array_equal(read_depth(exr(tmp_path / "d.exr", *parts)).values, DEPTH)


@pytest.mark.parametrize("channels", [COLOR, {**COLOR, **VECTOR}, {"u": DEPTH, "v": DEPTH}])
def test_an_exr_without_depth_is_refused(tmp_path, channels):
    with pytest.raises(FileError, match=r"no depth|no channel"):
        read_depth(exr(tmp_path / "d.exr", ("main", channels)))


def test_of_several_depths_the_others_are_named(tmp_path):
    parts = [("left", {"Z": DEPTH}), ("right", {"Z": 2 * DEPTH})]
    file = read_depth(exr(tmp_path / "d.exr", *parts))
    assert np.array_equal(file.values, DEPTH)
    assert "it also has depth in right.Z" in file.notes[0]


def test_colour_of_a_later_part_is_found(tmp_path):
    path = exr(tmp_path / "c.exr", ("depth", {"Z": DEPTH}), ("beauty", COLOR))
    assert read_color(path)[0, 0] == pytest.approx([0.1, 0.2, 0.3])


@pytest.mark.parametrize("background", [1e9, 1e10, 65504.0, 3e38, np.inf])
def test_a_renderers_background_is_missing(tmp_path, background):
    depth = DEPTH.copy()
    depth[:4] = background  # more than half of the picture
    file = read_depth(exr(tmp_path / "d.exr", ("main", {"Z": depth})))
    values = interpret_depth(file, DepthConvention(1000.0), "d.exr")
    assert np.array_equal(np.isnan(values.depth), depth == np.float32(background))
    assert values.depth[5, 7] == pytest.approx(900)
    is_finite = np.isfinite(background)
    assert any("they are missing" in text for text in values.warnings) == is_finite


@pytest.mark.parametrize(
    ("near", "unit_mm", "is_missing"),
    [(1000, 1.0, True), (3000, 10.0, True), (40_000, 0.1, False), (1000, 0.0, False)],
)
def test_the_largest_number_of_16_bits_is_missing(near, unit_mm, is_missing):
    """Unless other distances come near it, or the numbers are not distances."""
    codes = np.full((10, 20), near, np.float32)
    codes[0, 0] = 65535  # less than 1 % of the picture
    convention = DepthConvention(unit_mm, near_is_large=unit_mm == 0, has_range=True)
    values = interpret_depth(DepthFile(codes, 65535), convention, "d.png")
    assert np.isnan(values.depth[0, 0]) == is_missing
    assert any("they are missing" in text for text in values.warnings) == is_missing
    assert not np.isnan(values.depth[1:]).any()


def picture(**options):
    """A camera's picture, read."""
    names = option_defaults() | {"orthographic": True, "depth_unit": "m"} | options
    return CameraPicture(**names).read()


@pytest.mark.parametrize("mode", ["RGBA", "LA", "P"])
def test_transparent_pixels_have_no_surface(tmp_path, mode):
    alpha = np.zeros(SHAPE, np.uint8)
    alpha[2:4, 3:6], alpha[2, 3] = 255, 200
    rgba = np.dstack([np.full((*SHAPE, 3), 90, np.uint8), alpha])
    image = Image.fromarray(rgba)
    if mode == "P":
        image = Image.fromarray(np.where(alpha > 127, 1, 0).astype(np.uint8), "P")
        image.putpalette([0, 0, 0, 90, 90, 90])
        image.info["transparency"] = 0
    image = image if mode == "P" else image.convert(mode)
    image.save(tmp_path / "c.png", **({"transparency": 0} if mode == "P" else {}))
    np.save(tmp_path / "d.npy", DEPTH)
    result = picture(color=tmp_path / "c.png", depth=tmp_path / "d.npy", missing_depth="nearest")
    assert np.array_equal(~np.isnan(result.values.depth), alpha > 127)
    assert result.missing == pytest.approx(1 - 6 / 48)
    # Their own colour, without a dark rim.
    assert (result.color[alpha > 127] == 90).all()


def test_a_transparent_picture_is_refused(tmp_path):
    Image.new("RGBA", SHAPE[::-1]).save(tmp_path / "c.png")
    np.save(tmp_path / "d.npy", DEPTH)
    with pytest.raises(FileError, match=r"pixels are transparent; save it without transparency"):
        picture(color=tmp_path / "c.png", depth=tmp_path / "d.npy")


def test_tinted_depth_is_read_and_painted_depth_is_not(tmp_path):
    grey = np.repeat(np.linspace(0, 240, 48).reshape(*SHAPE, 1).astype(np.uint8), 3, axis=2)
    Image.fromarray(grey + np.array([0, 6, 11], np.uint8)).save(tmp_path / "d.png")
    file = read_depth(tmp_path / "d.png")
    assert "such depth is coarse" in file.notes[0]
    assert np.abs(file.values - grey[..., 0]).max() <= 6
    Image.fromarray(grey * np.array([1, 0, 1], np.uint8)).save(tmp_path / "d.png")
    with pytest.raises(FileError, match=r"is coloured"):
        read_depth(tmp_path / "d.png")


@pytest.mark.parametrize("side", ["right", "left", "top", "bottom"])
def test_depth_in_a_half_of_the_picture(tmp_path, side):
    color = np.full((*SHAPE, 3), (10, 200, 30), np.uint8)
    depth = np.repeat(np.linspace(0, 255, 48).reshape(*SHAPE, 1).astype(np.uint8), 3, axis=2)
    halves = [depth, color] if side in ("left", "top") else [color, depth]
    halves_picture = np.concatenate(halves, axis=1 if side in ("left", "right") else 0)
    Image.fromarray(halves_picture).save(tmp_path / "both.png")
    options = {"depth_unit": "none", "near_is_large": True}
    result = picture(color=tmp_path / "both.png", depth=type(tmp_path)(side), **options)
    assert np.array_equal(result.color, color)
    assert np.array_equal(result.values.depth, depth[..., 0])


@pytest.mark.parametrize("shape", [(1, *SHAPE), (*SHAPE, 1), (1, 1, *SHAPE)])
def test_arrays_of_one_picture(tmp_path, shape):
    np.save(tmp_path / "d.npy", DEPTH.reshape(shape))
    assert np.array_equal(read_depth(tmp_path / "d.npy").values, DEPTH)
    np.savez_compressed(tmp_path / "d.npz", depth=DEPTH.reshape(shape))
    assert np.array_equal(read_depth(tmp_path / "d.npz").values, DEPTH)
    np.savez(tmp_path / "two.npz", a=DEPTH, b=DEPTH)
    with pytest.raises(FileError, match=r"arrays a, b, not one"):
        read_depth(tmp_path / "two.npz")


def test_holes_are_not_filled_from_beneath_transparent_pixels(tmp_path):
    rgba = np.full((*SHAPE, 4), 90, np.uint8)
    rgba[..., 3] = np.where(np.arange(8) < 4, 255, 0)
    Image.fromarray(rgba).save(tmp_path / "c.png")
    depth = np.where(np.arange(8) < 4, 0.5, 0.9).astype(np.float32) * np.ones(SHAPE, np.float32)
    depth[:, 3] = 0
    np.save(tmp_path / "d.npy", depth)
    for rule in ("nearest", "behind", "far"):
        files = {"color": tmp_path / "c.png", "depth": tmp_path / "d.npy"}
        result = picture(**files, missing_depth=rule).values.depth
        assert (result[:, :4] == 500).all()
        assert np.isnan(result[:, 4:]).all()


@pytest.mark.parametrize("quality", [75, 90])
def test_a_jpeg_of_colour_and_depth_is_read_in_spite_of_its_seam(tmp_path, quality):
    color = np.full((48, 64, 3), (200, 20, 30), np.uint8)
    depth = np.repeat(np.linspace(40, 200, 64).astype(np.uint8)[None, :, None], 48, axis=0)
    both_halves = np.concatenate([color, np.repeat(depth, 3, axis=2)], axis=1)
    Image.fromarray(both_halves).save(tmp_path / "c.jpg", quality=quality)
    options = {"depth_unit": "none", "near_is_large": True}
    result = picture(color=tmp_path / "c.jpg", depth=type(tmp_path)("right"), **options)
    far = np.abs(result.values.depth[:, 16:] - depth[:, 16:, 0].astype(float))
    assert far.max() < 8


def test_numbers_of_a_pgm_are_those_of_the_file(tmp_path):
    codes = np.rint(DEPTH * 10000).astype(">u2")
    (tmp_path / "d.pgm").write_bytes(b"P5\n# a comment\n8 6\n10000\n" + codes.tobytes())
    assert np.array_equal(read_depth(tmp_path / "d.pgm").values, codes)
    (tmp_path / "d.pgm").write_bytes(b"P5 8 6 100 " + np.arange(48, dtype=np.uint8).tobytes())
    assert np.array_equal(read_depth(tmp_path / "d.pgm").values.ravel(), np.arange(48))


def test_depth_of_other_modes_is_read_or_refused(tmp_path):
    grey = np.repeat(np.linspace(0, 240, 48).reshape(*SHAPE, 1).astype(np.uint8), 3, axis=2)
    Image.fromarray(grey).convert("CMYK").save(tmp_path / "d.jpg", quality=98)
    far = np.abs(read_depth(tmp_path / "d.jpg").values - grey[..., 0].astype(float))
    assert far.max() < 6
    exif = Image.Exif()
    exif[0x0112] = 3  # upside down
    Image.fromarray(grey[..., 0]).save(tmp_path / "r.jpg", quality=100, exif=exif)
    turned = read_depth(tmp_path / "r.jpg").values
    assert np.abs(turned - grey[::-1, ::-1, 0]).max() < 3
    clear = np.dstack([grey[..., 0], np.where(grey[..., 0] > 99, 255, 0).astype(np.uint8)])
    Image.fromarray(clear, "LA").save(tmp_path / "la.png")
    missing = np.isnan(read_depth(tmp_path / "la.png").values)
    assert np.array_equal(missing, grey[..., 0] <= 99)


def test_a_png_of_16_bits_in_colour_is_refused(tmp_path):
    import struct
    import zlib

    def chunk(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    codes = np.repeat(np.arange(48, dtype=">u2").reshape(*SHAPE, 1) + 5900, 3, axis=2)
    rows = b"".join(b"\0" + row.tobytes() for row in codes)
    head = struct.pack(">IIBBBBB", 8, 6, 16, 2, 0, 0, 0)
    (tmp_path / "d.png").write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )  # fmt: skip
    with pytest.raises(FileError, match=r"16 bits in several channels"):
        read_depth(tmp_path / "d.png")


def test_of_several_layers_the_final_ones_are_read(tmp_path):
    other = {f"L.AO.{name}": 9 * pixels for name, pixels in COLOR.items()}
    final = {f"L.Combined.{name}": pixels for name, pixels in COLOR.items()}
    depths = {"L.Denoising Depth.Z": 2 * DEPTH, "L.Depth.Z": DEPTH, "L.Mist.Z": 3 * DEPTH}
    path = exr(tmp_path / "c.exr", ("main", {**other, **final, **depths}))
    assert read_color(path)[0, 0] == pytest.approx([0.1, 0.2, 0.3])
    assert np.array_equal(read_depth(path).values, DEPTH)
    with pytest.raises(FileError, match=r"no channel"):
        read_depth(exr(tmp_path / "m.exr", ("main", {"L.Mist.Z": DEPTH})))


def test_linear_codes_of_a_png_are_honoured(tmp_path):
    from PIL import PngImagePlugin

    info = PngImagePlugin.PngInfo()
    info.add(b"gAMA", (100000).to_bytes(4, "big"))
    codes = np.full((*SHAPE, 3), 128, np.uint8)
    Image.fromarray(codes).save(tmp_path / "c.png", pnginfo=info)
    # Half the light is sRGB code 188.
    assert (read_color(tmp_path / "c.png") == 188).all()
    info = PngImagePlugin.PngInfo()
    info.add(b"gAMA", (45455).to_bytes(4, "big"))
    Image.fromarray(codes).save(tmp_path / "c.png", pnginfo=info)
    assert (read_color(tmp_path / "c.png") == 128).all()


def test_a_number_far_from_all_others_is_named(tmp_path):
    depth = DEPTH.copy()
    depth[:2] = -1e6
    np.save(tmp_path / "d.npy", depth)
    convention = DepthConvention(0.0, near_is_large=True)
    values = interpret_depth(read_depth(tmp_path / "d.npy"), convention, "d.npy")
    assert "use --missing -1e+06" in values.warnings[0]


def test_luminance_and_chroma_of_an_exr_are_colours(tmp_path):
    red, green, blue = 0.5, 0.25, 0.125
    y = 0.2126 * red + 0.7152 * green + 0.0722 * blue
    numbers = {"Y": y, "RY": red / y - 1, "BY": blue / y - 1}
    channels = {name: np.full(SHAPE, number, np.float32) for name, number in numbers.items()}
    path = exr(tmp_path / "yc.exr", ("main", channels))
    assert read_color(path)[3, 5] == pytest.approx([red, green, blue], rel=1e-3)


def test_other_primaries_become_those_of_rec_709(tmp_path):
    # CIE XYZ of Rec. 709's red, of luminance 0.2126 (IEC 61966-2-1).
    xyz = dict(zip("RGB", (0.4124, 0.2126, 0.0193), strict=True))
    channels = {name: np.full(SHAPE, number, np.float32) for name, number in xyz.items()}
    header = {"chromaticities": (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3)}
    OpenEXR.File(header, channels).write(str(tmp_path / "xyz.exr"))
    assert read_color(tmp_path / "xyz.exr")[0, 0] == pytest.approx([1, 0, 0], abs=1e-3)
