"""Compare four rays per pixel with one, under conditions of viewing.

    python -m reports.rays.run scenes/*.xml MORE.xml ... -o reports/rays

Views from the centre, both with smooth colours, are scored to the ground-truth view without noise:
on the relic, within a lens of its silhouette, inside, and for an eye that does not resolve lenses:
truth and views are blurred in linear light by a Gaussian with a standard deviation of one lens.
Differences have 95 % intervals.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion, gaussian_filter

from inim.generators import parse_algorithm
from inim.image.noisy_image import NoisyImage
from inim.pipeline.job import setup
from inim.pipeline.plan import make_plan
from inim.pipeline.request import Request
from inim.pipeline.stages.capture import DepthCamera, capture_relic
from inim.pipeline.stages.generation import prepare_generator
from inim.pipeline.stages.ground_truth import render_view
from inim.pipeline.stages.reconstruction import DisplayViews, reconstruct_views
from inim.report.labels import number
from inim.report.study import PagePart, Table
from inim.scores.metrics import relic_region
from inim.scores.regression.scores import difference, view_scores
from inim.system.process.observer import Observer
from reports.study import Results, Study, add_scenes

FOUR, ONE = "template:samples=4:colour=smooth", "template:samples=1:colour=smooth"
_TIMES = 4
_MORE_SAMPLES = f"{_TIMES} times the samples"
#: Lens model and settings by condition.
CONDITIONS: dict[str, tuple[str, dict[str, float]]] = {
    "thick lenses, eye without pupil": ("thick", {}),
    _MORE_SAMPLES: ("thick", {}),
    "pupil of 4 mm": ("thick", {"inim.pupil_mm": 4}),
    "lens sheet as a mesh": ("full", {}),
}
_AREAS = ("relic", "silhouette", "inside")
_UNRESOLVED = "relic, lenses not resolved"
_SCORES = {
    "SSIM": ("ssim_on_relic", 3),
    "PSNR": ("psnr_on_relic_db", 2),
    "FLIP": ("flip_on_relic", 3),
}


def compare_rays(scene: Path, condition: str) -> dict[str, dict[str, list[float]]]:
    """Score of four rays minus that of one, with the ends of its interval, by area and score.

    The last entry is the score of one ray.
    """
    lens_model, settings = CONDITIONS[condition]
    plan = make_plan(Request(
        scene, Path("unused"), algorithms=(FOUR, ONE), viewpoints=("centre",),
        lens_model=lens_model, definitions=settings,
    ))  # fmt: skip
    if condition == _MORE_SAMPLES:
        counts: dict[str, Any] = {name: _TIMES * n for name, n in plan.samples.items()}
        counts["reconstruction_spp"] = _TIMES * plan.settings.reconstruction_spp
        plan = replace(plan, settings=replace(plan.settings, **counts))
    s, (eye,) = plan.settings, plan.viewpoints
    with tempfile.TemporaryDirectory() as folder:
        run, renderer, _ = setup(plan, Path(folder), Observer(), data_only=True)
        source = plan.source(renderer)
        assert isinstance(source, DepthCamera)
        display_views = DisplayViews(plan.viewpoints, plan.optics, renderer, run=run)
        generators = [
            prepare_generator(parse_algorithm(name), source, None, display_views.observed, run=run)
            for name in (FOUR, ONE)
        ]
        capture = capture_relic(source, plan.inputs, run=run)
        truth, relic = render_view(
            source.scene, eye, s.view_pixels_per_lens, (plan.samples["view_spp"],), s.seed, run=run
        )
        eias = [generate(capture).eia for generate in generators]
        views = [reconstruct_views("", eia, display_views, run=run)[eye.name] for eia in eias]
    lens_px = s.view_pixels_per_lens
    images, regions = [truth, *views], _regions(relic, lens_px)
    scores = {area: _differences(images, region) for area, region in regions.items()}
    blurred = [_blurred(image, lens_px) for image in images]
    return scores | {_UNRESOLVED: _differences(blurred, regions["relic"])}


def _differences(images: Sequence[NoisyImage], region: np.ndarray) -> dict[str, list[float]]:
    """Differences of two views, given after the truth, in a region."""
    truth, *views = images
    of_four, of_one = (view_scores(truth, view, region) for view in views)
    differences = {}
    for name, (key, _) in _SCORES.items():
        value, ends = difference(of_four[key], of_one[key])
        differences[name] = [round(float(v), 5) for v in (value, *ends, of_one[key].value)]
    return differences


def _blurred(image: NoisyImage, lens_px: int) -> NoisyImage:
    """An image as seen by an eye that does not resolve lenses."""
    parts = np.stack(image.halves()) if image.replicates is None else image.replicates
    return NoisyImage.from_parts(gaussian_filter(parts, (0, lens_px, lens_px, 0)))


def _regions(relic: np.ndarray, lens_px: int) -> dict[str, np.ndarray]:
    """Regions of a view by area: the relic's, and its parts within a lens of the silhouette."""
    region, square = relic_region(relic), np.ones((2 * lens_px + 1,) * 2, bool)
    silhouette = binary_dilation(relic, square) & ~binary_erosion(relic, square)
    masks = (region, region & silhouette, region & ~silhouette)
    return dict(zip(_AREAS, masks, strict=True))


def page(results: Results) -> tuple[list[str], list[PagePart]]:
    """Mean over relics by condition and area, then each relic."""
    by_condition: dict[str, dict[str, Any]] = {}
    for case, scores in results.items():
        relic, condition = case.split("/")
        by_condition.setdefault(condition, {})[relic] = scores
    remarks = [
        f"Score of `{FOUR}` minus that of `{ONE}`, to the truth; then that of one ray. Above 0, "
        "four rays are better, except in FLIP.",
        "Lenses not resolved: truth and views are blurred in linear light by a Gaussian with a "
        "standard deviation of one lens.",
    ]
    means = [
        [condition, area, *(_cell([*of_relics.values()], area, name) for name in _SCORES)]
        for condition, of_relics in by_condition.items()
        for area in (*_AREAS, _UNRESOLVED)
    ]
    tables = [Table("Four rays minus one: mean", ["condition", "area", *_SCORES], means)]
    for condition, of_relics in by_condition.items():
        order = sorted(of_relics.items(), key=lambda item: item[1]["relic"]["SSIM"][0])
        rows = [[r, *(_cell([v], "relic", name) for name in _SCORES)] for r, v in order]
        tables.append(Table(f"Four rays minus one: {condition}", ["relic", *_SCORES], rows))
    return remarks, [PagePart("rays", "Four rays and one", "", tables)]


def _cell(scores: Sequence[Any], area: str, name: str) -> str:
    """Mean difference with its interval, and the mean score of one ray."""
    columns = zip(*(score[area][name] for score in scores), strict=True)
    value, low, high, of_one = (number(fmean(column), _SCORES[name][1]) for column in columns)
    return f"{value} [{low}, {high}]; {of_one}"


STUDY = Study(
    "reports.rays.run", "Four rays per pixel and one", __doc__, add_scenes,
    lambda args: {
        f"{scene.stem}/{condition}": {"scene": scene, "condition": condition}
        for condition in CONDITIONS
        for scene in args.scenes
    },
    compare_rays, page,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(STUDY.main())
