"""Colours of rays: every way to find sources and to ask for pixels gives the same bits.

`test_colour_of_rays` compares them with an oracle.
"""

from dataclasses import replace

import numpy as np
import pytest

from inim.generators import generate, prepare
from inim.generators.raycast.colour import ColouredRays
from inim.generators.raycast.ray_by_ray import RayByRay
from inim.image.rgbd import RGBD, LayeredRGBD
from tests.generator_cases import DISPLAYS, picture

COLOURS = ["linear", "averaged", "smooth"]


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
    device = DISPLAYS[display]
    for name in ("layers", "random, sparse, odd size"):
        for rgbd in (picture(display, name), random_codes(picture(display, name), opaque=True)):
            size = (device, rgbd.shape, rgbd.pixel_mm)
            generator = prepare(
                device, f"template:colour={colour}:fill=none", shape=rgbd.shape,
                pixel_mm=rgbd.pixel_mm,
            )  # fmt: skip
            alone = [
                ray._replace(generator=RayByRay(*size, "surface", ray.pixel_offset))
                for ray in generator.rays()
            ]
            single = ColouredRays(alone, generator.rays, *size, colour=colour, reads=RGBD)
            assert np.array_equal(generator.generate(rgbd), single.generate(rgbd))


@pytest.mark.parametrize("colour", COLOURS)
def test_masks_and_float_colours_agree_with_the_whole(colour):
    for display in ("odd pixels", "turned"):
        device, rgbd = DISPLAYS[display], picture(display, "hills")
        text = f"template:colour={colour}"
        whole = generate(rgbd, device, text)
        mask = np.random.default_rng(5).random(device.eia_shape) < 0.04
        part = generate(rgbd, device, text, mask=mask)
        assert np.array_equal(part[mask], whole[mask]) and not part[~mask].any()
