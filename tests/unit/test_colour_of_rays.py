"""Colours of rays against a float64 oracle that is written from the documentation alone."""

from typing import Any

import numpy as np
import pytest

from inim.apps.stress.oracles.colours import (
    COLOURS,
    code_from_linear,
    expected_colours,
)
from inim.apps.stress.oracles.rays import chosen_pixels
from inim.generators import HOLE, generate, prepare
from inim.generators.steps import RayGenerator
from inim.image.rgbd import RGBD, Layer, LayeredRGBD
from inim.system.errors import UsageError
from tests.generator_cases import DISPLAYS, NON_SEPARABLE, SUBPIXELS, picture, random_codes

_PIXELS = 100

CASES = [
    *(
        ("template:samples=4", display)
        for display in (
            *("odd pixels", "both sides", "phone", "elemental pitch", "rows closer", "moved"),
            *NON_SEPARABLE,
            *SUBPIXELS,
        )
    ),
    *(
        (f"layered:samples={samples}", display)
        for samples in (1, 2)
        for display in ("odd pixels", "phone", "moved", "hexagonal", "tilted", "pentile, moved")
    ),
    *(
        (algorithm, display)
        for algorithm in ("template:columns=solid:samples=1", "gu2020")
        for display in ("both sides", "elemental pitch", "turned", "stripes, turned")
    ),
    *(
        (algorithm, display)
        for algorithm in ("li2012", "wang2024", "wang2024:matching=ray")
        for display in ("odd pixels", "elemental pitch")
    ),
]


def with_every_colour(cases: list[tuple[str, str]]) -> list[Any]:
    """Every second case with one of the colours in the fast tier; all others in the slow one."""
    return [
        pytest.param(*words, colour, marks=() if is_fast else pytest.mark.slow)
        for row, words in enumerate(cases)
        for column, colour in enumerate(COLOURS)
        for is_fast in (row % 2 == 0 and (row // 2 - column) % 3 == 0,)
    ]


@pytest.mark.parametrize(("algorithm", "display", "colour"), with_every_colour(CASES))
def test_colours_agree_with_the_float64_oracle(algorithm, display, colour):
    device, samples = DISPLAYS[display], int(algorithm.partition("samples=")[2] or 1)
    pixels = chosen_pixels(device, _PIXELS)
    mask = np.zeros(device.eia_shape, bool)
    mask[tuple(pixels.T)] = True
    names = ("layers, odd size",) if "layered" in algorithm else ("hills",)
    for name in names:
        plain = picture(display, name)
        for rgbd in (plain, random_codes(plain)):
            method = f"{algorithm}:colour={colour}:fill=none"
            size = {"shape": rgbd.shape, "pixel_mm": rgbd.pixel_mm}
            generator = prepare(device, method, **size)
            assert isinstance(generator, RayGenerator)
            expected = expected_colours(generator, rgbd, pixels, colour, samples)
            whole = generator.generate(rgbd)
            eia = whole[tuple(pixels.T)]
            if rgbd.color.dtype == np.uint8:
                expected[:, :3] = code_from_linear(np.minimum(expected[:, :3], 1))
                error = np.abs(eia - 255 * expected)
                assert (error <= 1).all()
            else:
                error = np.abs(eia - expected)
                assert (error <= 1e-5 * np.maximum(expected, 0.05)).all()
            masked = prepare(device, method, **size, mask=mask)
            assert isinstance(masked, RayGenerator)
            assert np.array_equal(masked.generate(rgbd), whole * mask[..., None])


@pytest.mark.parametrize("colour", COLOURS)
@pytest.mark.parametrize("algorithm", ["template", "gu2020", "li2012"])
def test_algorithms_of_one_picture_read_no_colours_of_hidden_layers(algorithm, colour):
    display, layered = DISPLAYS["odd pixels"], picture("odd pixels", "layers")
    front = RGBD(layered.color, layered.depth_mm, layered.covered, layered.pixel_mm)
    method = f"{algorithm}:colour={colour}"
    assert np.array_equal(generate(layered, display, method), generate(front, display, method))


def stripes_of_layers(layers: int) -> LayeredRGBD:
    """A surface, which is the last of many layers in every second column."""
    shape, generator = (14, 14), np.random.default_rng(6)
    solids = []
    for layer in range(layers):
        covered = np.zeros(shape, bool)
        covered[:, slice(layer > 0, None, 1 + (layer > 0))] = True
        front = np.full(shape, 20 + 0.01 * (layers - 1 - layer), np.float32)
        front[:, ::2] = 20
        solids.append(Layer(generator.random((*shape, 3), np.float32), front, front, covered))
    first = solids[0]
    return LayeredRGBD(
        first.color, first.front_mm, first.covered, 0.3, back_mm=first.back_mm,
        deeper=tuple(solids[1:]),
    )  # fmt: skip


def test_neighbours_may_be_in_layers_far_away():
    """Expected: interpolation with the deepest of 128 layers; more are refused."""
    device, rgbd = DISPLAYS["odd pixels"], stripes_of_layers(128)
    method, size = "layered:samples=1:colour=linear", {"shape": rgbd.shape, "pixel_mm": 0.3}
    generator = prepare(device, method, **size)
    assert isinstance(generator, RayGenerator)
    sources = generator.sources(rgbd)
    pixels = np.argwhere((sources >= 0) & (sources < rgbd.depth_mm.size) & (sources % 2 == 0))
    assert len(pixels) > 50
    expected = expected_colours(generator, rgbd, pixels[:50], "linear", 1)
    assert np.abs(generator.generate(rgbd)[tuple(pixels[:50].T)] - expected).max() < 1e-5
    with pytest.raises(UsageError, match=r"129 layers; .* use colour=averaged"):
        prepare(device, method, **size).generate(stripes_of_layers(129))


def selected(rgbd: RGBD, rows: np.ndarray, columns: np.ndarray) -> RGBD:
    """Picture of some rows and columns of another, which may repeat."""
    first, *deeper = (
        Layer(*(part[rows][:, columns] for part in (layer.color, layer.front_mm, layer.back_mm,
                                                    layer.covered)))
        for layer in rgbd.layers
    )  # fmt: skip
    front = first.color, first.front_mm, first.covered, rgbd.pixel_mm
    if not isinstance(rgbd, LayeredRGBD):
        return RGBD(*front)
    return LayeredRGBD(*front, back_mm=first.back_mm, deeper=tuple(deeper))


@pytest.mark.parametrize(
    ("display", "colour"),
    with_every_colour([("odd pixels",), ("phone",), ("moved",), ("stripes",)]),
)
def test_fill_shows_the_picture_continued_beyond_its_edge(display, colour):
    device, whole = DISPLAYS[display], picture(display, "layers, odd size")
    rgbd = selected(whole, *(np.arange(n // 4, n - n // 3) for n in whole.shape))
    method = f"layered:samples=4:colour={colour}"
    filled = generate(rgbd, device, method, fill="hidden")
    outside = prepare(device, method, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm, fill="none")
    assert isinstance(outside, RayGenerator)
    # Another margin than the fill's: every margin beyond the reach of rays has the same result.
    reach = max(whole.shape)
    rows, columns = (np.clip(np.arange(-reach, n + reach), 0, n - 1) for n in rgbd.shape)
    continued = selected(rgbd, rows, columns)
    generator = prepare(device, method, shape=continued.shape, pixel_mm=rgbd.pixel_mm, fill="none")
    assert isinstance(generator, RayGenerator)
    complete = np.all([of_ray >= 0 for _, of_ray in generator.sources_of_rays(continued)], axis=0)
    pixels = np.argwhere(complete & (outside.sources(rgbd) == HOLE))
    assert len(pixels) > 20
    expected = expected_colours(generator, continued, pixels, colour, 4)
    error = np.abs(filled[tuple(pixels.T)] - expected)
    assert (error <= 1e-5 * np.maximum(expected, 0.05)).all()
