"""The bench on a scene: time against error, one point for each algorithm and setting."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from inim.bench.evaluate import Reference, evaluate, make_reference, mark_fronts, noise_floor
from inim.display import Display
from inim.errors import SceneError, UsageError
from inim.generators import check_algorithm, prepare, properties
from inim.pipeline.plan import Plan
from inim.pipeline.timing import (
    YARDSTICK,
    Rounds,
    TimedMethod,
    Timing,
    display_ready,
    prepare_method,
    ratios,
    time_methods,
)
from inim.rgbd import RGBD, LayeredRGBD

__all__ = ["DEFAULT", "available", "bench_scene", "choose_algorithms", "method_data"]

#: What is measured where nothing is named: every algorithm, and the settings that cost time.
DEFAULT = (
    "template",
    "template:samples=2",
    "template:samples=4",
    "wang2024",
    "wang2024:matching=ray",
    "gu2020",
    "gu2020:step_mm=0.2",
    "li2012",
    "li2012:fill=nearest",
)
# What a name is tried on: as small as a display gets.
_TRIAL = Display(1.0, 3.0, 3.3, 0.25, 1, 1)


def available(names: Iterable[str]) -> tuple[list[str], list[str]]:
    """Those of `names` that exist here, and a note on each that does not."""
    found, notes = [], []
    for name in names:
        try:
            prepare(_TRIAL, name, shape=(4, 4), pixel_mm=0.25)
        except (UsageError, ImportError) as error:
            notes.append(f"left out: {error}")
        else:
            found.append(name)
    return found, notes


def choose_algorithms(text: str | None) -> tuple[Sequence[str], list[str]]:
    """The algorithms of a ``--algorithms`` text, all of which must exist; else `DEFAULT`'s."""
    if text is None:
        return available(DEFAULT)
    names = list(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
    if not names:
        raise UsageError("--algorithms: none given; name at least one, such as 'template'")
    for name in names:
        check_algorithm(name)
    return names, []


def bench_scene(plan: Plan, names: Sequence[str], rounds: Rounds, listener: Any) -> dict[str, Any]:
    """Render a scene, time all methods on it, and evaluate their EIAs.

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
    inputs = _render(plan, names, listener)
    listener.stage("time")
    methods = [
        prepare_method(
            name, inputs.layered if properties(name).reads_layers else inputs.rgbd, plan.display
        )
        for name in names
    ]
    times = time_methods(methods, inputs.rgbd, plan.display, rounds)
    listener.stage("score")
    data = [method_data(m, times, plan.display) | evaluate(m, inputs.reference) for m in methods]
    return {
        "scene": {"path": str(plan.request.scene), "sha256": plan.file.sha256},
        "display": {"given": plan.display.given(), "derived": plan.display.derived()},
        "viewpoints": [v.name for v in plan.viewpoints],
        "picture": {
            "rows": inputs.rgbd.shape[0],
            "columns": inputs.rgbd.shape[1],
            "pixel_mm": inputs.rgbd.pixel_mm,
        },
        "yardstick": times[YARDSTICK].as_data(),
        "contenders": mark_fronts(data),
        "noise_floor": inputs.noise_floor,
        "captured_layers": inputs.layers,
    }


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
    layers : dict or None
        What the capture of layers found: `covered_shares`, nearest first, of the picture, and
        `hidden_share` of what lies behind the front, which was left out.
    """

    rgbd: RGBD
    layered: RGBD
    reference: Reference
    noise_floor: dict[str, float]
    layers: dict[str, Any] | None

    def of(self, name: str) -> RGBD:
        """What a method reads."""
        return self.layered if properties(name).reads_layers else self.rgbd


def _render(plan: Plan, names: Sequence[str], listener: Any) -> _Inputs:
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
    if any(properties(name).reads_layers for name in names):
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
    ready = display_ready(_finite(rgbd))
    reference = make_reference(ready, (first + second) / 2, display, plan.viewpoints, s)
    floor = noise_floor(first, second, reference.views_of)
    return _Inputs(ready, display_ready(layered), reference, floor, layers)


def _finite(rgbd: RGBD) -> RGBD:
    def finite(color: np.ndarray) -> np.ndarray:
        return np.nan_to_num(color.astype(np.float32), posinf=0.0)

    if not isinstance(rgbd, LayeredRGBD):
        return replace(rgbd, color=finite(rgbd.color))
    deeper = [replace(layer, color=finite(layer.color)) for layer in rgbd.deeper]
    return replace(rgbd, color=finite(rgbd.color), deeper=tuple(deeper))


def method_data(
    method: TimedMethod, times: Mapping[str, Timing], display: Display
) -> dict[str, Any]:
    """What timing says of a method, under the names of bench.json."""
    timing = times[method.name]
    pixels = display.eia_shape[0] * display.eia_shape[1]
    return {
        "name": method.name,
        "prepare_s": method.prepare_s,
        **timing.as_data(),
        "mpx_per_s": pixels / 1e6 / timing.median_s,
        **ratios(timing, times[YARDSTICK]),
    }
