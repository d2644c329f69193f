"""Effect of different readings of Eq. 5 and 6 on sources, holes and EIA PSNR of bundled scenes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from inim.display import DISPLAYS
from inim.generators import find_sources
from inim.generators.base import colour_of, hole_fraction
from inim.scores.metrics import psnr_db

_SCENES = Path(__file__).parents[3] / "scenes"
SCENES = ("two_spheres", "amphora", "wine_coin", "tripod", "jade", "ibex", "altar")
_MATCHINGS = ("matrix", "ray")
#: Options of `wang2024`. The first is the default, to which the others are compared.
_OPTIONS = ("", ":rounding=up", ":step_pixel=scene")
_PIXELS_PER_PITCH = 5
_SAMPLES = 16
# Share of the array that the relic fills.
_SHARE = 0.85


def bench_readings(scenes: Sequence[str] = SCENES) -> list[dict[str, Any]]:
    """Generate EIAs with each reading on each scene, for the nominal display.

    `changed` is the share of the lensed panel pixels whose source differs from the default reading
    with the same matching; `eia_psnr_db` is against the ground-truth EIA.
    """
    from inim.render.ground_truth import capture, pickup
    from inim.render.scene import open_scene
    from inim.render.scene_files.file import read_scene_file

    display = DISPLAYS["nominal"]
    results = []
    for scene in scenes:
        fitted = open_scene(read_scene_file(_SCENES / f"{scene}.xml"), display, _SHARE)
        rgbd = capture(fitted, display, pixels_per_pitch=_PIXELS_PER_PITCH, spp=_SAMPLES, seed=1)
        truth = pickup(fitted, display, spp=_SAMPLES, seed=2).image
        for matching in _MATCHINGS:
            names = [f"wang2024:matching={matching}{option}" for option in _OPTIONS]
            by_name = {name: find_sources(rgbd, display, name) for name in names}
            for name, sources in by_name.items():
                differs = sources != by_name[names[0]]
                results.append(
                    {
                        "scene": scene,
                        "name": name,
                        "changed": float(np.mean(differs[display.lensed])),
                        "hole_fraction": hole_fraction(sources),
                        "eia_psnr_db": psnr_db(truth, colour_of(sources, rgbd)),
                    }
                )
    return results
