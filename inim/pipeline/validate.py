"""Diagram of the pipeline: from a scene to a scored report.

    scene ──► RGB-D ──► each method's EIA ──► its views ──────────┐
      │                                                          ├──► scores ──► report
      ├────► ground-truth EIA ──► its views: the reference views ─┤
      └────► ground-truth views ─────────────────────────────────┘

A picture without a scene is the RGB-D itself. Its exact EIA and the picture, warped to each
viewpoint, then take the places of the ground-truth EIA and views (`inim.pipeline.stages.picture`).
Each line below is a step, which is a stage or calls several. `inim.pipeline.stages.stage` adds the
result cache, the timing and the record of skipped steps.
"""

from inim.pipeline.adaptive_sampling import Evaluation, sample_until_precise
from inim.pipeline.baseline import collect_statistics, compare_with_baseline
from inim.pipeline.output import Images, make_report
from inim.pipeline.plan import Plan
from inim.pipeline.stages.capture import capture_relic, measure_translucency
from inim.pipeline.stages.ground_truth import (
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
    """Evaluate with enough samples for precise scores, compare with the baseline, and report."""
    evaluation = sample_until_precise(evaluate, plan, renderer, images, run)
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
    s, eyes, optics = plan.settings, plan.viewpoints, plan.optics
    source = plan.source(renderer)
    display_views = DisplayViews(eyes, optics, renderer, run=run)
    mask = find_observed_pixels(display_views, run=run) if plan.is_lazy else None
    observed = display_views.observed
    setup = MethodSetup(source, optics, eyes, s.eia_spp, s.view_spp, mask, observed)
    prepared_methods = prepare_methods(plan.methods, setup, run=run)

    if isinstance(source, FittedPicture):
        record = describe_picture(source, run=run)
        capture = capture_picture(source, plan.inputs)
        truth_eia = generate_exact_eia(source, run=run)
        truth_views = {
            eye.name: warp_picture(source, eye, s.view_pixels_per_lens, run=run) for eye in eyes
        }
    else:
        record = describe_scene(source.scene, run=run)
        if "splats" in record:
            record = record | {"splats": measure_translucency(source, run=run)}
        capture = capture_relic(source, plan.inputs, run=run)
        truth_eia = render_ground_truth_eia(
            source.scene, plan.misaligned_display, s.eia_spp, s.seed, mask, observed, run=run
        )
        sampling = (s.view_pixels_per_lens, s.view_spp, s.seed)
        truth_views = {eye.name: render_view(source.scene, eye, *sampling, run=run) for eye in eyes}
    reference_views = reconstruct_views("reference", truth_eia, display_views, run=run)
    viewing = {eye.name: plan.viewing_conditions(eye) for eye in eyes}
    truth = collect_ground_truth(
        capture, truth_eia, truth_views, reference_views, viewing, is_whole=mask is None
    )
    images.save_capture(capture, plan.display)
    images.save_truth(truth)

    results = {}
    for method, prepared_method in zip(plan.methods, prepared_methods, strict=True):
        output = generate_eia(method, prepared_method, capture, truth_eia, run=run)
        images.save(f"eia/{method.name}", output.eia.image)
        views = reconstruct_views(method.name, output.eia, display_views, run=run)
        images.save_views(method.name, views)
        limit = plan.ssim_limits.get(method.name)
        results[method.name] = score_method(method.name, output, views, truth, limit, run=run)
        if isinstance(source, FittedPicture):
            results[method.name] = score_sources(method, source, results[method.name], run=run)

    reference_scores = score_reference_views(truth, run=run)
    images.finish()
    return Evaluation(
        plan, renderer.backend, run, record, capture, truth, reference_scores, results
    )
