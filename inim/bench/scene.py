"""The bench on a scene: time against error, one point for each algorithm and setting."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from inim.bench.evaluate import (
    Reference,
    all_scores,
    evaluate,
    make_reference,
    mark_fronts,
    noise_floor,
)
from inim.display import Display
from inim.documents.bench import (
    BenchAlgorithm,
    BenchPicture,
    BenchScene,
    CapturedLayers,
    TimingRecord,
)
from inim.documents.parts import DisplayRecord
from inim.errors import SceneError, UsageError
from inim.generators import algorithm_names, check_algorithm, is_own, properties
from inim.image.noisy_image import NoisyImage
from inim.image.rgbd import RGBD
from inim.pipeline.plan import Plan
from inim.pipeline.stages.capture import DepthCamera, capture_relic
from inim.pipeline.stages.ground_truth import pick_up_truth
from inim.pipeline.stages.reconstruct import reconstruct_views
from inim.pipeline.stages.scene import Renderer, Scene
from inim.pipeline.stages.stage import Run
from inim.timing.methods import YARDSTICK, TimedMethod, display_ready, prepare_method, time_methods
from inim.timing.turns import Rounds, Timing, ratios

# What is measured where nothing is named, with those that other packages announce: every
# algorithm, and the settings that cost time.
_DEFAULT = (
    "template",
    "template:samples=2",
    "template:samples=4",
    "template:columns=solid",
    "wang2024",
    "wang2024:matching=ray",
    "gu2020",
    "gu2020:step_mm=0.2",
    "li2012",
    "li2012:fill=hidden",
)
# What a name is tried on: as small as a display gets.
_TRIAL = Display(1.0, 3.0, 3.3, 0.25, 1, 1)
_TRIAL_RGBD = RGBD(
    np.zeros((4, 4, 4), np.uint8), np.zeros((4, 4), np.float32), np.ones((4, 4), bool), 0.25
)


def available(names: Iterable[str]) -> tuple[list[str], list[str]]:
    """Those of `names` that exist and work here, and a note on each that does not."""
    found, notes = [], []
    for name in names:
        try:
            method = prepare_method(name, _TRIAL_RGBD, _TRIAL)
            if not method.is_own:
                method.run()
        except (UsageError, ImportError) as error:
            notes.append(f"left out: {error}")
        else:
            found.append(name)
    return found, notes


def choose_algorithms(algorithms: Sequence[str] | None) -> tuple[Sequence[str], list[str]]:
    """The algorithms to time, all of which must exist; all that work here for None."""
    if algorithms is None:
        others = [name for name in algorithm_names() if not is_own(name)]
        return available([*_DEFAULT, *others])
    names = list(dict.fromkeys(algorithms))
    if not names:
        raise UsageError("--algorithms: none given; name at least one, such as 'template'")
    for name in names:
        check_algorithm(name)
    return names, []


def bench_scene(plan: Plan, names: Sequence[str], rounds: Rounds, renderer: Renderer) -> BenchScene:
    """Render a scene, time all methods on it, and evaluate their EIAs.

    Parameters
    ----------
    plan : Plan
        As for a validation; its sampling settings hold here too.
    names : sequence of str
        Algorithms with their options.
    rounds : Rounds
    renderer : Renderer
    """
    observer = renderer.observer
    observer.begin(["open scene", "capture RGB-D", "ground-truth EIA", "time", "score", "write"])
    inputs = _render(plan, names, renderer)
    observer.stage("time")
    methods = [
        prepare_method(name, inputs.input(layers=properties(name).reads_layers), plan.display)
        for name in names
    ]
    times = time_methods(methods, inputs.rgbd, plan.display, rounds)
    observer.stage("score")
    algorithms = [
        BenchAlgorithm(
            **method_data(method, times, plan.display),
            **evaluate(method, inputs.reference),
            fronts=[],
            pareto=False,
        )
        for method in methods
    ]
    rows, columns = inputs.rgbd.shape
    return BenchScene(
        path=str(plan.request.scene),
        sha256=plan.file.sha256,
        display=DisplayRecord.of(plan.display),
        viewpoints=[viewpoint.name for viewpoint in plan.viewpoints],
        picture=BenchPicture(rows=rows, columns=columns, pixel_mm=inputs.rgbd.pixel_mm),
        yardstick=TimingRecord(**times[YARDSTICK].as_data()),
        algorithms=mark_fronts(algorithms),
        noise_floor=inputs.noise_floor,
        scores=[score.described() for score in all_scores()],
        captured_layers=inputs.layers,
    )


@dataclass(frozen=True)
class _Inputs:
    """The picture that methods read, and what their EIAs are compared with.

    Attributes
    ----------
    rgbd : RGBD
        Display-ready, the front surface only.
    layered : RGBD
        With its layers, where a method reads them.
    reference : Reference
    noise_floor : dict
        See `noise_floor`.
    layers : CapturedLayers or None
    """

    rgbd: RGBD
    layered: RGBD
    reference: Reference
    noise_floor: dict[str, float | None]
    layers: CapturedLayers | None

    def input(self, *, layers: bool) -> RGBD:
        """What a method reads."""
        return self.layered if layers else self.rgbd


def _render(plan: Plan, names: Sequence[str], renderer: Renderer) -> _Inputs:
    """As in a validation, with its samples; no true views, none is scored."""
    s, run = plan.settings, Run(observer=renderer.observer)
    scene = Scene(plan.file, plan.display, s.fit_share, renderer)
    camera = DepthCamera(scene, s.capture_pixels_per_pitch, s.capture_spp, s.seed)
    reads_layers = any(properties(name).reads_layers for name in names)
    capture = capture_relic(camera, layers=reads_layers, run=run)
    if not capture.rgbd.covered.any():
        raise SceneError(f"{plan.request.scene}: the depth camera sees nothing to time with")
    truth = pick_up_truth(scene, plan.display, s.eia_spp, s.seed, None, run=run)

    def views_of(eia: np.ndarray) -> list[np.ndarray]:
        """As a validation reconstructs them."""
        optics = replace(plan.optics, mounted=plan.display)
        seen = reconstruct_views(
            "", NoisyImage.from_image(eia), plan.viewpoints, optics, renderer, run=run
        )
        return [view.image for view in seen.values()]

    ready = display_ready(capture.rgbd)
    layered, layers = ready, None
    if capture.layered is not None:
        layered = display_ready(capture.layered)
        layers = CapturedLayers(
            covered_shares=list(capture.covered_shares), hidden_share=capture.hidden_share
        )
    viewing = [plan.viewing(eye) for eye in plan.viewpoints]
    reference = make_reference(ready, truth.image, plan.display, views_of, viewing)
    floor = noise_floor(truth.first, truth.second, views_of, viewing)
    return _Inputs(ready, layered, reference, floor, layers)


def method_data(
    method: TimedMethod, times: Mapping[str, Timing], display: Display
) -> dict[str, Any]:
    """Times of a method, by field of `BenchAlgorithm`."""
    timing = times[method.name]
    pixels = display.eia_shape[0] * display.eia_shape[1]
    return {
        "name": method.name,
        "prepare_s": method.prepare_s,
        **timing.as_data(),
        "mpx_per_s": pixels / 1e6 / timing.median_s,
        **ratios(timing, times[YARDSTICK]),
    }
