"""The four relics on the nominal display.

Expected behaviour: on every scene the exact template comes closer to the ground-truth EIA than the
printed algorithm, and none of its pixels shows another source than the float64 oracle says.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from inim import metrics
from inim.display import DISPLAYS
from inim.generators import colour_of, find_sources
from tests import oracle

SCENES = Path(__file__).parents[2] / "scenes"
NOMINAL = DISPLAYS["nominal"]


@pytest.mark.slow
@pytest.mark.usefixtures("renderer")
@pytest.mark.parametrize("name", ["amphora", "wine_coin", "tripod", "jade"])
def test_template_beats_wang2024_and_has_no_wrong_source(name):
    from inim.render.ground_truth import capture, pickup
    from inim.render.scene import open_scene
    from inim.scene.file import read_scene_file

    fitted = open_scene(read_scene_file(SCENES / f"{name}.xml"), NOMINAL, 0.85)
    rgbd = capture(fitted, NOMINAL, pixels_per_pitch=5, spp=16, seed=1)
    truth = pickup(fitted, NOMINAL, spp=16, seed=2).image
    sources = {a: find_sources(rgbd, NOMINAL, a) for a in ("template", "wang2024")}
    ssim = {a: metrics.ssim(truth, colour_of(s, rgbd)) for a, s in sources.items()}
    assert ssim["template"] > ssim["wang2024"] + 0.05
    expected = oracle.exact_sources(rgbd, NOMINAL)
    assert np.count_nonzero(sources["template"] != expected) == 0
