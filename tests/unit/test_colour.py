"""Colours of rays against a float64 evaluation of their definition in docs/theory/templates.md.

The oracle follows the text pixel by pixel: surfaces, footprints, diffusion, interpolation and mean.
It takes only the sources from the generators, which have oracles of their own.
"""

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from inim.display import Display
from inim.display.pixels import SUBPIXELS as PATTERNS
from inim.display.pixels import pixel_rays
from inim.generators import generate, prepare
from inim.generators.raycast.ray_by_ray import RayByRay
from inim.generators.raycast.supersampling import ColouredRays
from inim.image.color import linear_from_srgb, srgb_from_linear
from inim.image.rgbd import RGBD, LayeredRGBD
from tests.generator_cases import DISPLAYS, picture

COLOURS = ["linear", "averaged", "smooth"]


class Oracle:
    """Light of the rays of a picture, (sources, 4) in float64: red, green, blue and alpha."""

    def __init__(self, rgbd: RGBD, display: Display, colour: str) -> None:
        self.rgbd, self.display, self.colour = rgbd, display, colour
        self.front = np.stack(
            [np.where(layer.covered, layer.front_mm.astype(float), np.nan) for layer in rgbd.layers]
        )
        color = rgbd.palette.reshape(-1, rgbd.color.shape[2])
        if color.dtype == np.uint8:
            rgb = linear_from_srgb(color[:, :3] / 255.0)
            self.light = np.column_stack([rgb, color[:, 3] / 255.0]).astype(float)
        else:
            self.light = np.column_stack([color, np.ones(len(color))]).astype(float)

    def neighbour(self, source: int, down: int, right: int) -> int | None:
        """The neighbour on the same surface as a source, at some rows and columns from it."""
        layer, row, column = np.unravel_index(source, self.front.shape)
        r, c = row + down, column + right
        if not (0 <= r < self.front.shape[1] and 0 <= c < self.front.shape[2]):
            return None
        apart = np.abs(self.front[:, r, c] - self.front[layer, row, column])
        near = apart <= 20 * self.rgbd.pixel_mm * np.hypot(down, right) * (1 + 1e-7)
        if not near.any():
            return None
        nearest = int(np.nanargmin(np.where(near, apart, np.inf)))
        return int(np.ravel_multi_index((nearest, r, c), self.front.shape))

    def averaged(self, width: float, samples: int) -> np.ndarray:
        """Light averaged over the footprints of rays of a sub-pixel of some width."""
        if self.colour == "linear":
            return self.light
        display, light = self.display, self.light.copy()
        present, least = {"averaged": (1 / 12, 0.0), "smooth": (1 / 6, -1 / 6)}[self.colour]
        side = display.pixel_pitch_mm * display.pixel_fill / samples**0.5
        depth = self.front.reshape(-1)
        size = np.abs(np.outer((1.0, width), depth)) * side / display.gap_mm / self.rgbd.pixel_mm
        variance = size**2 / 12 - present
        used, stride = 0.0, 1
        while stride == 1 or (variance > used).any():
            share = np.clip(variance - used, least if stride == 1 else 0.0, stride**2 / 4)
            before = light.copy()
            for source in np.flatnonzero(~np.isnan(depth)):
                for axis, sign in product((0, 1), (-stride, stride)):
                    if share[axis, source] == 0:
                        continue
                    other = self.neighbour(source, *((sign, 0) if axis == 0 else (0, sign)))
                    if other is not None:
                        difference = before[other, :3] - before[source, :3]
                        light[source, :3] += share[axis, source] / 2 / stride**2 * difference
            light = np.maximum(light, 0)
            used, stride = used + stride**2 / 4, 2 * stride
        return light

    def interpolated(self, source: int, u: float, v: float, light: np.ndarray) -> np.ndarray:
        """Light at a column and row near a source."""
        _, row, column = np.unravel_index(source, self.front.shape)
        x, y = np.clip(u - column - 0.5, -0.5, 0.5), np.clip(v - row - 0.5, -0.5, 0.5)
        total, weights = np.zeros(4), 0.0
        for down, right in product((0, 1), repeat=2):
            weight = (abs(y) if down else 1 - abs(y)) * (abs(x) if right else 1 - abs(x))
            step = (down * (1 if y > 0 else -1), right * (1 if x > 0 else -1))
            pixel = source if step == (0, 0) else self.neighbour(source, *step)
            if pixel is not None:
                total, weights = total + weight * light[pixel], weights + weight
        return total / weights


def expected(made: Any, oracle: Oracle, pixels: np.ndarray) -> np.ndarray:
    """Mean light and alpha of some panel pixels, (n, 4)."""
    rgbd, display = oracle.rgbd, oracle.display
    mean = np.zeros((len(pixels), 4))
    rays = made.rays()
    for channels in dict.fromkeys(ray.channels for ray in rays):
        group = [ray for ray in rays if ray.channels == channels]
        width = 1.0 if len(channels) == 3 else float(PATTERNS[display.subpixels][channels[0]].width)
        light = oracle.averaged(width, len(group))
        for ray in group:
            sources = ray.generator.sources(rgbd)
            offset = (float(ray.pixel_offset[0]), float(ray.pixel_offset[1]))
            lines = pixel_rays(display, slice(0, display.eia_shape[0]), offset)
            x0, y0, dx, dy = np.broadcast_arrays(lines.x0, lines.y0, lines.slope_x, lines.slope_y)
            for n, at in enumerate(map(tuple, pixels)):
                source = int(sources[at])
                if source < 0:
                    continue
                z = oracle.front.reshape(-1)[source]
                shown = light[source]
                if oracle.colour != "averaged":
                    u = (x0[at] + dx[at] * z) / rgbd.pixel_mm + rgbd.shape[1] / 2
                    v = rgbd.shape[0] / 2 - (y0[at] + dy[at] * z) / rgbd.pixel_mm
                    scaled = light.copy()
                    if oracle.colour == "smooth":
                        scaled[:, :3] = np.sqrt(scaled[:, :3])
                    shown = oracle.interpolated(source, u, v, scaled)
                    if oracle.colour == "smooth":
                        shown = np.append(shown[:3] ** 2, shown[3])
                mean[n, list(channels)] += shown[list(channels)] / len(group)
                mean[n, 3] += shown[3] / len(group) * len(channels) / 3
    return mean


CASES = [
    ("template", "odd pixels", "hills", 4), ("template", "odd pixels", "layers", 1),
    ("template", "phone", "random, sparse, odd size", 4), ("template", "virtual", "hills", 2),
    ("template", "turned", "hills", 4), ("template", "stripes", "hills", 2),
    ("layered", "odd pixels", "layers", 4), ("layered", "phone", "layers", 2),
    ("template", "both sides", "spikes", 4),
]  # fmt: skip


@pytest.mark.parametrize("colour", COLOURS)
@pytest.mark.parametrize(("algorithm", "display", "name", "samples"), CASES)
def test_colours_are_those_of_the_definition(algorithm, display, name, samples, colour):
    shown, linear = DISPLAYS[display], picture(display, name)
    text = f"{algorithm}:samples={samples}:colour={colour}:fill=none"
    lensed = np.argwhere(shown.lensed)
    pixels = lensed[np.random.default_rng(3).choice(len(lensed), min(80, len(lensed)), False)]
    size: dict[str, Any] = {"shape": linear.shape, "pixel_mm": linear.pixel_mm}
    made = prepare(shown, text, **size)
    light = expected(made, Oracle(linear, shown, colour), pixels)
    assert light[:, :3].max() > 0.05 and len(np.unique(light)) > 50, "or the test says little"
    eia = made.generate(linear)[tuple(pixels.T)]
    assert np.abs(eia - light[:, :3]).max() < 1e-4
    for opaque in (True, False):
        coded = random_codes(linear, opaque=opaque)
        light = expected(made, Oracle(coded, shown, colour), pixels)
        codes = made.generate(coded)[tuple(pixels.T)].astype(float)
        exact = np.column_stack([srgb_from_linear(np.minimum(light[:, :3], 1)), light[:, 3]])
        assert np.abs(codes - 255 * exact).max() < 1, "more than one code"


def random_codes(rgbd: RGBD, *, opaque: bool) -> RGBD:
    """The same surfaces in random sRGB codes."""
    random = np.random.default_rng(2)

    def codes() -> np.ndarray:
        color = random.integers(0, 256, (*rgbd.shape, 4)).astype(np.uint8)
        if opaque:
            color[..., 3] = 255
        return color

    if not isinstance(rgbd, LayeredRGBD):
        return RGBD(codes(), rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm)
    deeper = tuple(replace(layer, color=codes()) for layer in rgbd.deeper)
    return LayeredRGBD(codes(), rgbd.depth_mm, rgbd.covered, rgbd.pixel_mm, rgbd.back_mm, deeper)


@pytest.mark.parametrize("colour", ["nearest", *COLOURS])
@pytest.mark.parametrize("display", ["odd pixels", "three strips", "phone", "stripes", "moved"])
def test_colours_of_tables_are_those_of_single_rays(display, colour):
    """Bit for bit."""
    shown = DISPLAYS[display]
    for name in ("layers", "random, sparse, odd size"):
        for rgbd in (picture(display, name), random_codes(picture(display, name), opaque=True)):
            size = (shown, rgbd.shape, rgbd.pixel_mm)
            made = prepare(
                shown, f"template:colour={colour}:fill=none", shape=rgbd.shape,
                pixel_mm=rgbd.pixel_mm,
            )  # fmt: skip
            alone = [
                ray._replace(generator=RayByRay(*size, "surface", ray.pixel_offset))
                for ray in made.rays()
            ]
            single = ColouredRays(alone, made.rays, *size, colour=colour)
            assert np.array_equal(made.generate(rgbd), single.generate(rgbd))


@pytest.mark.parametrize("colour", COLOURS)
def test_masks_and_float_colours_agree_with_the_whole(colour):
    for display in ("odd pixels", "turned"):
        shown, rgbd = DISPLAYS[display], picture(display, "hills")
        text = f"template:colour={colour}"
        whole = generate(rgbd, shown, text)
        mask = np.random.default_rng(5).random(shown.eia_shape) < 0.04
        part = generate(rgbd, shown, text, mask=mask)
        assert np.array_equal(part[mask], whole[mask]) and not part[~mask].any()
