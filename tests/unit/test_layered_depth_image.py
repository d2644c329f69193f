"""Layered depth images as values, and in and out of files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from inim.image.files import image
from inim.image.rgbd import RGBD, Layer, LayeredRGBD
from inim.system.errors import FileError, UsageError

ROWS, COLUMNS = 7, 11


def picture(layers=3, seed=3):
    """Random layers, each covering a part of the one before."""
    random = np.random.default_rng(seed)
    covered, top = random.random((ROWS, COLUMNS)) < 0.8, np.full((ROWS, COLUMNS), 30.0)
    parts = []
    for _ in range(layers):
        front = np.where(covered, top - random.random(covered.shape), 0).astype(np.float32)
        back = np.where(covered, front - random.random(covered.shape), 0).astype(np.float32)
        color = random.random((ROWS, COLUMNS, 3)).astype(np.float32)
        parts.append(Layer(color, front, back, covered))
        covered, top = covered & (random.random(covered.shape) < 0.7), back
    first, *deeper = parts
    return LayeredRGBD(
        first.color, first.front_mm, first.covered, 0.2, first.back_mm, tuple(deeper)
    )


@pytest.mark.parametrize("layers", [1, 2, 5])
def test_all_layers_come_back_from_a_file_bit_for_bit(tmp_path, layers):
    rgbd = picture(layers)
    image.write_rgbd(tmp_path / "a.exr", rgbd, {"inim:seed": "7"})
    again = image.read_rgbd(tmp_path / "a.exr")
    assert isinstance(again, LayeredRGBD) and len(again.layers) == layers
    assert again.pixel_mm == rgbd.pixel_mm
    for actual, expected in zip(again.layers, rgbd.layers, strict=True):
        for name in ("color", "front_mm", "back_mm", "covered"):
            assert np.array_equal(getattr(actual, name), getattr(expected, name)), name


def test_a_back_that_never_comes_and_one_layer_survive_a_file(tmp_path):
    rgbd = replace(picture(1), back_mm=np.full((ROWS, COLUMNS), -np.inf))
    image.write_rgbd(tmp_path / "a.exr", rgbd)
    again = image.read_rgbd(tmp_path / "a.exr")
    assert isinstance(again, LayeredRGBD)
    assert (again.back_mm[again.covered] == -np.inf).all()


def test_each_layer_has_named_parts_and_the_first_two_are_a_plain_picture_s(tmp_path):
    import OpenEXR

    rgbd = picture(2)
    image.write_rgbd(tmp_path / "a.exr", rgbd, {"inim:seed": "7"})
    plain = RGBD(rgbd.color, rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm)
    image.write_rgbd(tmp_path / "b.exr", plain)
    parts = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True).parts
    names = [part.name() for part in parts]
    assert names == ["color", "depth", "back", "color.1", "depth.1", "back.1"]
    assert [sorted(p.channels) for p in parts] == [["A", "B", "G", "R"], ["Z"], ["Z"]] * 2
    assert {p.header["inim:layers"] for p in parts} == {"2"}
    assert {p.header["inim:seed"] for p in parts} == {"7"}
    for part in parts[1:3]:
        assert np.array_equal(np.isnan(part.channels["Z"].pixels), ~rgbd.covered)
    alone = OpenEXR.File(str(tmp_path / "b.exr"), separate_channels=True).parts
    assert len(alone) == 2, "a plain picture stays one"
    for layer, other in zip(alone, parts, strict=False):
        assert layer.name() == other.name()
        for name, channel in layer.channels.items():
            same = np.array_equal(channel.pixels, other.channels[name].pixels, equal_nan=True)
            assert same, name


@pytest.mark.parametrize("count", ["3", "0x2", "-1", (1.0, 2.0)])
def test_a_file_with_other_layers_than_declared_is_refused(tmp_path, count):
    image.write_rgbd(tmp_path / "a.exr", picture(2), {"inim:seed": "7"})
    parts = [
        ({**channels}, name)
        for (channels, _), name in zip(
            image._read_parts(tmp_path / "a.exr"),
            ("color", "depth", "back", "color.1", "depth.1", "back.1"),
            strict=True,
        )
    ]
    header = {"inim:pixel_mm": "0.2", "inim:layers": count}
    image.write_exr_parts(tmp_path / "b.exr", parts, header)
    with pytest.raises(FileError, match=r"b\.exr"):
        image.read_rgbd(tmp_path / "b.exr")


def test_layers_that_cannot_be_are_refused_by_number():
    rgbd = picture(2)
    behind = rgbd.deeper[0]
    for wrong, words in (
        (replace(behind, back_mm=behind.front_mm + 1), "layer 1.*back in front"),
        (replace(behind, covered=np.ones((ROWS, COLUMNS), bool)), "layer 1 covers"),
        (replace(behind, color=behind.color[1:]), "layer 1 has"),
        (replace(behind, front_mm=behind.front_mm[:, 1:]), "layer 1: front_mm"),
    ):
        with pytest.raises(UsageError, match=words):
            replace(rgbd, deeper=(wrong,))


def test_the_palette_is_the_colours_of_all_layers_one_below_the_other():
    rgbd = picture(3)
    assert rgbd.palette.shape == (3 * ROWS, COLUMNS, 3)
    for number, layer in enumerate(rgbd.layers):
        assert np.array_equal(rgbd.palette[number * ROWS : (number + 1) * ROWS], layer.color)
