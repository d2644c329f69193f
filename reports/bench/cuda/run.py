"""Time and scores of a validation on the graphics card and on the processor.

    python -m reports.bench.cuda.run scenes/amphora.xml -o reports/bench/cuda

It needs an NVIDIA graphics card. Every run is a separate process with an empty result cache. Each
round runs both backends in turn. The first round is not counted: it compiles the kernels. The panel
of 7680 x 4320 pixels is validated once per backend.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from statistics import median
from typing import Any

from inim.pipeline.timing import Rounds
from inim.report.labels import number
from inim.report.study import PagePart, Table
from inim.system.cache import FOLDER_VARIABLE
from reports.bench.parts import RUN_PARTS, items, run_parts
from reports.bench.study import new_parser, run_study, run_validation

BACKENDS = ("cuda", "llvm")
_LARGE = "7680 x 4320"
_PANELS = {
    "nominal": (),
    _LARGE: ("-D", "inim.panel_columns=7680", "-D", "inim.panel_rows=4320"),
}


def bench_backends(
    scene: Path, rounds: Rounds, listener: Any, folder: Path, variables: Mapping[str, str]
) -> list[dict[str, Any]]:
    """Validate a scene with both backends in turn, and compare their scores.

    Returns
    -------
    list of dict
        One entry per panel and backend, under the names of bench.json: `seconds`, the median time
        of the process; `parts`, the median seconds of the parts of a run; and `scores`, the number
        of compared scores, with `overlapping`, the number of those whose 95 % intervals of both
        backends overlap.
    """
    results = []
    for panel, words in _PANELS.items():
        count = 1 if panel == _LARGE else rounds.runs
        uncounted = 0 if panel == _LARGE else 1
        runs: dict[str, list[dict[str, Any]]] = {name: [] for name in BACKENDS}
        reports: dict[str, Any] = {}
        for index in range(uncounted + count):
            for name in BACKENDS:
                listener.stage(f"{panel}, {name}, run {index + 1} of {uncounted + count}")
                out = folder / "report"
                command = ["inim.validate", str(scene), "--backend", name, "-o", str(out), *words]
                cache = {FOLDER_VARIABLE: str(folder / "cache")}
                run = run_validation(command, {**variables, **cache}, f"{panel}, {name}")
                reports[name] = json.loads((out / "report.json").read_text("utf-8"))
                for path in (out, folder / "cache"):
                    shutil.rmtree(path, ignore_errors=True)
                if index >= uncounted:
                    runs[name].append({**run, "parts": run_parts(reports[name]["timings"])})
        first, second = (dict(_intervals(reports[name])) for name in BACKENDS)
        overlapping = sum(
            first[key][0] <= second[key][1] and second[key][0] <= first[key][1] for key in first
        )
        results += [
            {
                "panel": panel,
                "backend": name,
                "device": reports[name]["backend"]["device"],
                "runs": count,
                "seconds": median(run["seconds"] for run in runs[name]),
                "parts": {
                    part: median(run["parts"][part] for run in runs[name]) for part in RUN_PARTS
                },
                "scores": len(first),
                "overlapping": overlapping,
            }
            for name in BACKENDS
        ]
    return results


def _intervals(data: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Names and 95 % intervals of all scores in a report."""
    if isinstance(data, Mapping):
        if "interval" in data:
            yield path, data["interval"]
        for key, value in data.items():
            yield from _intervals(value, f"{path}/{key}")


def parts_of(data: Mapping[str, Any]) -> list[PagePart]:
    """Part of the page: the table of times."""
    lead = (
        "Validations with default settings and an empty result cache. Parts of a run that work "
        "side by side are counted in full, so they can sum to more than the run."
    )
    heads = ["panel", "backend", "device", "runs", "seconds", *RUN_PARTS, "intervals that overlap"]
    rows = [
        [
            str(row["panel"]),
            str(row["backend"]),
            str(row["device"]),
            str(row["runs"]),
            number(row["seconds"], 1),
            *(number(row["parts"][part], 2) for part in RUN_PARTS),
            f"{row['overlapping']} of {row['scores']}",
        ]
        for row in items(data, "backends")
    ]
    remark = (
        "The backends round differently, and their textures differ by what the card's texture "
        "units lose. Their scores agree if the 95 % intervals overlap."
    )
    tables = [Table("Time by backend", heads, rows)]
    return [PagePart("backends", "Backends", lead, tables, remarks=[remark])]


def main() -> int:
    """Run the study and return the exit code."""
    variables = dict(os.environ)  # copied before the backend adds its variables
    parser = new_parser(__doc__, "bench-cuda")
    parser.add_argument("scene", type=Path, metavar="SCENE", help="Mitsuba scene (.xml)")
    args = parser.parse_args()

    def measure(rounds: Rounds, listener: Any, folder: Path) -> dict[str, Any]:
        return {"backends": bench_backends(args.scene, rounds, listener, folder, variables)}

    return run_study(args, "reports.bench.cuda.run", "Bench: backends", measure, parts_of)


if __name__ == "__main__":
    sys.exit(main())
