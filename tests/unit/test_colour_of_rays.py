"""Colours of rays against a float64 oracle that is written from the documentation alone."""

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from inim.display.pixels import SUBPIXELS as PATTERNS
from inim.display.pixels import PixelOffset, exact_length
from inim.generators import HOLE, generate, prepare
from inim.generators.steps import RayGenerator
from inim.image.rgbd import RGBD, Layer, LayeredRGBD
from reports.stress.study.rays import chosen_pixels, rays_over
from tests.colour_oracle import (
    COLOURS,
    Picture,
    averaged_picture,
    code_from_linear,
    linear_from_code,
    ray_values,
)
from tests.generator_cases import DISPLAYS, NON_SEPARABLE, SUBPIXELS, picture, random_codes

_QUARTER = Fraction(1, 4)
_STARTS = {
    1: [(Fraction(0), Fraction(0))],
    2: [(-_QUARTER, -_QUARTER), (_QUARTER, _QUARTER)],
    4: [(a, b) for a in (-_QUARTER, _QUARTER) for b in (-_QUARTER, _QUARTER)],
}
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


def expected_colours(
    generator: RayGenerator, rgbd: RGBD, pixels: np.ndarray, colour: str, samples: int
) -> np.ndarray:
    """Colours of panel pixels, (n, channels) in linear light and alpha, from the oracle."""
    display, layers = generator.display, rgbd.layers
    depth = np.stack([np.where(layer.covered, layer.front_mm, np.nan) for layer in layers]).astype(
        float
    )
    values = np.stack([layer.color for layer in layers]).astype(float)
    if rgbd.color.dtype == np.uint8:
        values /= 255
        values[..., :3] = linear_from_code(values[..., :3])
    opacity = Picture(values[..., 3:], depth, rgbd.pixel_mm)
    fill = exact_length(display.pixel_fill)
    result, starts = np.zeros((len(pixels), values.shape[-1])), []
    sources = {
        (channel, *ray.pixel_offset): of_ray[tuple(pixels.T)]
        for ray, of_ray in generator.sources_of_rays(rgbd)
        for channel in ray.channels
    }
    for place in dict.fromkeys(PATTERNS[display.subpixels]):
        channels = [n for n, p in enumerate(PATTERNS[display.subpixels]) if p == place]
        side = display.pixel_pitch_mm * display.pixel_fill / samples**0.5
        per_mm = side / display.gap_mm / rgbd.pixel_mm
        light = Picture(values[..., channels], depth, rgbd.pixel_mm)
        light = averaged_picture(light, colour, (per_mm, per_mm * float(place.width)))
        for down, right in _STARTS[samples]:
            offset = PixelOffset(down * fill, place.right + right * place.width * fill)
            starts += [(channel, *offset) for channel in channels]
            axes = rays_over(display, rgbd, pixels, offset)
            rays = np.stack([axes.v0, axes.dv, axes.u0, axes.du], axis=1)
            ray = colour, sources[(channels[0], *offset)], rays
            colours = ray_values(light, *ray)
            result[:, channels] += (colours**2 if colour == "smooth" else colours) / samples
            result[:, 3:] += ray_values(opacity, *ray) * len(channels) / 3 / samples
    assert sources.keys() == set(starts)
    return result


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
