"""The bench of a scene: times of the algorithms against errors of sources, EIAs and views."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from msgspec.structs import replace as replaced

from inim import metrics
from inim.display import Display
from inim.documents.bench import (
    BenchAlgorithm,
    BenchPicture,
    BenchScene,
    BenchScore,
    CapturedLayers,
    TimingRecord,
)
from inim.documents.parts import DisplayRecord
from inim.errors import SceneError, UsageError
from inim.generators import (
    HOLE,
    NO_LENS,
    SourceGenerator,
    Sources,
    algorithm_names,
    check_algorithm,
    find_sources,
    is_own,
    properties,
)
from inim.generators.raycast.supersampling import Supersampled
from inim.image.noisy_image import NoisyImage
from inim.image.rgbd import RGBD, LayeredRGBD
from inim.metrics import Viewing
from inim.pipeline.plan import Plan
from inim.pipeline.stages.capture import DepthCamera, capture_relic
from inim.pipeline.stages.ground_truth import render_ground_truth_eia
from inim.pipeline.stages.reconstruction import reconstruct_views
from inim.pipeline.stages.scene import Renderer, Scene
from inim.pipeline.stages.stage import Run
from inim.timing import (
    REFERENCE_KERNEL,
    Rounds,
    TimedMethod,
    Timing,
    display_ready,
    linear_picture,
    prepare_method,
    ratios,
    time_methods,
)

# Scores with a panel of their own; those of other packages' metrics have one, too.
_PLOTTED = ("eia_psnr_db", "view_ssim_to_reference")


@dataclass(frozen=True)
class Score:
    """A metric of the EIA, against the true one, or of its views: their mean to the reference."""

    metric: metrics.Metric
    of_views: bool

    @property
    def key(self) -> str:
        """Its name in bench.json."""
        return f"view_{self.metric.to_reference_key}" if self.of_views else f"eia_{self.metric.key}"

    def described(self) -> BenchScore:
        """The score's description; `best` is None where that is infinite."""
        metric = self.metric
        best = metric.range[1 if metric.better == "higher" else 0]
        words = f"view {metric.label} to reference" if self.of_views else f"EIA {metric.label}"
        return BenchScore(
            key=self.key,
            label=f"{words} {metric.unit}".rstrip(),
            title="Views" if self.of_views else "Elemental images",
            better=metric.better,
            best=best if math.isfinite(best) else None,
            digits=metric.digits,
            plotted=self.key in _PLOTTED or metric.name in metrics.foreign_identities(),
        )


def all_scores() -> list[Score]:
    """All that there are, in the order of the tables: of the EIA, then of its views."""
    of_eia = [Score(metric, False) for metric in metrics.all_metrics() if metric.has_eia_score]
    return of_eia + [Score(metric, True) for metric in metrics.all_metrics()]


#: Views of an EIA, one for each viewpoint: (rows, columns, 3) float32, linear RGB.
ViewsOf = Callable[[np.ndarray], Sequence[np.ndarray]]


@dataclass(frozen=True)
class Reference:
    """Ground truth for the EIAs of all methods.

    Attributes
    ----------
    exact : Sources
        By the exact traversal.
    eia : (rows, columns, 3) float32
        Ground truth, linear RGB.
    views_of : callable
        The views of an EIA.
    reference_views : sequence of array
        Views of the ground-truth EIA.
    viewing : sequence of Viewing, optional
        How each view is seen, for metrics of perception; they are left out without.
    """

    exact: Sources
    eia: np.ndarray
    views_of: ViewsOf
    reference_views: Sequence[np.ndarray]
    viewing: Sequence[Viewing] = ()


def make_reference(
    rgbd: RGBD,
    eia: np.ndarray,
    display: Display,
    views_of: ViewsOf,
    viewing: Sequence[Viewing] = (),
) -> Reference:
    """Compute the ground truth for EIAs of a display-ready RGB-D picture.

    Parameters
    ----------
    rgbd : RGBD
        Display-ready.
    eia : (rows, columns, 3) float32
        Ground truth, linear RGB.
    views_of : callable
        The views of an EIA.
    viewing : sequence of Viewing, optional
        How each view is seen.
    """
    exact = find_sources(rgbd, display)
    return Reference(exact, eia, views_of, views_of(eia), viewing)


def evaluate(method: TimedMethod, reference: Reference) -> dict[str, Any]:
    """Errors of the EIA that was timed, by field of `BenchAlgorithm`."""
    eia = linear_picture(method.out)
    sources = _sources(method)
    empty = method.out[..., 3] == 0 if sources is None else sources == HOLE
    wrong = None if sources is None else _lensed_share(sources != reference.exact, reference.exact)
    return {
        "wrong_source": wrong,
        "hole_fraction": _lensed_share(empty, reference.exact),
        "averaged_share": _averaged_share(method),
        "scores": _scores(
            reference.eia,
            eia,
            reference.reference_views,
            reference.views_of(eia),
            reference.viewing,
        ),
    }


def noise_floor(
    first: np.ndarray, second: np.ndarray, views_of: ViewsOf, viewing: Sequence[Viewing] = ()
) -> dict[str, float | None]:
    """One half of the ground truth's samples against the other, by the same measures."""
    return _scores(first, second, views_of(first), views_of(second), viewing)


def _scores(
    true_eia: np.ndarray,
    eia: np.ndarray,
    true_views: Sequence[np.ndarray],
    views: Sequence[np.ndarray],
    viewing: Sequence[Viewing],
) -> dict[str, float | None]:
    """All scores, by key."""
    of_eia = metrics.eia_scores(true_eia, eia)
    viewing_by_view: Sequence[Viewing | None] = viewing or [None] * len(views)
    of_views = [
        metrics.score(truth, view, viewing=view_viewing)
        for truth, view, view_viewing in zip(true_views, views, viewing_by_view, strict=True)
    ]
    return {
        score.key: float(np.mean([view[score.metric.key] for view in of_views]))
        if score.of_views
        else of_eia[score.metric.key]
        for score in all_scores()
        if viewing or not score.metric.needs_viewing
    }


def _sources(method: TimedMethod) -> Sources | None:
    """Sources of a method; None if it does not report them."""
    if isinstance(method.generator, SourceGenerator) and not isinstance(method.rgbd, LayeredRGBD):
        return method.generator.sources(method.rgbd)
    return None


def _averaged_share(method: TimedMethod) -> float | None:
    """Share of the panel's pixels whose rays meet unlike things; None of those with one ray."""
    if not isinstance(method.generator, Supersampled):
        return None
    sources = method.generator.samples(method.rgbd)
    return float((sources != sources[0]).any(axis=0).mean())


def _lensed_share(chosen: np.ndarray, exact: Sources) -> float:
    """Share of the lensed panel pixels."""
    lensed = exact != NO_LENS
    return int((chosen & lensed).sum()) / max(1, int(lensed.sum()))


# -- time against error -------------------------------------------------------------------------


def mark_fronts(algorithms: Sequence[BenchAlgorithm]) -> list[BenchAlgorithm]:
    """The algorithms with their `fronts` by error, and `pareto`: on any of them."""
    errors: dict[str, list[float | None]] = {
        "wrong_source": [algorithm.wrong_source for algorithm in algorithms]
    }
    for score in all_scores():
        sign = 1 if score.metric.better == "lower" else -1
        values = [algorithm.scores.get(score.key) for algorithm in algorithms]
        errors[score.key] = [None if value is None else sign * value for value in values]
    fronts: list[list[str]] = [[] for _ in algorithms]
    for name, error in errors.items():
        points = [(a.median_ms, e) for a, e in zip(algorithms, error, strict=True)]
        for front, is_on in zip(fronts, pareto(points), strict=True):
            front += [name] * is_on
    return [
        replaced(algorithm, fronts=front, pareto=bool(front))
        for algorithm, front in zip(algorithms, fronts, strict=True)
    ]


def pareto(points: Sequence[tuple[float, float | None]]) -> list[bool]:
    """Mask of Pareto-optimal points (time, error): no other point is as good in both and better in
    one.

    A point without an error (None) is never on the front.
    """

    def beaten(mine: tuple[float, float]) -> bool:
        return any(
            other[1] is not None and other[0] <= mine[0] and other[1] <= mine[1] and other != mine
            for other in points
        )

    return [error is not None and not beaten((t, error)) for t, error in points]


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
    methods, notes = [], []
    for name in names:
        try:
            method = prepare_method(name, _TRIAL_RGBD, _TRIAL)
            if not method.is_own:
                method.run()
        except (UsageError, ImportError) as error:
            notes.append(f"left out: {error}")
        else:
            methods.append(name)
    return methods, notes


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
        yardstick=TimingRecord(**times[REFERENCE_KERNEL].as_data()),
        algorithms=mark_fronts(algorithms),
        noise_floor=inputs.noise_floor,
        scores=[score.described() for score in all_scores()],
        captured_layers=inputs.layers,
    )


@dataclass(frozen=True)
class _Inputs:
    """Input picture of the methods, and the ground truth for their EIAs.

    Attributes
    ----------
    rgbd : RGBD
        Display-ready, the front surface only.
    layered : RGBD
        With its layers, where a method reads them.
    noise_floor : dict
        See `noise_floor`.
    """

    rgbd: RGBD
    layered: RGBD
    reference: Reference
    noise_floor: dict[str, float | None]
    layers: CapturedLayers | None

    def input(self, *, layers: bool) -> RGBD:
        """Input picture of a method."""
        return self.layered if layers else self.rgbd


def _render(plan: Plan, names: Sequence[str], renderer: Renderer) -> _Inputs:
    """Render as a validation does, with its samples but without ground-truth views."""
    s, run = plan.settings, Run(observer=renderer.observer)
    scene = Scene(plan.file, plan.display, s.fit_share, renderer)
    camera = DepthCamera(scene, s.capture_pixels_per_pitch, s.capture_spp, s.seed)
    reads_layers = any(properties(name).reads_layers for name in names)
    capture = capture_relic(camera, layers=reads_layers, run=run)
    if not capture.rgbd.covered.any():
        raise SceneError(f"{plan.request.scene}: the depth camera sees nothing to time with")
    truth = render_ground_truth_eia(scene, plan.display, s.eia_spp, s.seed, None, run=run)

    def views_of(eia: np.ndarray) -> list[np.ndarray]:
        """Reconstruct views as a validation does."""
        optics = replace(plan.optics, display=plan.display)
        views = reconstruct_views(
            "", NoisyImage.from_image(eia), plan.viewpoints, optics, renderer, run=run
        )
        return [view.image for view in views.values()]

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
        **ratios(timing, times[REFERENCE_KERNEL]),
    }
