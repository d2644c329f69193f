"""Colours of rays: every way to find sources and to ask for pixels gives the same bits.

`test_colour_of_rays` compares them with an oracle.
"""

from dataclasses import replace

import numpy as np
import pytest

from inim.generators import parse_algorithm
from inim.generators.raycast.ray_by_ray import RayByRay
from inim.generators.steps import RayGenerator
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
            template = parse_algorithm(f"template:colour={colour}:fill=none")
            alone = replace(template, prepare=lambda rays, _: RayByRay(rays, "surface").take)
            generator, single = (RayGenerator(way, *size) for way in (template, alone))
            assert np.array_equal(generator.generate(rgbd), single.generate(rgbd))
