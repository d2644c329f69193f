"""The bench on a scene: time against error, one point for each algorithm and setting."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from inim.bench.contenders import Contender, display_ready, is_interpreted, prepared
from inim.bench.machine import threads
from inim.bench.quality import Judge, Looks, make_judge
from inim.bench.timing import Rounds, Timing, in_turn, pareto, ratios
from inim.display import Display
from inim.errors import SceneError
from inim.pipeline.method import reads_layers
from inim.pipeline.plan import Plan
from inim.rgbd import RGBD, LayeredRGBD

__all__ = ["ERRORS", "YARDSTICK", "bench_scene", "contender_data", "timed"]

YARDSTICK = "yardstick"
#: The errors of the plots, each smaller the better, from a contender's data.
ERRORS: dict[str, Callable[[Mapping[str, Any]], float]] = {
    "wrong_source": lambda c: c["wrong_source"],
    "eia_psnr_db": lambda c: -c["eia_psnr_db"],
    "eia_ssim": lambda c: 1 - c["eia_ssim"],
    "view_ssim_to_ceiling": lambda c: 1 - c["view_ssim_to_ceiling"],
}


def bench_scene(plan: Plan, names: Sequence[str], rounds: Rounds, listener: Any) -> dict[str, Any]:
    """Render a scene, time all contenders on it, judge what they made.

    Parameters
    ----------
    plan : Plan
        As for a validation; its sampling settings hold here too.
    names : sequence of str
        Algorithms with their options.
    rounds : Rounds
    listener : Observer

    Returns
    -------
    dict
        The keys of bench.json that a scene adds.
    """
    rendered = _rendered(plan, names, listener)
    judge = rendered.judge
    listener.stage("time")
    contenders = [
        prepared(name, rendered.layered if reads_layers(name) else judge.rgbd, plan.display)
        for name in names
    ]
    times = timed(contenders, judge.rgbd, plan.display, rounds)
    listener.stage("score")
    data = [contender_data(c, times, plan.display) | judge.errors(c) for c in contenders]
    return {
        "scene": {"path": str(plan.request.scene), "sha256": plan.file.sha256},
        "display": {"given": plan.display.given(), "derived": plan.display.derived()},
        "viewpoints": [v.name for v in plan.viewpoints],
        "picture": {
            "rows": judge.rgbd.shape[0],
            "columns": judge.rgbd.shape[1],
            "pixel_mm": judge.rgbd.pixel_mm,
        },
        "yardstick": times[YARDSTICK].as_data(),
        "contenders": marked(data),
        "noise_floor": rendered.noise_floor,
        "captured_layers": rendered.layers,
    }


@dataclass(frozen=True)
class _Rendered:
    """Ground truth and input.

    Attributes
    ----------
    judge : Judge
        With the input as one picture.
    layered : RGBD
        With its layers, where a contender reads them.
    noise_floor : dict
        See `Judge.noise_floor`.
    layers : dict or None
        What the capture of layers found: `covered_shares`, nearest first, of the picture, and
        `hidden_share` of what lies behind the front, which was left out.
    """

    judge: Judge
    layered: RGBD
    noise_floor: dict[str, float]
    layers: dict[str, Any] | None


def _rendered(plan: Plan, names: Sequence[str], listener: Any) -> _Rendered:
    """As in a validation, with its samples; no true views, none is scored."""
    from inim.render import ground_truth
    from inim.render.depth_peeling import peel
    from inim.render.scene import open_scene

    s, display = plan.settings, plan.display
    rays = [
        np.prod(display.capture_shape(s.capture_pixels_per_pitch)) * s.capture_spp,
        np.prod(display.eia_shape) * 2 * (s.eia_spp // 2),
    ]
    listener.begin(int(sum(rays)))
    listener.stage("open scene")
    fitted = open_scene(plan.file, display, s.fit_share)
    listener.stage("capture RGB-D")
    rgbd = ground_truth.capture(
        fitted,
        display,
        pixels_per_pitch=s.capture_pixels_per_pitch,
        spp=s.capture_spp,
        seed=2 * s.seed,
        observer=listener,
    )
    if not rgbd.covered.any():
        raise SceneError(f"{plan.request.scene}: the depth camera sees nothing to time with")
    layered, layers = _finite(rgbd), None
    if any(map(reads_layers, names)):
        listener.stage("capture layers")
        peeled = peel(fitted, display, pixels_per_pitch=s.capture_pixels_per_pitch)
        layered = _finite(
            ground_truth.capture_layers(fitted, peeled, spp=s.capture_spp, seed=2 * s.seed)
        )
        layers = {
            "covered_shares": [float(layer.mean()) for layer in peeled.covered],
            "hidden_share": peeled.hidden_share,
        }
    listener.stage("ground-truth EIA")
    truth = ground_truth.pickup(
        fitted, display, spp=s.eia_spp, seed=2 * s.seed + 1, observer=listener
    )
    first, second = (np.nan_to_num(half, posinf=0.0) for half in (truth.first, truth.second))
    listener.stage("reconstruct views")
    judge = make_judge(
        display_ready(_finite(rgbd)), (first + second) / 2, Looks.of(display, plan.viewpoints, s)
    )
    return _Rendered(judge, display_ready(layered), judge.noise_floor(first, second), layers)


def _finite(rgbd: RGBD) -> RGBD:
    def finite(color: np.ndarray) -> np.ndarray:
        return np.nan_to_num(color.astype(np.float32), posinf=0.0)

    if not isinstance(rgbd, LayeredRGBD):
        return replace(rgbd, color=finite(rgbd.color))
    deeper = [replace(layer, color=finite(layer.color)) for layer in rgbd.deeper]
    return replace(rgbd, color=finite(rgbd.color), deeper=tuple(deeper))


def timed(
    contenders: Sequence[Contender], rgbd: RGBD, display: Display, rounds: Rounds
) -> dict[str, Timing]:
    """Times of all contenders and of the yardstick, by name, taken in turn."""
    from inim.render.reference_kernel import Yardstick

    calls = {YARDSTICK: Yardstick(rgbd.color, display, rgbd.pixel_mm).run}
    calls |= {c.name: c.run for c in contenders}
    interpreted = [c.name for c in contenders if is_interpreted(c.name)]
    with threads(rounds.threads):
        return in_turn(calls, rounds, interpreted)


def contender_data(
    contender: Contender, times: Mapping[str, Timing], display: Display
) -> dict[str, Any]:
    """What timing says of a contender, under the names of bench.json."""
    timing = times[contender.name]
    pixels = display.eia_shape[0] * display.eia_shape[1]
    return {
        "name": contender.name,
        "prepare_s": contender.prepare_s,
        **timing.as_data(),
        "mpx_per_s": pixels / 1e6 / timing.median_s,
        **ratios(timing, times[YARDSTICK]),
    }


def marked(contenders: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The contenders with their place: `fronts` by error, and `pareto`, on any of them."""
    fronts: list[list[str]] = [[] for _ in contenders]
    for name, error in ERRORS.items():
        points = [
            (c["median_ms"], None if c[name] is None else float(error(c))) for c in contenders
        ]
        for front, is_on in zip(fronts, pareto(points), strict=True):
            front += [name] * is_on
    return [
        {**c, "fronts": front, "pareto": bool(front)}
        for c, front in zip(contenders, fronts, strict=True)
    ]
