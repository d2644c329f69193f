"""Sources, EIA PSNR and SSIM of the middle view, for all readings and each deviation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, partial
from itertools import product
from typing import Any

import numpy as np

from inim.display.viewpoint import parse_viewpoints
from inim.generators import colour_of, find_sources, generate
from inim.generators.registry import DEFAULT
from inim.image.noisy_image import NoisyEIA, NoisyImage
from inim.image.rgbd import RGBD
from inim.pipeline.stages.reconstruction import DisplayViews, Optics, reconstruct_views
from inim.pipeline.stages.scene import Renderer
from inim.pipeline.stages.stage import Run
from inim.scores.metrics import MAIN, psnr_db
from inim.scores.regression.scores import difference, view_scores
from inim.system.process.observer import Observer
from reports.bench.paper.experiments import GU, LI, TEMPLATE
from reports.bench.paper.inputs import DISPLAY, VIEW_PIXELS_PER_LENS, Input
from reports.bench.paper.readings import READINGS, RECOMMENDED, STRICT, Reading, sources_of

#: Deviations from the recommended reading, one at a time. The last is not one of the print.
DEVIATIONS: Mapping[str, Reading] = {
    "Eq. 2: positions count from the corner of a panel pixel": Reading(from_corner=True),
    "Eq. 2: positions are rounded to the nearest picture pixel": Reading(rounded=True),
    "Eq. 3, 5: steps of P_I": Reading(scene_steps=True),
    "Eq. 5: x only": Reading(x_only=True),
    "Eq. 5: no source where it divides by zero": Reading(undefined=True),
    "Eq. 7, 8: consecutive rows and columns": Reading(consecutive=True),
    "Eq. 9, 10: the best match always counts": Reading(always=True),
    "all of Eq. 2, 5 (x only) and 7 to 10: strict print": READINGS[STRICT],
    "not printed: z_len (Eq. 6) rounded up": Reading(up=True),
    "not printed: along the ray": READINGS["along the ray"],
}
PRINTED_DEPTHS = "Eq. 4: depths as printed, clipped to z_max"
_RIVALS = (GU, LI, TEMPLATE)


def measure_quality(picture: Input) -> dict[str, Any]:
    """Measure the sources and scores of all readings and rivals on an input.

    `deviations` are the share of changed sources, and the PSNR minus that of the recommended
    reading. `ssim` and `differences` (of the first method minus the second) have a value and the
    ends of its interval.
    """
    rgbd = picture.rgbd
    sources = {name: sources_of(reading, DISPLAY, rgbd) for name, reading in READINGS.items()}
    sources |= {name: find_sources(rgbd, DISPLAY, name) for name in _RIVALS}
    exact = sources[TEMPLATE]
    methods: dict[str, Callable[[RGBD], np.ndarray]] = {
        name: partial(colour_of, s) for name, s in sources.items()
    }
    methods[DEFAULT] = partial(generate, display=DISPLAY, algorithm=DEFAULT)
    psnr = {name: psnr_db(picture.eia, show(rgbd)) for name, show in methods.items()}
    deviations = {}
    flat = replace(rgbd, depth_mm=np.full(rgbd.shape, np.float32(DISPLAY.depth_range_mm[1])))
    changed = {PRINTED_DEPTHS: sources_of(Reading(), DISPLAY, flat)}
    changed |= {name: sources_of(reading, DISPLAY, rgbd) for name, reading in DEVIATIONS.items()}
    for name, other in changed.items():
        deviations[name] = {
            "changed": float(np.mean(other != sources[RECOMMENDED])),
            "db": psnr_db(picture.eia, colour_of(other, rgbd)) - psnr[RECOMMENDED],
        }
    scores = {
        name: view_scores(picture.view, _view(show, picture), keys=[MAIN.key])[MAIN.key]
        for name, show in methods.items()
    }
    differences: dict[str, dict[str, list[float]]] = {}
    for name, rival in [(GU, LI), *product(READINGS, (GU, LI))]:
        value, ends = difference(scores[name], scores[rival])
        differences.setdefault(name, {})[rival] = [value, *ends]
    return {
        "covered": float(rgbd.covered.mean()),
        "wrong": {name: float(np.mean(s != exact)) for name, s in sources.items()},
        "psnr": psnr,
        "deviations": deviations,
        "ssim": {name: [score.value, *score.interval] for name, score in scores.items()},
        "differences": differences,
    }


@cache
def _views() -> DisplayViews:
    """The view from the middle, through thick lenses."""
    optics = Optics(DISPLAY, "thick", VIEW_PIXELS_PER_LENS, 64, 1)
    eyes = parse_viewpoints("centre", DISPLAY)
    return DisplayViews(eyes, optics, Renderer("auto", Observer()), run=Run())


def _view(show: Callable[[RGBD], np.ndarray], picture: Input) -> NoisyImage:
    """View of the EIA that a method shows; its replicates are those of the picture."""
    observed = None
    if picture.parts:
        observed = np.stack([show(part)[_views().observed] for part in picture.parts])
    eia = NoisyEIA((show(picture.rgbd), None), observed=observed)
    (view,) = reconstruct_views("", eia, _views(), run=Run()).values()
    return view
