"""Colours of rays: every way to find sources and to ask for pixels gives the same bits.

`test_colour_of_rays` compares them with an oracle.
"""

import numpy as np
import pytest

from inim.generators import prepare
from inim.generators.raycast.colour import ColouredRays
from inim.generators.raycast.ray_by_ray import RayByRay
from inim.image.rgbd import RGBD
from tests.generator_cases import DISPLAYS, picture, random_codes

COLOURS = ["linear", "averaged", "smooth"]


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
            rays = generator.rays()
            tracer = RayByRay(*size, "surface", [ray.pixel_offset for ray in rays])
            alone = [
                ray._replace(generator=single)
                for ray, single in zip(rays, tracer.rays(), strict=True)
            ]
            single = ColouredRays(alone, generator.rays, *size, colour=colour, reads=RGBD)
            assert np.array_equal(generator.generate(rgbd), single.generate(rgbd))
