"""What a plan's stages should take, for its progress bar.

Seconds on two processors, from a profile of the amphora; a machine's own pace is found as it goes.
"""

from __future__ import annotations

from inim.lens import lens_model
from inim.pipeline.compiled_marks import is_compiled
from inim.pipeline.plan import Plan
from inim.pipeline.stages.method import Method
from inim.process.forecast import Step

_PREPARE_S = 0.3
_LIBRARIES_S = 2.0
_OPEN_S = 0.4
# The renderer's kernels for a scene, and those of an algorithm while others render.
_KERNELS_S = 2.0
_COMPILE_S = 3.0
_PATH_S = 1.4e-7
_REFRACTED_S = 1.5e-8
# Path traced through the lens sheet as a mesh.
_MESH_S = 5e-7
_GENERATE_S_A_PIXEL = 5e-7
_SCORE_S_A_PANEL_PIXEL = 4e-7
_SCORE_S_A_VIEW_PIXEL = 2.7e-6
_SCORING_LIBRARIES_S = 1.0
_TIMING_S = 20.0
_REPORT_S = 1.5


def expected_steps(plan: Plan) -> list[Step]:
    """The stages of one round of samples and of its report, in their order."""
    methods, eyes = plan.methods, len(plan.viewpoints)
    names = [f"{method.verb} {method.name}" for method in methods]
    steps = [Step(name, _PREPARE_S + _LIBRARIES_S * (name == names[0])) for name in names]
    steps += [Step("open scene", _OPEN_S), *capture_steps(plan)]
    view = plan.view_pixels * _even(plan.settings.view_spp)
    steps += [Step("ground-truth views", view * _PATH_S, view)] * eyes
    steps += view_steps(plan)
    views_s = eyes * plan.view_pixels * _SCORE_S_A_VIEW_PIXEL
    scored_s = views_s + _panel(plan) * _SCORE_S_A_PANEL_PIXEL
    for number, method in enumerate(methods):
        libraries = 0.0 if number else _SCORING_LIBRARIES_S
        steps += [_making(plan, method), *view_steps(plan), Step("score", scored_s + libraries)]
    steps += [Step("score", views_s / 2)]
    steps += [Step("time", _TIMING_S * len(methods))] if plan.request.time else []
    return [*steps, Step("score", scored_s / 2), Step("write report", _REPORT_S)]


def capture_steps(plan: Plan) -> list[Step]:
    """The RGB-D picture and the ground-truth EIA."""
    s, (rows, columns) = plan.settings, plan.capture_shape
    picture = rows * columns * _even(s.capture_spp)
    panel = _panel(plan) * _even(s.eia_spp)
    steps = [Step("capture RGB-D", _KERNELS_S + picture * _PATH_S, picture)]
    if plan.reads_layers:
        steps += [Step("capture layers", _KERNELS_S + 2 * picture * _PATH_S)]
    return [*steps, Step("ground-truth EIA", panel * _PATH_S, panel)]


def view_steps(plan: Plan) -> list[Step]:
    """The views of one EIA, each of three halves."""
    rays = plan.view_pixels * 3 * plan.optics.half_spp
    is_mesh = lens_model(plan.settings.lens_model).mesh is not None
    seconds = rays * (_MESH_S if is_mesh else _REFRACTED_S)
    return [Step("reconstruct views", seconds, rays)] * len(plan.viewpoints)


def _making(plan: Plan, method: Method) -> Step:
    """A method's EIA."""
    name = f"{method.verb} {method.name}"
    if method.spp is not None:
        rays = _panel(plan) * _even(method.spp or plan.settings.eia_spp)
        return Step(name, rays * _PATH_S, rays)
    compiling = _COMPILE_S if method.times and not is_compiled(method.name, plan.display) else 0.0
    return Step(name, compiling + 3 * _panel(plan) * _GENERATE_S_A_PIXEL)


def _panel(plan: Plan) -> int:
    rows, columns = plan.display.eia_shape
    return rows * columns


def _even(samples: int) -> int:
    """Samples of both halves."""
    return 2 * max(1, samples // 2)
