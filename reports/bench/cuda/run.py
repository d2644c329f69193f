"""Time and scores of a validation on the graphics card and on the processor.

    python -m reports.bench.cuda.run scenes/amphora.xml -o reports/bench/cuda

It needs an NVIDIA graphics card. Every run is a separate process with an empty result cache. Each
round runs both backends in turn. The first round is not counted: it compiles the kernels. The panel
of 7680 x 4320 pixels is validated once per backend.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from inim.pipeline.options import add_shared
from inim.pipeline.timing import Rounds
from inim.report.labels import number
from inim.report.study import PagePart
from inim.system.cache import FOLDER_VARIABLE
from reports.bench.study import RUN_PARTS, add_rounds, doubts, rounds_of, run_parts, run_validation
from reports.study import Results, Study, entry, table

BACKENDS = ("cuda", "llvm")
_LARGE = "7680 x 4320"
_PANELS = {
    "nominal": (),
    _LARGE: ("-D", "inim.panel_columns=7680", "-D", "inim.panel_rows=4320"),
}


def bench_backends(
    scene: Path, rounds: Rounds, folder: Path, variables: Mapping[str, str]
) -> list[dict[str, Any]]:
    """Validate a scene with both backends in turn, and compare their scores.

    Returns one entry per panel and backend: `seconds`, the median time of the process; `parts`, the
    median seconds of the parts of a run; `scores`, the number of compared scores; `overlapping`,
    the number of those whose 95 % intervals of both backends overlap.
    """

    def validate(panel: str, backend: str) -> dict[str, Any]:
        words = ["inim.validate", str(scene), "--backend", backend, *_PANELS[panel]]
        with tempfile.TemporaryDirectory(dir=folder) as out:
            cache = {FOLDER_VARIABLE: str(Path(out, "cache"))}
            name = f"{panel}, {backend}"
            run = run_validation([*words, "-o", f"{out}/report"], {**variables, **cache}, name)
            return run | {"report": json.loads(Path(out, "report/report.json").read_text("utf-8"))}

    results = []
    for panel in _PANELS:
        # The first round compiles; the large panel is validated once.
        count, uncounted = (1, 0) if panel == _LARGE else (rounds.runs, 1)
        rows = [{b: validate(panel, b) for b in BACKENDS} for _ in range(uncounted + count)]
        first, second = (dict(_intervals(rows[-1][b]["report"])) for b in BACKENDS)
        scores = {
            "scores": len(first),
            "overlapping": sum(
                low <= second[key][1] and second[key][0] <= high
                for key, (low, high) in first.items()
            ),
        }
        for backend in BACKENDS:
            runs = [row[backend] for row in rows[uncounted:]]
            times = [run_parts(run["report"]["timings"]) for run in runs]
            device = runs[-1]["report"]["backend"]["device"]
            seconds = median(run["seconds"] for run in runs)
            parts = {part: median(t[part] for t in times) for part in RUN_PARTS}
            results.append(
                {"panel": panel, "backend": backend, "device": device, "runs": count,
                 "seconds": seconds, "parts": parts, **scores}
            )  # fmt: skip
    return results


def _intervals(data: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Names and 95 % intervals of all scores in a report."""
    if isinstance(data, Mapping):
        if "interval" in data:
            yield path, data["interval"]
        for key, value in data.items():
            yield from _intervals(value, f"{path}/{key}")


def page(results: Results) -> tuple[list[str], list[PagePart]]:
    """Remarks and the table of times."""
    remarks = [
        "Validations with default settings and an empty result cache. Parts of a run that work "
        "side by side are counted in full, so they can sum to more than the run.",
        "The backends round differently, and their textures differ by what the card's texture "
        "units lose. Their scores agree if the 95 % intervals overlap.",
    ]
    columns: dict[str, Callable[[Any], str]] = {
        **{name: entry(name) for name in ("panel", "backend", "device")},
        "runs": lambda r: str(r["runs"]),
        "seconds": lambda r: number(r["seconds"], 1),
        **{name: entry("parts", name, text=partial(number, digits=2)) for name in RUN_PARTS},
        "intervals that overlap": lambda r: f"{r['overlapping']} of {r['scores']}",
    }
    tables = [table("Time by backend", results["backends"], columns)]
    return remarks, [PagePart("backends", "Backends", "", tables)]


def measure(scene: Path, **rounds: Any) -> list[dict[str, Any]]:
    """Measure in a temporary folder."""
    with tempfile.TemporaryDirectory() as folder:
        return bench_backends(scene, Rounds(**rounds), Path(folder), os.environ)


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the scene and the rounds."""
    add_shared(parser, "scene")
    add_rounds(parser)


STUDY = Study(
    "reports.bench.cuda.run", "Bench: backends", __doc__, arguments,
    lambda args: {"backends": {"scene": args.scene, **rounds_of(args)}}, measure, page,
    stem="bench", doubts=doubts,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(STUDY.main())
