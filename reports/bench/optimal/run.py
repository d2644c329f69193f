"""Time of the optimal EIA, by lens model and number of viewpoints.

    python -m reports.bench.optimal.run scenes/amphora.xml -o reports/bench/optimal

The time includes the rendering of the ground-truth views, the matrices and the search, without the
result cache; the scene is open and all kernels are compiled.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from statistics import median
from time import perf_counter, process_time
from typing import Any

from inim.display.viewpoint import zone_eyes
from inim.image.noisy_image import NoisyImage
from inim.pipeline.plan import Plan
from inim.pipeline.stages.ground_truth import render_ground_truth_eia
from inim.pipeline.stages.optimal import ScoredViews, optimise_eia
from inim.pipeline.stages.scene import Renderer, Scene
from inim.pipeline.stages.stage import Run
from inim.report.labels import number
from inim.report.study import PagePart, Table
from inim.timing import Rounds
from reports.bench.parts import items
from reports.bench.study import add_scene_arguments, new_parser, plan_of, run_study

_LENS_MODELS = ("pinhole", "thick")
#: Further viewpoints, in a row across the viewing zone.
_FURTHER_VIEWPOINTS = (0, 5)


def bench_optimal(plan: Plan, rounds: Rounds, listener: Any) -> list[dict[str, Any]]:
    """Time the optimal EIA of a scene.

    Returns
    -------
    list of dict
        One entry per lens model and number of viewpoints, under the names of bench.json:
        `seconds`, the median of wall-clock times; and `processor_seconds`, of all threads.
    """
    settings = plan.settings
    scene = plan.camera(Renderer("llvm", listener)).scene
    start = render_ground_truth_eia(
        scene, plan.misaligned_display, settings.eia_spp, settings.seed, None, run=Run()
    )
    results = []
    for lens_model in _LENS_MODELS:
        optics = replace(plan.optics, lens_model=lens_model)
        # Compiles the kernels.
        _time(scene, ScoredViews(optics, plan.viewpoints[:1], settings.view_spp), start)
        for further in _FURTHER_VIEWPOINTS:
            eyes = (*plan.viewpoints, *zone_eyes(plan.misaligned_display, further))
            views = ScoredViews(optics, eyes, settings.view_spp)
            listener.stage(f"{lens_model}, {len(eyes)} viewpoints")
            times = [_time(scene, views, start) for _ in range(rounds.runs)]
            seconds, processor_seconds = (median(column) for column in zip(*times, strict=True))
            results.append(
                {
                    "scene": settings.title or plan.request.scene.stem,
                    "lens_model": lens_model,
                    "viewpoints": len(eyes),
                    "seconds": seconds,
                    "processor_seconds": processor_seconds,
                    "runs": rounds.runs,
                }
            )
    return results


def _time(scene: Scene, views: ScoredViews, start: NoisyImage) -> tuple[float, float]:
    """Wall-clock and processor seconds of one optimisation."""
    begin = perf_counter(), process_time()
    optimise_eia.function("optimal", scene, views, start)
    return perf_counter() - begin[0], process_time() - begin[1]


def parts_of(data: Mapping[str, Any]) -> list[PagePart]:
    """Part of the page: the table of times."""
    lead = (
        "Time of the EIA whose views come closest to the scene, with the rendering of its "
        "ground-truth views. Processor seconds are those of all threads: divided by two, they are "
        "the time on two cores that nothing else uses, or less."
    )
    heads = ["scene", "lens model", "viewpoints", "seconds", "processor seconds", "runs"]
    rows = [
        [
            str(row["scene"]),
            str(row["lens_model"]),
            str(row["viewpoints"]),
            number(row["seconds"], 1),
            number(row["processor_seconds"], 1),
            str(row["runs"]),
        ]
        for row in items(data, "optimal")
    ]
    remark = (
        "The optimal EIA is timed without the kernel. The only warm-up is one run per lens model, "
        "from one viewpoint."
    )
    tables = [Table("Time", heads, rows)]
    return [PagePart("optimal", "Optimal EIA", lead, tables, remarks=[remark])]


def main() -> int:
    """Run the study and return the exit code."""
    parser = new_parser(__doc__, "bench-optimal")
    parser.add_argument("scene", type=Path, metavar="SCENE", help="Mitsuba scene (.xml)")
    add_scene_arguments(parser)
    args = parser.parse_args()

    def measure(rounds: Rounds, listener: Any, folder: Path) -> dict[str, Any]:  # noqa: ARG001
        return {"optimal": bench_optimal(plan_of(args, args.scene), rounds, listener)}

    return run_study(args, "reports.bench.optimal.run", "Bench: optimal EIA", measure, parts_of)


if __name__ == "__main__":
    sys.exit(main())
