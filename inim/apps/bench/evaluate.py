"""The bench of a scene: times of the algorithms against errors of sources, EIAs and views."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import replace as replaced

from inim.apps.bench.document import (
    BenchAlgorithm,
    BenchScene,
    BenchScore,
    CapturedLayers,
    Scores,
    TimingRecord,
)
from inim.display import Display
from inim.generators import (
    HOLE,
    SourceGenerator,
    Sources,
    algorithm_names,
    find_sources,
    is_own,
    parse_algorithm,
)
from inim.generators.steps import RayGenerator
from inim.image.noisy_image import NoisyEIA
from inim.image.rgbd import RGBD, LayeredRGBD
from inim.pipeline.plan import Plan
from inim.pipeline.stages.capture import capture_nonempty
from inim.pipeline.stages.ground_truth import render_ground_truth_eia
from inim.pipeline.stages.method import prepare_timed_methods
from inim.pipeline.stages.reconstruction import DisplayViews, reconstruct_views
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


def bench_scores() -> list[BenchScore]:
    """Describe all scores in the order of the tables: of the EIA, then of its views."""
    every = metrics.all_metrics()
    of_eia = [
        _describe(m, f"eia_{m.key}", f"EIA {m.label}", "Elemental images")
        for m in every
        if m.has_eia_score
    ]
    return of_eia + [
        _describe(m, f"view_{m.to_reference_key}", f"view {m.label} to reference", "Views")
        for m in every
    ]


def _describe(metric: metrics.Metric, key: str, label: str, title: str) -> BenchScore:
    """Describe a score for bench.json; an infinite best value is None."""
    best = metric.range[1 if metric.better == "higher" else 0]
    return BenchScore(
        key=key,
        label=f"{label} {metric.unit}".rstrip(),
        title=title,
        better=metric.better,
        best=best if math.isfinite(best) else None,
        digits=metric.digits,
        plotted=key in _PLOTTED or metric.name in metrics.foreign_identities(),
    )


class EIAWithViews(NamedTuple):
    """An EIA, and the views that a display shows of it, one per viewpoint.

    Both are (rows, columns, 3) float32, linear RGB.
    """

    eia: np.ndarray
    views: Sequence[np.ndarray]


def compare(reference: EIAWithViews, test: EIAWithViews, viewing: Sequence[Viewing] = ()) -> Scores:
    """Score an EIA and its views by the keys of `bench_scores`, the mean over all views.

    `viewing` are the conditions of each view; if empty, metrics that need them are left out.
    """
    conditions: Sequence[Viewing | None] = viewing or [None] * len(test.views)
    views = zip(reference.views, test.views, conditions, strict=True)
    view_scores = [metrics.score(true, view, viewing=eye) for true, view, eye in views]
    eia_scores = metrics.eia_scores(reference.eia, test.eia)
    scores: Scores = {f"eia_{key}": value for key, value in eia_scores.items()}
    for metric in (metric for metric in metrics.all_metrics() if metric.key in view_scores[0]):
        values = [scores_of_view[metric.key] for scores_of_view in view_scores]
        scores[f"view_{metric.to_reference_key}"] = float(np.mean(values))
    return scores


def source_errors(method: TimedMethod, exact: Sources, display: Display) -> dict[str, Any]:
    """Compare the sources of the timed EIA with the exact ones, by field of `BenchAlgorithm`."""
    wrong, empty = None, method.out[..., 3] == 0
    if isinstance(method.generator, SourceGenerator) and not isinstance(method.rgbd, LayeredRGBD):
        sources = method.generator.sources(method.rgbd)
        wrong = float(np.mean((sources != exact)[display.lensed]))
        empty = sources == HOLE
    return {
        "wrong_source": wrong,
        "hole_fraction": float(np.mean(empty[display.lensed])),
        "averaged_share": _multi_source_share(method),
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


def mark_fronts(algorithms: Sequence[BenchAlgorithm]) -> list[BenchAlgorithm]:
    """Set the Pareto fronts that each algorithm is on, by name of the error.

    An algorithm without an error is not on its front.
    """
    fronts = {"wrong_source": _front(algorithms, "wrong_source", 1)}
    for score in bench_scores():
        fronts[score.key] = _front(algorithms, score.key, 1 if score.better == "lower" else -1)
    names = {a.name: [key for key, front in fronts.items() if a.name in front] for a in algorithms}
    return [replaced(a, fronts=names[a.name], pareto=bool(names[a.name])) for a in algorithms]


def _front(algorithms: Sequence[BenchAlgorithm], key: str, sign: int) -> set[str]:
    """Algorithms than which no other is as fast and as good."""
    results = {a.name: (a.median_ms, a.result(key)) for a in algorithms}
    return on_front({n: (ms, sign * v) for n, (ms, v) in results.items() if v is not None})


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
# The smallest display and picture, to test whether an algorithm of another package works.
_TRIAL = Display(1.0, 3.0, 3.3, 0.25, 1, 1)
_TRIAL_RGBD = RGBD(
    np.zeros((4, 4, 4), np.uint8), np.zeros((4, 4), np.float32), np.ones((4, 4), bool), 0.25
)


def choose_algorithms(algorithms: Sequence[str] | None) -> tuple[Sequence[str], list[str]]:
    """Return the algorithms to time, by default all that work here, and notes on the others.

    Raises `UsageError` if a given algorithm does not exist.
    """
    if algorithms is None:
        usable, notes = [*_DEFAULT], []
        for name in (name for name in algorithm_names() if not is_own(name)):
            try:
                prepare_method(name, _TRIAL_RGBD, _TRIAL).run()
            except UsageError as error:
                notes.append(f"left out: {error}")
            else:
                usable.append(name)
        return usable, notes
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
    truth = render_ground_truth_eia(
        camera.scene, display, (plan.samples["eia_spp"],), s.seed, run=run
    )

    optics = replace(plan.optics, display=display)
    display_views = DisplayViews(plan.viewpoints, optics, renderer, run=run)

    def show(eia: np.ndarray) -> EIAWithViews:
        views = reconstruct_views("", NoisyEIA((eia, None)), display_views, run=run)
        return EIAWithViews(eia, [view.image for view in views.values()])

    viewing = [plan.viewing_conditions(eye) for eye in plan.viewpoints]
    reference, exact = show(truth.image), find_sources(capture.rgbd, display)
    floor = compare(show(truth.first), show(truth.second), viewing)
    observer.stage("time")
    methods, rgbd = prepare_timed_methods(names, capture)
    times, others = _time_undisturbed(methods, rgbd, display, rounds, observer)
    observer.stage("score")
    algorithms = [
        BenchAlgorithm(
            **method_data(method, times, display),
            **source_errors(method, exact, display),
            scores=compare(reference, show(linear_picture(method.out)), viewing),
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
        scores=bench_scores(),
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
