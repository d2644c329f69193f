"""The bench of layers: what one picture and its layers are worth on several scenes, and cost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from inim.bench.scene import bench_scene
from inim.pipeline.plan import Plan
from inim.pipeline.timing import Rounds

__all__ = ["CONTENDERS", "bench_layers"]

#: One layer and all of them, at equal samples.
CONTENDERS = ("template", "layered:samples=1", "template:samples=4", "layered:samples=4")
# From a contender of the bench of a scene.
_KEPT = (
    "name", "prepare_s", "cold_s", "median_ms", "min_ms", "spread", "runs", "slow", "mpx_per_s",
    "ratio", "ratio_min", "hole_fraction", "eia_ssim", "eia_psnr_db", "view_ssim_to_ceiling",
    "averaged_share",
)  # fmt: skip


def bench_layers(plans: Sequence[Plan], rounds: Rounds, listener: Any) -> list[dict[str, Any]]:
    """Bench each scene with and without its layers.

    Parameters
    ----------
    plans : sequence of Plan
        One for each scene.
    rounds : Rounds
    listener : Observer

    Returns
    -------
    list of dict
        A scene each, under the names of bench.json. `to_floor_db` is how far a contender's EIA is
        above the noise floor, negative below it; `template_ratio` its time in those of the
        template with as many samples, `template_ratio_min` the same by the fastest runs.
    """
    return [_of_scene(plan, rounds, listener) for plan in plans]


def _of_scene(plan: Plan, rounds: Rounds, listener: Any) -> dict[str, Any]:
    found = bench_scene(plan, CONTENDERS, rounds, listener)
    floor = found["noise_floor"]["eia_psnr_db"]
    contenders = [{key: c[key] for key in _KEPT} for c in found["contenders"]]
    one, all_of_one, four, all_of_four = contenders
    for contender, template in ((one, one), (all_of_one, one), (four, four), (all_of_four, four)):
        contender["to_floor_db"] = contender["eia_psnr_db"] - floor
        contender["template_ratio"] = contender["median_ms"] / template["median_ms"]
        contender["template_ratio_min"] = contender["min_ms"] / template["min_ms"]
    title = plan.settings.title or plan.request.scene.stem
    for c in contenders:
        listener.line(
            f"{title}: {c['name']:18}  {c['median_ms']:8.2f} ms  {c['ratio']:6.2f} yardsticks  "
            f"{c['template_ratio']:.2f} times template  EIA PSNR {c['eia_psnr_db']:.2f} dB  "
            f"{c['to_floor_db']:+.2f} dB to the noise floor"
        )
    same = ("scene", "picture", "captured_layers", "yardstick", "noise_floor")
    return {"title": title} | {key: found[key] for key in same} | {"contenders": contenders}
