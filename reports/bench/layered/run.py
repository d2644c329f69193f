"""What one RGB-D picture and its layers are worth on several scenes, and cost.

    python -m reports.bench.layered.run scenes/two_spheres.xml ... -o reports/bench/layered

takes some minutes.
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

# How far below the noise floor counts as reaching it, and what layers may cost.
_CLOSE_DB = 1.5
_MOST_TIMES = 3.0
#: One layer and all of them, at equal samples.
METHODS = ("template", "layered:samples=1", "template:samples=4", "layered:samples=4")
# From a method of the bench of a scene.
_KEPT = (
    "name", "prepare_s", "cold_s", "median_ms", "min_ms", "spread", "runs", "slow", "mpx_per_s",
    "ratio", "ratio_min", "hole_fraction", "eia_ssim", "eia_psnr_db", "view_ssim_to_reference",
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
        A scene each, under the names of bench.json. `to_floor_db` is how far a method's EIA is
        above the noise floor, negative below it; `template_ratio` its time in those of the
        template with as many samples, `template_ratio_min` the same by the fastest runs.
    """
    return [_of_scene(plan, rounds, listener) for plan in plans]


def _of_scene(plan: Plan, rounds: Rounds, listener: Any) -> dict[str, Any]:
    scene = to_builtins(bench_scene(plan, METHODS, rounds, Renderer("llvm", listener)))
    floor = scene["noise_floor"]["eia_psnr_db"]
    flat = [a | a["scores"] for a in scene["algorithms"]]
    methods = [{key: a[key] for key in _KEPT} for a in flat]
    one, all_of_one, four, all_of_four = methods
    for method, template in ((one, one), (all_of_one, one), (four, four), (all_of_four, four)):
        method["to_floor_db"] = method["eia_psnr_db"] - floor
        method["template_ratio"] = method["median_ms"] / template["median_ms"]
        method["template_ratio_min"] = method["min_ms"] / template["min_ms"]
    title = plan.settings.title or plan.request.scene.stem
    for c in methods:
        listener.line(
            f"{title}: {c['name']:18}  {c['median_ms']:8.2f} ms  {c['ratio']:6.2f} yardsticks  "
            f"{c['template_ratio']:.2f} times template  EIA PSNR {c['eia_psnr_db']:.2f} dB  "
            f"{c['to_floor_db']:+.2f} dB to the noise floor"
        )
    same = ("path", "sha256", "picture", "captured_layers", "yardstick", "noise_floor")
    return {"title": title} | {key: scene[key] for key in same} | {"algorithms": methods}


# -- the report ---------------------------------------------------------------------------------


def parts_of(data: Mapping[str, Any]) -> list[PagePart]:
    """Tables and plot of all scenes."""
    lead = (
        "One RGB-D picture knows nothing behind its front surface; a picture with its layers does. "
        "Left: how near the EIA comes to the noise of its ground truth, one half of whose samples "
        "scores the floor against the other. Right: the time of both at equal samples. Where a "
        "pixel's four rays meet the same thing there is nothing to average: 'rays differ' is the "
        "share of the panel where they do not."
    )
    scenes = items(data, "layers")
    return [PagePart("layers", "Layers", lead, _tables(scenes), "layers", _draw(scenes))]


def _decibels(value: float | None) -> str:
    """JSON has null for the infinite one of equal pictures."""
    return number(math.inf if value is None else value, 2)


def _tables(scenes: Sequence[Mapping[str, Any]]) -> list[Table]:
    heads = [
        "scene", "algorithm", *TIME_HEADS, "times template", "by fastest", "EIA SSIM",
        "EIA PSNR dB", "to noise floor dB", "view SSIM to reference", "rays differ",
    ]  # fmt: skip
    rows = [
        [
            found["title"],
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
        for found in scenes
        for c in items(found, "algorithms")
    ]
    captured = [_captured_row(found, part(found, "captured_layers")) for found in scenes]
    capture_heads = [
        "scene", "noise floor dB", "picture", "layers", "front covers", "what lies behind",
        "of it hidden, left out", "yardstick ms",
    ]  # fmt: skip
    return [
        Table("One layer and all, at equal samples", heads, rows),
        Table("What the capture found, in shares of the picture", capture_heads, captured),
    ]


def _captured_row(found: Mapping[str, Any], captured: Mapping[str, Any]) -> list[str]:
    front, *deeper = captured["covered_shares"]
    return [
        found["title"],
        _decibels(found["noise_floor"]["eia_psnr_db"]),
        f"{found['picture']['columns']} × {found['picture']['rows']}",
        str(1 + len(deeper)),
        per_cent(front, 1),
        per_cent(sum(deeper), 2),
        per_cent(captured["hidden_share"], 1),
        milliseconds(found["yardstick"]["median_ms"]),
    ]


def _draw(scenes: Sequence[Mapping[str, Any]]) -> Any:
    """A row for each scene: PSNR and the noise floor, time and what layers may cost."""
    figure, (quality, cost) = new_figure(2, 1.8 + 0.55 * len(scenes), sharey=True)
    for row, found in enumerate(scenes):
        floor = part(found, "noise_floor").get("eia_psnr_db")
        if is_number(floor):
            height = [row - 0.3, row + 0.3]
            quality.plot([floor, floor], height, **LINES["floor"])
            close = {"color": SOFT, "alpha": 0.15, "linewidth": 0}
            quality.fill_betweenx(height, floor - _CLOSE_DB, floor, **close)
        methods = found["algorithms"]
        for method in methods:
            name = method["name"]
            if is_number(method["eia_psnr_db"]):
                _mark(quality, method["eia_psnr_db"], row, name)
            _mark(cost, method["ratio"], row, name)
        for template, layered in zip(methods[::2], methods[1::2], strict=True):
            both = [template["ratio"], layered["ratio"]]
            cost.plot(both, [row, row], **LINES["front"])
            cost.plot(_MOST_TIMES * both[0], row, "|", color=SOFT, markersize=14)
    cost.set_xscale("log")
    style(quality, f"Dashed: noise floor; shaded: {_CLOSE_DB:g} dB below it", "EIA PSNR, dB", "")
    style(cost, f"Ticks: {_MOST_TIMES:g} times template", "yardsticks per EIA", "")
    quality.set_yticks(range(len(scenes)), [found["title"] for found in scenes])
    quality.invert_yaxis()
    plain_ticks(cost)
    handles = dict(zip(*reversed(quality.get_legend_handles_labels()), strict=True))
    figure.legend(
        handles.values(), handles.keys(), loc="outside lower center", ncols=4, fontsize=8,
        frameon=False,
    )  # fmt: skip
    return figure


def _mark(axis: Any, value: float, row: int, name: str) -> None:
    """An algorithm's mark on a scene's row; hollow with one sample a pixel."""
    colour = colour_of(name)
    fill = colour if name.endswith("samples=4") else "white"
    mark = marker_of(name)
    axis.plot(value, row, mark, color=colour, markerfacecolor=fill, label=name, zorder=3)


# -- the command --------------------------------------------------------------------------------


def main() -> int:
    """Carry out the study; the exit code."""
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
