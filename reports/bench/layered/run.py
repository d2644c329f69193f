"""Quality and time of layered depth images compared with single RGB-D pictures, on several scenes.

    python -m reports.bench.layered.run scenes/two_spheres.xml ... -o reports/bench/layered

The study takes several minutes.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from msgspec import to_builtins

from inim.bench.evaluate import bench_scene
from inim.pipeline.plan import Plan
from inim.pipeline.stages.scene import Renderer
from inim.report.bench import TIME_HEADS, milliseconds, time_cells, times
from inim.report.labels import is_number, number, per_cent
from inim.report.plots import LINES, SOFT, colour_of, marker_of, new_figure, plain_ticks, style
from inim.report.study import PagePart, Table
from inim.timing import Rounds
from reports.bench.parts import items, part
from reports.bench.study import add_scene_arguments, new_parser, plan_of, run_study

# Largest distance below the noise floor that counts as reaching it, and largest accepted time of
# layers in times of `template`.
_CLOSE_DB = 1.5
_MAX_RATIO = 3.0
#: One layer and all of them, at equal samples.
METHODS = ("template", "layered:samples=1", "template:samples=4", "layered:samples=4")
# Fields copied from each method of a scene's bench.
_METHOD_FIELDS = (
    "name", "prepare_s", "cold_s", "median_ms", "min_ms", "spread", "runs", "slow", "mpx_per_s",
    "ratio", "ratio_min", "hole_fraction", "eia_ssim", "eia_psnr_db", "view_ssim_to_reference",
    "averaged_share",
)  # fmt: skip


def bench_layers(plans: Sequence[Plan], rounds: Rounds, listener: Any) -> list[dict[str, Any]]:
    """Bench each scene with and without its layers.

    Parameters
    ----------
    plans : sequence of Plan
        One plan per scene.
    rounds : Rounds
    listener : Observer

    Returns
    -------
    list of dict
        One entry per scene, under the names of bench.json. `to_floor_db`: PSNR of a method's EIA
        minus the noise floor. `template_ratio`: time divided by that of `template` with as many
        samples; `template_ratio_min`: the same for the fastest runs.
    """
    return [_bench_scene(plan, rounds, listener) for plan in plans]


def _bench_scene(plan: Plan, rounds: Rounds, listener: Any) -> dict[str, Any]:
    measured, _ = bench_scene(plan, METHODS, rounds, Renderer("llvm", listener))
    scene = to_builtins(measured)
    floor = scene["noise_floor"]["eia_psnr_db"]
    flat = [a | a["scores"] for a in scene["algorithms"]]
    methods = [{key: a[key] for key in _METHOD_FIELDS} for a in flat]
    template_1, layered_1, template_4, layered_4 = methods
    for method, template in (
        (template_1, template_1),
        (layered_1, template_1),
        (template_4, template_4),
        (layered_4, template_4),
    ):
        method["to_floor_db"] = method["eia_psnr_db"] - floor
        method["template_ratio"] = method["median_ms"] / template["median_ms"]
        method["template_ratio_min"] = method["min_ms"] / template["min_ms"]
    title = plan.settings.title or plan.request.scene.stem
    for c in methods:
        listener.line(
            f"{title}: {c['name']:18}  {c['median_ms']:8.2f} ms  {c['ratio']:6.2f} kernel times  "
            f"{c['template_ratio']:.2f} times template  EIA PSNR {c['eia_psnr_db']:.2f} dB  "
            f"{c['to_floor_db']:+.2f} dB to the noise floor"
        )
    fields = ("path", "sha256", "picture", "captured_layers", "yardstick", "noise_floor")
    return {"title": title} | {key: scene[key] for key in fields} | {"algorithms": methods}


# -- the report ---------------------------------------------------------------------------------


def parts_of(data: Mapping[str, Any]) -> list[PagePart]:
    """Part of the page: tables and plot of all scenes."""
    lead = (
        "An RGB-D picture contains only the front surfaces; a layered depth image also contains "
        "the surfaces behind them. Left: PSNR of the EIA and the noise floor, which is the score "
        "of one half of the ground truth's samples against the other half. Right: time of both "
        "inputs with equal samples. 'Rays differ' is the share of the panel pixels whose four "
        "rays meet different picture pixels; only these pixels are averages."
    )
    scenes = items(data, "layers")
    return [PagePart("layers", "Layers", lead, _tables(scenes), "layers", _draw(scenes))]


def _decibels(value: float | None) -> str:
    """Text of a PSNR; None is the infinite PSNR of equal pictures."""
    return number(math.inf if value is None else value, 2)


def _tables(scenes: Sequence[Mapping[str, Any]]) -> list[Table]:
    heads = [
        "scene", "algorithm", *TIME_HEADS, "× template", "by fastest", "EIA SSIM",
        "EIA PSNR dB", "to noise floor dB", "view SSIM to reference", "rays differ",
    ]  # fmt: skip
    rows = [
        [
            scene["title"],
            c["name"],
            *time_cells(c),
            times(c["template_ratio"]),
            times(c["template_ratio_min"]),
            number(c["eia_ssim"], 4),
            _decibels(c["eia_psnr_db"]),
            f"{c['to_floor_db']:+.2f}",
            number(c["view_ssim_to_reference"], 4),
            per_cent(c["averaged_share"], 1),
        ]
        for scene in scenes
        for c in items(scene, "algorithms")
    ]
    captured = [_captured_row(scene, part(scene, "captured_layers")) for scene in scenes]
    capture_heads = [
        "scene", "noise floor dB", "picture", "layers", "front surfaces", "deeper surfaces",
        "hidden share of deeper surfaces", "kernel ms",
    ]  # fmt: skip
    return [
        Table("One layer and all layers, with equal samples", heads, rows),
        Table("Captured surfaces, as shares of the picture", capture_heads, captured),
    ]


def _captured_row(scene: Mapping[str, Any], captured: Mapping[str, Any]) -> list[str]:
    front, *deeper = captured["covered_shares"]
    return [
        scene["title"],
        _decibels(scene["noise_floor"]["eia_psnr_db"]),
        f"{scene['picture']['columns']} × {scene['picture']['rows']}",
        str(1 + len(deeper)),
        per_cent(front, 1),
        per_cent(sum(deeper), 2),
        per_cent(captured["hidden_share"], 1),
        milliseconds(scene["yardstick"]["median_ms"]),
    ]


def _draw(scenes: Sequence[Mapping[str, Any]]) -> Any:
    """Plot PSNR with the noise floor, and time with its limit, one row per scene."""
    figure, (quality, cost) = new_figure(2, 1.8 + 0.55 * len(scenes), sharey=True)
    for row, scene in enumerate(scenes):
        floor = part(scene, "noise_floor").get("eia_psnr_db")
        if is_number(floor):
            height = [row - 0.3, row + 0.3]
            quality.plot([floor, floor], height, **LINES["floor"])
            close = {"color": SOFT, "alpha": 0.15, "linewidth": 0}
            quality.fill_betweenx(height, floor - _CLOSE_DB, floor, **close)
        methods = scene["algorithms"]
        for method in methods:
            name = method["name"]
            if is_number(method["eia_psnr_db"]):
                _mark(quality, method["eia_psnr_db"], row, name)
            _mark(cost, method["ratio"], row, name)
        for template, layered in zip(methods[::2], methods[1::2], strict=True):
            ratios = [template["ratio"], layered["ratio"]]
            cost.plot(ratios, [row, row], **LINES["front"])
            cost.plot(_MAX_RATIO * ratios[0], row, "|", color=SOFT, markersize=14)
    cost.set_xscale("log")
    style(quality, f"Dashed: noise floor; shaded: {_CLOSE_DB:g} dB below it", "EIA PSNR, dB", "")
    style(cost, f"Ticks: {_MAX_RATIO:g} times template", "kernel times per EIA", "")
    quality.set_yticks(range(len(scenes)), [scene["title"] for scene in scenes])
    quality.invert_yaxis()
    plain_ticks(cost)
    handles = dict(zip(*reversed(quality.get_legend_handles_labels()), strict=True))
    figure.legend(
        handles.values(), handles.keys(), loc="outside lower center", ncols=4, fontsize=8,
        frameon=False,
    )  # fmt: skip
    return figure


def _mark(axis: Any, value: float, row: int, name: str) -> None:
    """Draw an algorithm's mark in a scene's row; it is hollow for one sample per pixel."""
    colour = colour_of(name)
    fill = colour if name.endswith("samples=4") else "white"
    mark = marker_of(name)
    axis.plot(value, row, mark, color=colour, markerfacecolor=fill, label=name, zorder=3)


# -- the command --------------------------------------------------------------------------------


def main() -> int:
    """Run the study and return the exit code."""
    parser = new_parser(__doc__, "bench-layered")
    parser.add_argument(
        "scenes", type=Path, nargs="+", metavar="SCENE", help="Mitsuba scene (.xml)"
    )
    add_scene_arguments(parser)
    args = parser.parse_args()

    def measure(rounds: Rounds, listener: Any, folder: Path) -> dict[str, Any]:  # noqa: ARG001
        plans = [plan_of(args, scene) for scene in args.scenes]
        return {"layers": bench_layers(plans, rounds, listener)}

    return run_study(args, "reports.bench.layered.run", "Bench: layers", measure, parts_of)


if __name__ == "__main__":
    sys.exit(main())
