"""Layered depth images as values, and in and out of files."""

from dataclasses import replace

import numpy as np
import pytest

from inim.image.files import image
from inim.image.rgbd import Layer, LayeredRGBD
from inim.system.errors import UsageError

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
