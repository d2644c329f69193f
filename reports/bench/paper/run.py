"""Readings of the paper and its rivals on covered pictures; growth of `template`'s time.

    python -m reports.bench.paper.run --data ../shared/data -o reports/bench/paper

The folder `--data` has `rgbd` with a photograph and `relics` with scans; inputs whose files are
missing are left out. The study takes about a quarter of an hour: plain Python is slow.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from inim.pipeline.timing import Rounds
from inim.system.errors import InimError
from inim.system.process.machine import cpu_model
from reports.bench.paper.experiments import FIGURES, PICTURES, SAMPLE, time_all, time_figure
from reports.bench.paper.inputs import COVERED, DISPLAY, EMPTY, files_of, read_input
from reports.bench.paper.page import page
from reports.bench.paper.quality import measure_quality
from reports.bench.paper.scaling import bench_scaling
from reports.bench.study import doubts
from reports.study import Study


def measure(part: str, runs: int, files: Sequence[Path] = ()) -> dict[str, Any]:
    """Measure the growth of time, the paper's figures, or an input by its name."""
    from inim.render import variant

    variant.use("llvm")
    if part == "scaling":
        return bench_scaling(Rounds(runs))
    if part == "figures":
        figures = {
            figure: {picture: time_figure(figure, picture, runs) for picture in PICTURES}
            for figure in FIGURES
        }
        return {"runs": runs, "processor": cpu_model(), "figures": figures}
    source = read_input(part, files)
    if part in COVERED and not source.rgbd.covered.all():
        raise InimError(f"{part}: {source.rgbd.covered.mean():.1%} of the picture is covered")
    times = time_all(DISPLAY, source.rgbd, SAMPLE, runs)
    return {"quality": measure_quality(source), "times": times}


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--runs", type=int, default=Rounds.runs, help="rounds of all methods (9)")
    parser.add_argument("--data", type=Path, default=Path("data"), help="photograph and relics")


def _cases(args: argparse.Namespace) -> Mapping[str, Mapping[str, Any]]:
    runs = {"runs": args.runs}
    inputs = {name: files_of(name, args.data) for name in (*COVERED, EMPTY)}
    return {part: {"part": part, **runs} for part in ("scaling", "figures")} | {
        name: {"part": name, **runs, "files": files}
        for name, files in inputs.items()
        if all(file.is_file() for file in files)
    }


STUDY = Study(
    "reports.bench.paper.run", "Bench: readings of the paper", __doc__, _arguments, _cases, measure,
    page, stem="bench", doubts=doubts,
    code=("inim/display", "inim/generators", "inim/image", "inim/pipeline/stages",
          "inim/pipeline/timing.py", "inim/render", "inim/scores/metrics",
          "inim/scores/regression/noise_free.py", "inim/scores/regression/scores.py"),
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(STUDY.main())
