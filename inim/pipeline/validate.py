"""The pipeline as its diagram: from a scene to a scored report.

    scene ──► RGB-D ──► each method's EIA ──► its views ──┐
      │                                                   ├──► scores ──► report
      ├────► true EIA ──► its views: the reference ─────────┤
      └────► true views ──────────────────────────────────┘

Each line below calls a stage, a plain function in a file of its own. `inim.pipeline.stages.stage`
looks up its result in the cache, times it and records what was skipped.
"""

from __future__ import annotations

from inim.pipeline.adaptive_sampling import Measured, measure_until_known
from inim.pipeline.output.baseline import judge, run_statistics
from inim.pipeline.output.images import Images
from inim.pipeline.output.report_data import report_of
from inim.pipeline.plan import Plan
from inim.pipeline.stages.capture import DepthCamera, capture_relic, translucency
from inim.pipeline.stages.evaluate import (
    evaluate,
    heat_maps,
    noise_floor,
    reference_scores,
    truth_statistics,
)
from inim.pipeline.stages.ground_truth import collect_truth, pick_up_truth, render_view
from inim.pipeline.stages.method import Task, generator_times, make_eia, prepare_methods
from inim.pipeline.stages.reconstruct import observed_pixels, reconstruct_views
from inim.pipeline.stages.scene import Renderer, Scene, scene_facts
from inim.pipeline.stages.stage import Run
from inim.report import Report


def validate(plan: Plan, renderer: Renderer, images: Images, run: Run) -> Report:
    """Measure with as many samples as the scores need, compare with the baseline, report."""
    found = measure_until_known(measure, plan, renderer, images, run)
    times = generator_times(plan.methods, found.capture, run=run) if plan.request.time else {}
    floor = noise_floor(found.truth, run=run)
    truth = truth_statistics(found.truth, found.reference_scores, run=run)
    statistics = run_statistics(found, truth, times)
    comparison = judge(found.plan, images.folder, statistics, found.references)
    return report_of(found, floor, times, comparison, images.folder)


def measure(plan: Plan, renderer: Renderer, images: Images, run: Run) -> Measured:
    """One round of samples: render the truth, have every method make its EIA, score them."""
    s, eyes, optics = plan.settings, plan.viewpoints, plan.optics
    scene = Scene(plan.file, plan.display, s.fit_share, renderer)
    mask = observed_pixels(eyes, optics, renderer, run=run) if plan.request.lazy else None
    camera = DepthCamera(scene, s.capture_pixels_per_pitch, s.capture_spp, s.seed)
    makers = prepare_methods(plan.methods, Task(camera, s.eia_spp, mask), run=run)

    facts = scene_facts(scene, run=run)
    if "splats" in facts:
        facts = facts | {"splats": translucency(camera, run=run)}
    capture = capture_relic(camera, layers=plan.reads_layers, run=run)
    eia = pick_up_truth(scene, plan.mounted, s.eia_spp, s.seed, mask, run=run)
    sampling = (s.view_pixels_per_lens, s.view_spp, s.seed)
    views = {eye.name: render_view(scene, eye, *sampling, run=run) for eye in eyes}
    reference_views = reconstruct_views("reference", eia, eyes, optics, renderer, run=run)
    viewing = {eye.name: plan.viewing(eye) for eye in eyes}
    truth = collect_truth(capture, eia, views, reference_views, viewing, whole=mask is None)
    images.save_capture(capture, plan.display)
    images.save_truth(truth)
    images.save_heat_maps(
        "reference", heat_maps(truth, truth.views, truth.reference_views, run=run)
    )

    results = {}
    for method, maker in zip(plan.methods, makers, strict=True):
        made = make_eia(method, maker, capture, run=run)
        images.save(f"eia/{method.name}", made.eia.image)
        seen = reconstruct_views(method.name, made.eia, eyes, optics, renderer, run=run)
        images.save_views(method.name, seen)
        images.save_heat_maps(method.name, heat_maps(truth, truth.reference_views, seen, run=run))
        limit = plan.ssim_limits.get(method.name)
        results[method.name] = evaluate(method.name, made, seen, truth, limit, run=run)

    best = reference_scores(truth, run=run)
    images.finish()
    return Measured(plan, renderer.backend, run, facts, capture, truth, best, results)
