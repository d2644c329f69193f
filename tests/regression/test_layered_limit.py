"""How good a picture is that knows what lies behind its front surface.

Expected behaviour: on the four relics, captured as validation does by default, and on the two
spheres that show the limit of one layer (`test_single_layer_limit`), captured finely, `layered` at
four samples a pixel comes within 1.5 dB of the noise floor of the ground-truth EIA, and passes
`template` on the same picture by far. The noise floor is the score of one half of a validation's
samples against the other.

The spheres have hardly any noise: their floor is that of 32 random samples at the edges, which
four samples reach only where the picture's own pixels are small beside them.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from inim import metrics
from inim.display import DISPLAYS
from inim.generators import generate
from inim.settings import Settings
from tests.conftest import scene_text, sphere

SCENES = Path(__file__).parents[2] / "scenes"
NOMINAL = DISPLAYS["nominal"]
CLOSE_DB = 1.5
# What layers gain over one layer at the least; on the relics it is 5.4 to 9 dB.
GAIN_DB = 4.0


def scores(fitted, *, per_pitch):
    """EIA PSNR of the noise floor, of `layered` and of `template`."""
    from inim.kernel.ground_truth import capture_layers, pickup
    from inim.kernel.peel import peel

    truth = pickup(fitted, NOMINAL, spp=Settings().eia_spp, seed=1)
    peeled = peel(fitted, NOMINAL, pixels_per_pitch=per_pitch)
    assert peeled.cut_share == 0
    rgbd = capture_layers(fitted, peeled, spp=Settings().capture_spp, seed=3)
    made = {name: generate(rgbd, NOMINAL, name, samples=4) for name in ("layered", "template")}
    floor = metrics.psnr_db(truth.first, truth.second)
    return floor, *(metrics.psnr_db(truth.image, eia) for eia in made.values())


@pytest.mark.slow
@pytest.mark.usefixtures("renderer")
@pytest.mark.parametrize("name", ["amphora", "wine_coin", "tripod", "jade"])
def test_relics_come_within_the_noise_of_the_truth(name):
    from inim.kernel.scene import open_scene
    from inim.scene_file import read_scene_file

    fitted = open_scene(read_scene_file(SCENES / f"{name}.xml"), NOMINAL, 0.85)
    per_pitch = Settings().capture_pixels_per_pitch
    floor, layered, template = scores(fitted, per_pitch=per_pitch)
    print(f"{name}: floor {floor:.2f} dB, layered {layered:.2f} dB, template {template:.2f} dB")
    assert layered > floor - CLOSE_DB
    assert layered > template + GAIN_DB


@pytest.mark.slow
def test_two_spheres_come_within_the_noise_of_the_truth(open_fitted):
    near, far = sphere((5, 2, 8), 3.5, "0.2,0.5,0.8"), sphere((-4, -1, 0), 6, "0.8,0.3,0.2")
    fitted = open_fitted(scene_text(near, far), NOMINAL)
    floor, layered, template = scores(fitted, per_pitch=32)
    print(f"spheres: floor {floor:.2f} dB, layered {layered:.2f} dB, template {template:.2f} dB")
    assert layered > floor - CLOSE_DB
    assert layered > template + GAIN_DB
