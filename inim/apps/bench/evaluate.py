"""The bench of a scene: times of the algorithms against errors of sources, EIAs and views."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from msgspec.structs import replace as replaced

from inim.apps.bench.document import (
    BenchAlgorithm,
    BenchScene,
    BenchScore,
    CapturedLayers,
    TimingRecord,
)
from inim.display import Display
from inim.generators import (
    HOLE,
    NO_LENS,
    SourceGenerator,
    Sources,
    algorithm_names,
    find_sources,
    is_own,
    parse_algorithm,
)
from inim.generators.steps import RayGenerator
from inim.image.noisy_image import NoisyImage
from inim.image.rgbd import RGBD, LayeredRGBD
from inim.pipeline.plan import Plan
from inim.pipeline.stages.capture import capture_nonempty
from inim.pipeline.stages.ground_truth import render_ground_truth_eia
from inim.pipeline.stages.method import prepare_timed_methods
from inim.pipeline.stages.reconstruction import reconstruct_views
from inim.pipeline.stages.scene import Renderer
from inim.pipeline.stages.stage import Run
from inim.pipeline.timing import (
    REFERENCE_KERNEL,
    OtherPrograms,
    Rounds,
    TimedMethod,
    Timing,
    linear_picture,
    prepare_method,
    ratios,
    time_methods,
)
from inim.report.plots import on_front
from inim.scores import metrics
from inim.scores.document_parts import DisplayRecord, PictureShape
from inim.scores.metrics import Viewing
from inim.system.errors import UsageError
from inim.system.process.observer import Observer
from inim.system.process.user_paths import user_text

# Scores with a plot of their own, in addition to those of other packages' metrics.
_PLOTTED = ("eia_psnr_db", "view_ssim_to_reference")


@dataclass(frozen=True)
class Score:
    """A metric of the EIA to the ground truth, or the mean over its views to the reference."""

    metric: metrics.Metric
    of_views: bool

    @property
    def key(self) -> str:
        """Name in bench.json."""
        return f"view_{self.metric.to_reference_key}" if self.of_views else f"eia_{self.metric.key}"

    def record(self) -> BenchScore:
        """Describe the score for bench.json; an infinite best value is None."""
        metric = self.metric
        best = metric.range[1 if metric.better == "higher" else 0]
        label = f"view {metric.label} to reference" if self.of_views else f"EIA {metric.label}"
        return BenchScore(
            key=self.key,
            label=f"{label} {metric.unit}".rstrip(),
            title="Views" if self.of_views else "Elemental images",
            better=metric.better,
            best=best if math.isfinite(best) else None,
            digits=metric.digits,
            plotted=self.key in _PLOTTED or metric.name in metrics.foreign_identities(),
        )


def all_scores() -> list[Score]:
    """All scores in the order of the tables: of the EIA, then of its views."""
    of_eia = [Score(metric, False) for metric in metrics.all_metrics() if metric.has_eia_score]
    return of_eia + [Score(metric, True) for metric in metrics.all_metrics()]


#: Reconstructs the views of an EIA, one per viewpoint: (rows, columns, 3) float32, linear RGB.
ViewsOf = Callable[[np.ndarray], Sequence[np.ndarray]]


@dataclass(frozen=True)
class Reference:
    """Ground truth for the EIAs of all methods.

    `exact` are the sources by the exact traversal; `eia`, (rows, columns, 3) float32 linear RGB, is
    the ground truth, with its `reference_views`. `viewing` are the conditions of each view; if
    empty, metrics that need them are left out.
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
    """Compute the `Reference` of an RGB-D picture from its ground-truth EIA."""
    return Reference(find_sources(rgbd, display), eia, views_of, views_of(eia), viewing)


def evaluate(method: TimedMethod, reference: Reference) -> dict[str, Any]:
    """Compute the errors of the timed EIA, by field of `BenchAlgorithm`."""
    eia, sources = linear_picture(method.out), None
    if isinstance(method.generator, SourceGenerator) and not isinstance(method.rgbd, LayeredRGBD):
        sources = method.generator.sources(method.rgbd)
    empty = method.out[..., 3] == 0 if sources is None else sources == HOLE
    wrong = None if sources is None else _lensed_share(sources != reference.exact, reference.exact)
    views = reference.views_of(eia)
    return {
        "wrong_source": wrong,
        "hole_fraction": _lensed_share(empty, reference.exact),
        "averaged_share": _multi_source_share(method),
        "scores": _scores(reference.eia, eia, reference.reference_views, views, reference.viewing),
    }


def noise_floor(
    first: np.ndarray, second: np.ndarray, views_of: ViewsOf, viewing: Sequence[Viewing] = ()
) -> dict[str, float | None]:
    """Score one half of the ground truth's samples against the other."""
    return _scores(first, second, views_of(first), views_of(second), viewing)


def _scores(
    reference_eia: np.ndarray,
    eia: np.ndarray,
    reference_views: Sequence[np.ndarray],
    views: Sequence[np.ndarray],
    viewing: Sequence[Viewing],
) -> dict[str, float | None]:
    eia_scores = metrics.eia_scores(reference_eia, eia)
    conditions_by_view: Sequence[Viewing | None] = viewing or [None] * len(views)
    view_scores = [
        metrics.score(reference, view, viewing=conditions)
        for reference, view, conditions in zip(
            reference_views, views, conditions_by_view, strict=True
        )
    ]
    return {
        score.key: float(np.mean([scores[score.metric.key] for scores in view_scores]))
        if score.of_views
        else eia_scores[score.metric.key]
        for score in all_scores()
        if viewing or not score.metric.needs_viewing
    }


def _multi_source_share(method: TimedMethod) -> float | None:
    """Share of the panel pixels whose rays have different sources; None for one ray per pixel."""
    if not isinstance(method.generator, RayGenerator):
        return None
    rays = method.generator.sources_of_rays(method.rgbd)
    first, *others = [sources for ray, sources in rays if 0 in ray.channels]
    if not others:
        return None
    differ = [sources != first for sources in others]
    return float(np.any(differ, axis=0).mean())


def _lensed_share(chosen: np.ndarray, exact: Sources) -> float:
    """Share of the lensed panel pixels."""
    lensed = exact != NO_LENS
    return int((chosen & lensed).sum()) / max(1, int(lensed.sum()))


# -- time against error -------------------------------------------------------------------------


def mark_fronts(algorithms: Sequence[BenchAlgorithm]) -> list[BenchAlgorithm]:
    """Set the Pareto fronts that each algorithm is on, by name of the error.

    An algorithm without an error is not on its front.
    """
    errors = {"wrong_source": {a.name: a.wrong_source for a in algorithms}}
    for score in all_scores():
        sign = 1 if score.metric.better == "lower" else -1
        values = {a.name: a.scores.get(score.key) for a in algorithms}
        errors[score.key] = {n: None if v is None else sign * v for n, v in values.items()}
    times = {algorithm.name: algorithm.median_ms for algorithm in algorithms}
    fronts = {
        key: on_front({n: (times[n], value) for n, value in error.items() if value is not None})
        for key, error in errors.items()
    }
    names = {name: [key for key, front in fronts.items() if name in front] for name in times}
    return [replaced(a, fronts=names[a.name], pareto=bool(names[a.name])) for a in algorithms]


# Algorithms to time by default, in addition to those of other packages.
_DEFAULT = (
    "template",
    "template:samples=1",
    "template:samples=1:colour=averaged",
    "template:samples=1:colour=nearest",
    "template:samples=2:colour=nearest",
    "template:samples=4:colour=nearest",
    "template:samples=1:colour=nearest:columns=solid",
    "wang2024",
    "wang2024:matching=ray",
    "gu2020",
    "gu2020:step_mm=0.2",
    "li2012",
    "li2012:fill=hidden",
)
# The smallest display and picture, to test whether an algorithm works.
_TRIAL = Display(1.0, 3.0, 3.3, 0.25, 1, 1)
_TRIAL_RGBD = RGBD(
    np.zeros((4, 4, 4), np.uint8), np.zeros((4, 4), np.float32), np.ones((4, 4), bool), 0.25
)


def available_algorithms(names: Iterable[str]) -> tuple[list[str], list[str]]:
    """Return the algorithms that work on this machine, and a note on each of the others."""
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
    """Return the algorithms to time, by default all that work here, and notes on the others.

    Raises `UsageError` if a given algorithm does not exist.
    """
    if algorithms is None:
        others = [name for name in algorithm_names() if not is_own(name)]
        return available_algorithms([*_DEFAULT, *others])
    names = list(dict.fromkeys(algorithms))
    if not names:
        raise UsageError("--algorithms: none given; name at least one, such as 'template'")
    for name in names:
        parse_algorithm(name)
    return names, []


#: Above this share of the processors, other programs disturb the times, which are taken again.
DISTURBED = 0.1
_MOST_ATTEMPTS = 3


def _time_undisturbed(
    methods: Sequence[TimedMethod], rgbd: RGBD, display: Display, rounds: Rounds, observer: Observer
) -> tuple[dict[str, Timing], float | None]:
    """Times of the least disturbed attempt, and the share of the processors used by others."""
    attempts: list[tuple[dict[str, Timing], float | None]] = []
    for _ in range(_MOST_ATTEMPTS):
        with OtherPrograms() as others:
            times = time_methods(methods, rgbd, display, rounds)
        attempts.append((times, others.share))
        if others.share is None or others.share <= DISTURBED:
            break
        observer.line(
            f"other programs used {others.share:.0%} of the processors; "
            f"attempt {len(attempts)} of {_MOST_ATTEMPTS}"
        )
    return min(attempts, key=lambda attempt: attempt[1] or 0.0)


def bench_scene(
    plan: Plan, names: Sequence[str], rounds: Rounds, renderer: Renderer
) -> tuple[BenchScene, float | None]:
    """Render a scene as a validation does, time algorithms on it, and evaluate their EIAs.

    The sampling settings of the plan apply; `names` are algorithms with their options. Returns the
    results, and the share of the processors that other programs used; None if unavailable.
    """
    observer, display, s = renderer.observer, plan.display, plan.settings
    observer.begin(["open scene", "capture RGB-D", "ground-truth EIA", "time", "score", "write"])
    run, camera = Run(observer=observer), plan.camera(renderer)
    capture = capture_nonempty(camera, {parse_algorithm(name).input for name in names}, run=run)
    truth = render_ground_truth_eia(camera.scene, display, s.eia_spp, s.seed, None, run=run)

    def views_of(eia: np.ndarray) -> list[np.ndarray]:
        optics = replace(plan.optics, display=display)
        noiseless = NoisyImage.from_image(eia)
        views = reconstruct_views("", noiseless, plan.viewpoints, optics, renderer, run=run)
        return [view.image for view in views.values()]

    viewing = [plan.viewing_conditions(eye) for eye in plan.viewpoints]
    reference = make_reference(capture.rgbd, truth.image, display, views_of, viewing)
    floor = noise_floor(truth.first, truth.second, views_of, viewing)
    observer.stage("time")
    methods, rgbd = prepare_timed_methods(names, capture)
    times, others = _time_undisturbed(methods, rgbd, display, rounds, observer)
    observer.stage("score")
    algorithms = [
        BenchAlgorithm(
            **method_data(method, times, display),
            **evaluate(method, reference),
            fronts=[],
            pareto=False,
        )
        for method in methods
    ]
    rows, columns = rgbd.shape
    scene = BenchScene(
        path=user_text(plan.request.scene),
        sha256=plan.file.sha256,
        display=DisplayRecord.of(display),
        viewpoints=[viewpoint.name for viewpoint in plan.viewpoints],
        picture=PictureShape(rows=rows, columns=columns, pixel_mm=rgbd.pixel_mm),
        yardstick=TimingRecord(**times[REFERENCE_KERNEL].as_data()),
        algorithms=mark_fronts(algorithms),
        noise_floor=floor,
        scores=[score.record() for score in all_scores()],
        captured_layers=None
        if LayeredRGBD not in capture.inputs
        else CapturedLayers(
            covered_shares=list(capture.covered_shares), hidden_share=capture.hidden_share
        ),
    )
    return scene, others


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
