"""Depth is found in any part of a picture's file, and what is no surface is missing."""

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from inim.apps.own_picture.depth_values import DepthConvention, interpret_depth
from inim.apps.own_picture.options import option_defaults
from inim.apps.own_picture.picture import CameraPicture
from inim.apps.own_picture.picture_files import read_color, read_depth
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
    with pytest.raises(FileError, match=r"are transparent"):
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
