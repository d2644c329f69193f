"""Diagram of the pipeline: from a scene to a scored report.

    scene ──► RGB-D ──► each method's EIA ──► its views ──────────┐
      │                                                          ├──► scores ──► report
      ├────► ground-truth EIA ──► its views: the reference views ─┤
      └────► ground-truth views ─────────────────────────────────┘

A picture without a scene is the RGB-D itself. Its exact EIA and the picture, warped to each
viewpoint, then take the places of the ground-truth EIA and views (`inim.pipeline.stages.picture`).
Each line below is a step, which is a stage or calls several. `inim.pipeline.stages.stage` adds the
result cache, the timing and the record of skipped steps. A scene is sampled in rounds, until the
scores are precise (`inim.pipeline.adaptive_sampling`).
"""

import math
from dataclasses import replace
from typing import Any

from inim.pipeline.adaptive_sampling import Sampling, interval_excess, stage_names
from inim.pipeline.baseline import collect_statistics, compare_with_baseline
from inim.pipeline.evaluation import Evaluation
from inim.pipeline.output import Images, make_report
from inim.pipeline.plan import Plan
from inim.pipeline.stages.capture import (
    DepthCamera,
    capture_relic,
    measure_translucency,
)
from inim.pipeline.stages.ground_truth import (
    SceneImages,
    SceneView,
    collect_ground_truth,
    render_ground_truth_eia,
    render_view,
)
from inim.pipeline.stages.method import MethodSetup, generate_eia, generator_times, prepare_methods
from inim.pipeline.stages.picture import (
    FittedPicture,
    capture_picture,
    describe_picture,
    generate_exact_eia,
    score_sources,
    warp_picture,
)
from inim.pipeline.stages.reconstruction import (
    DisplayViews,
    find_observed_pixels,
    reconstruct_views,
)
from inim.pipeline.stages.scene import Renderer, describe_scene
from inim.pipeline.stages.scoring import (
    compute_noise_floor,
    compute_truth_statistics,
    score_method,
    score_reference_views,
)
from inim.pipeline.stages.stage import Run
from inim.report import Report


def validate(plan: Plan, renderer: Renderer, images: Images, run: Run) -> Report:
    """Evaluate, compare with the baseline, and report."""
    evaluation = evaluate(plan, renderer, images, run)
    capture, truth = evaluation.capture, evaluation.truth
    times = generator_times(plan.methods, capture, run=run) if plan.request.time else {}
    noise_floor = compute_noise_floor(truth, run=run)
    truth_statistics = compute_truth_statistics(truth, evaluation.reference_scores, run=run)
    statistics = collect_statistics(evaluation, truth_statistics)
    comparison = compare_with_baseline(
        evaluation.plan, images.folder, statistics, evaluation.reference_outputs
    )
    return make_report(evaluation, noise_floor, times, comparison, images.folder)


def evaluate(plan: Plan, renderer: Renderer, images: Images, run: Run) -> Evaluation:
    """Render the ground truth, generate the EIA of every method and score them."""
    run.observer.begin(stage_names(plan))
    eyes, source = plan.viewpoints, plan.source(renderer)
    display_views = DisplayViews(eyes, plan.optics, renderer, run=run)
    mask = find_observed_pixels(display_views, run=run) if plan.is_lazy else None
    setup = MethodSetup(source, plan.optics, eyes, mask, display_views.observed)
    prepared_methods = prepare_methods(plan.methods, setup, run=run)
    methods = [*zip(plan.methods, prepared_methods, strict=True)]
    viewing = {eye.name: plan.viewing_conditions(eye) for eye in eyes}

    if isinstance(source, FittedPicture):
        record = describe_picture(source, run=run)
    else:
        record = describe_scene(source.scene, run=run)
        if "splats" in record:
            record = record | {"splats": measure_translucency(source, run=run)}
    sampling = Sampling.of(plan, is_adaptive=renderer.skip)
    scene_images: SceneImages | None = None
    while True:
        if isinstance(source, FittedPicture):
            last = show_picture(plan, source, run=run)
        else:
            last = render_round(plan, source, setup, sampling, run=run)
        scene_images = last if scene_images is None else scene_images.merged(last)
        reference_views = reconstruct_views("reference", scene_images.eia, display_views, run=run)
        truth = collect_ground_truth(scene_images, reference_views, viewing, is_whole=mask is None)
        truth = replace(truth, has_intervals=not plan.request.preview)
        if sampling.is_last:
            break
        method_views = []
        for method, prepared_method in methods:
            if method.decides_samples and not sampling.is_fixed:
                eia = generate_eia(method, prepared_method, scene_images, run=run).eia
                method_views.append(reconstruct_views(method.name, eia, display_views, run=run))
        error = plan.settings.score_error
        excess = interval_excess(truth, method_views, error, run) if method_views else math.inf
        if excess <= 1:
            break
        sampling = sampling.next_round(excess)
        run.observer.begin(stage_names(plan))
    sampling.record(plan, run)
    images.save_capture(scene_images.capture, plan.display)
    images.save_truth(truth)

    results = {}
    for method, prepared_method in methods:
        output = generate_eia(method, prepared_method, scene_images, run=run)
        images.save(f"eia/{method.name}", output.eia.image)
        views = reconstruct_views(method.name, output.eia, display_views, run=run)
        images.save_views(method.name, views)
        limit = plan.ssim_limits.get(method.name)
        results[method.name] = score_method(method.name, output, views, truth, limit, run=run)
        if isinstance(source, FittedPicture):
            results[method.name] = score_sources(method, source, results[method.name], run=run)

    reference_scores = score_reference_views(truth, run=run)
    images.finish()
    used_samples: dict[str, Any] = sampling.totals
    used = replace(plan, settings=replace(plan.settings, **used_samples))
    return Evaluation(
        used, renderer.backend, run, record, scene_images.capture, truth, reference_scores, results
    )


def render_round(
    plan: Plan, camera: DepthCamera, setup: MethodSetup, sampling: Sampling, *, run: Run
) -> SceneImages:
    """Render the last round of samples; beyond the usual samples, only observed panel pixels."""
    s, scene, rounds = plan.settings, camera.scene, sampling.rounds
    is_whole = sampling.share <= 1 or setup.observed is None
    mask = setup.mask if is_whole else setup.observed
    return SceneImages(
        capture_relic(replace(camera, rounds=rounds["capture_spp"]), plan.inputs, run=run),
        render_ground_truth_eia(
            scene, plan.misaligned_display, rounds["eia_spp"], s.seed, mask, setup.observed, run=run
        ),
        {
            eye.name: SceneView(
                *render_view(
                    scene, eye, s.view_pixels_per_lens, rounds["view_spp"], s.seed, run=run
                )
            )
            for eye in plan.viewpoints
        },
        rounds,
        mask,
    )


def show_picture(plan: Plan, picture: FittedPicture, *, run: Run) -> SceneImages:
    """Images of a picture in the place of a scene's."""
    pixels = plan.settings.view_pixels_per_lens
    return SceneImages(
        capture_picture(picture, plan.inputs),
        generate_exact_eia(picture, run=run),
        {
            eye.name: SceneView(*warp_picture(picture, eye, pixels, run=run))
            for eye in plan.viewpoints
        },
        {},
    )
