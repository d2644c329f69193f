"""Regressions planted between a run and its verdict.

Expected behaviour: each is found, in the row that names it, and nothing but samples changed by a
twentieth, or another seed, is ever found: 0 false alarms in 30 repeats.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inim.generators import prepare
from inim.image.noisy_image import NoisyEIA, NoisyImage
from inim.image.rgbd import RGBD
from inim.pipeline.baseline import collect_statistics
from inim.pipeline.evaluation import Evaluation
from inim.pipeline.output import Images
from inim.pipeline.plan import make_plan
from inim.pipeline.request import Request
from inim.pipeline.stages.generation import GeneratedEIA, ReferenceOutput
from inim.pipeline.stages.ground_truth import GroundTruth
from inim.pipeline.stages.reconstruction import DisplayViews, reconstruct_views
from inim.pipeline.stages.scene import Renderer
from inim.pipeline.stages.scoring import (
    compute_truth_statistics,
    score_method,
    score_reference_views,
)
from inim.pipeline.stages.stage import Run
from inim.pipeline.validate import evaluate
from inim.scores.document_parts import Check
from inim.scores.regression.comparison import compare
from inim.scores.regression.fingerprints import fingerprint, reference_input
from inim.scores.regression.run_statistics import RunStatistics
from inim.system.process.observer import Observer

SCENE = Path(__file__).parents[2] / "scenes" / "jade.xml"
SMALL = {
    "lens_columns": 24, "lens_rows": 24, "capture_spp": 16, "eia_spp": 20, "view_spp": 80,
    "reconstruction_spp": 20, "algorithms": "template", "viewpoints": "left,centre,right",
}  # fmt: skip


@dataclass
class Finished:
    """A finished run: what can be planted into it, and what it leaves."""

    evaluation: Evaluation
    renderer: Renderer
    generate: Callable[[RGBD], np.ndarray]

    def statistics(
        self,
        truth: GroundTruth | None = None,
        generate: Callable[[RGBD], np.ndarray] | None = None,
        change_views: Callable[[dict[str, Any]], dict[str, Any]] = lambda views: views,
    ) -> RunStatistics:
        """Statistics of the run with another truth, another generator or other views planted."""
        truth, generate = truth or self.evaluation.truth, generate or self.generate
        plan, capture, run = self.evaluation.plan, self.evaluation.capture, Run()
        first, second = (generate(rgbd) for rgbd in capture.inputs[RGBD].halves)
        eia = NoisyEIA(((first + second) / 2, (first - second) / 2))
        template = GeneratedEIA(eia, None, None, self._reference(generate))
        display_views = DisplayViews(plan.viewpoints, plan.optics, self.renderer, run=run)
        views = change_views(reconstruct_views("template", eia, display_views, run=run))
        results = {"template": score_method("template", template, views, truth, run=run)}
        scores = score_reference_views(truth, run=run)
        changed = dataclasses.replace(
            self.evaluation, truth=truth, reference_scores=scores, results=results
        )
        return collect_statistics(changed, compute_truth_statistics(truth, scores, run=run))

    def _reference(self, generate: Callable[[RGBD], np.ndarray]) -> ReferenceOutput:
        camera, display = self.evaluation.capture.camera, self.evaluation.plan.display
        rgbd = reference_input(display, camera.shape, camera.pixel_mm)
        eia = generate(rgbd)
        return ReferenceOutput(fingerprint(rgbd, eia, display, exact=True), lambda: eia)


def run_of(folder: Path, **settings: Any) -> Finished:
    """A run of the small scene, without a report."""
    definitions = {f"inim.{key}": str(value) for key, value in (SMALL | settings).items()}
    plan = make_plan(Request(SCENE, folder, definitions=definitions))
    renderer = Renderer(plan.request.backend, Observer(), plan.rays_in_flight)
    evaluation = evaluate(plan, renderer, Images(folder, {}, Observer()), Run())
    camera = evaluation.capture.camera
    generator = prepare(plan.display, "template", shape=camera.shape, pixel_mm=camera.pixel_mm)
    return Finished(evaluation, renderer, lambda picture: generator.generate(picture))


@pytest.fixture(scope="module")
def baseline(tmp_path_factory):
    return run_of(tmp_path_factory.mktemp("baseline")).statistics()


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Run with its own seed: a planted error must stand out from fresh noise."""
    return run_of(tmp_path_factory.mktemp("run"), seed=1)


@pytest.fixture(scope="module")
def sound(run):
    """The run with nothing planted."""
    return run.statistics()


def failed(baseline: RunStatistics, candidate: RunStatistics) -> dict[str, Check]:
    return {v.name: v for v in compare(baseline, candidate).checks if not v.passed}


EIA = "eia/template: tiles against the baseline"
PIXELS = "template: changed pixels of the reference input"


def score(view: str, name: str = "SSIM to reference") -> str:
    return f"template/{view}: {name} against the baseline"


def tiles(view: str) -> str:
    return f"truth/{view}: tiles against the baseline"


# --- Nothing planted ----------------------------------------------------------------------------


def test_fresh_seed_is_no_regression(baseline, sound):
    assert failed(baseline, sound) == {}


@pytest.mark.slow
def test_five_percent_fewer_samples_are_no_regression(baseline, tmp_path):
    fewer = {"eia_spp": 19, "view_spp": 76, "reconstruction_spp": 19, "capture_spp": 15}
    assert failed(baseline, run_of(tmp_path, seed=2, **fewer).statistics()) == {}


# --- Generators that went wrong -----------------------------------------------------------------


def pseudoscopic(run: Finished) -> Callable[[RGBD], np.ndarray]:
    """Far is near: depth mirrored in the depth range."""
    low, high = run.evaluation.plan.display.depth_range_mm

    def generate(rgbd: RGBD) -> np.ndarray:
        depth = np.where(rgbd.covered, low + high - rgbd.depth_mm, 0).astype(np.float32)
        return run.generate(dataclasses.replace(rgbd, depth_mm=depth))

    return generate


def edited(run: Finished, edit: Callable[[np.ndarray], np.ndarray]) -> Callable[[RGBD], np.ndarray]:
    return lambda rgbd: np.ascontiguousarray(edit(run.generate(rgbd)), np.float32)


def half_a_pixel(eia: np.ndarray) -> np.ndarray:
    return (eia + np.roll(eia, 1, axis=1)) / 2


def gamma_twice(eia: np.ndarray) -> np.ndarray:
    return np.power(np.maximum(eia, 0), 1 / 2.2)


def one_noisy_lens(eia: np.ndarray) -> np.ndarray:
    """Noise of mean zero, half of white at most, in one of 576 elemental images."""
    noisy = eia.copy()
    lens = noisy[17 * 6 : 17 * 7, 17 * 16 : 17 * 17]
    lens += np.random.default_rng(1).uniform(-0.5, 0.5, (17, 17, 1))
    return noisy


@pytest.mark.parametrize(
    ("plant", "rows"),
    [
        (pseudoscopic, {EIA, PIXELS, score("left"), score("right")}),
        # Against the noise of 16 samples it hides on a smooth relic; the reference input has none.
        (lambda run: edited(run, half_a_pixel), {PIXELS}),
        (lambda run: edited(run, gamma_twice), {EIA, PIXELS, score("centre", "PSNR to reference")}),
        (lambda run: edited(run, one_noisy_lens), {EIA, PIXELS}),
        (
            lambda run: edited(run, lambda eia: 0.97 * eia),
            {PIXELS, score("left", "light on relic red"), score("centre", "light on relic blue")},
        ),
    ],
    ids=["pseudoscopic depth", "half-pixel shift", "gamma twice", "one noisy lens", "3 % darker"],
)
def test_generator_that_went_wrong_is_found(baseline, run, plant, rows):
    failures = failed(baseline, run.statistics(generate=plant(run)))
    assert rows <= failures.keys()
    # The scene itself is as it was.
    assert not [name for name in failures if name.startswith(("truth/", "reference/", "ground"))]
    if rows == {EIA, PIXELS}:
        assert "1 of 576 tiles changed" in failures[EIA].detail
        assert "rows 102 to 118, columns 272 to 288" in failures[EIA].detail


# --- Views and ground truth that went wrong -----------------------------------------------------


def swapped(views: dict[str, Any]) -> dict[str, Any]:
    return views | {"left": views["right"], "right": views["left"]}


def test_swapped_views_of_an_algorithm_are_found_by_name(baseline, run):
    failures = failed(baseline, run.statistics(change_views=swapped))
    assert {score("left"), score("right")} <= failures.keys()
    assert not [name for name in failures if "centre" in name or name.startswith("truth")]


def test_swapped_views_of_the_scene_are_found_by_name(baseline, run):
    truth = dataclasses.replace(run.evaluation.truth, views=swapped(run.evaluation.truth.views))
    failures = failed(baseline, run.statistics(truth=truth))
    assert {tiles("left"), tiles("right")} <= failures.keys()
    assert tiles("centre") not in failures


@pytest.mark.parametrize("edit", [half_a_pixel, gamma_twice], ids=["half a pixel", "gamma twice"])
def test_renderer_that_went_wrong_is_found(baseline, run, edit):
    view = run.evaluation.truth.views["centre"]
    wrong = NoisyImage.from_halves(
        *(edit(half).astype(np.float32) for half in (view.first, view.second))
    )
    truth = dataclasses.replace(
        run.evaluation.truth, views=run.evaluation.truth.views | {"centre": wrong}
    )
    failures = failed(baseline, run.statistics(truth=truth))
    assert tiles("centre") in failures
    assert tiles("left") not in failures
