"""Share of useful work in a sweep, start of a validation, and memory, by the number of workers.

    python -m reports.bench.sweep.run SCENE.xml ... --workers 1,2 -o reports/bench/sweep

A sweep validates each scene on the three displays of `scenes/study.toml` by its five algorithms,
with an empty result cache. The time of a validation counts from its plan to its result, in its own
process. The useful share is the sum of these times, divided by the workers' time. The start of a
validation is the rest of the workers' time per validation. The same sweep again, with all results
in the cache, is the part that precedes and follows the validations.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from inim.apps.sweep.table import TABLE
from inim.report.labels import number, per_cent
from inim.report.study import PagePart
from inim.system.cache import FOLDER_VARIABLE
from inim.system.errors import WorkerError
from reports.bench.study import doubts, run_validation
from reports.study import CODE, ROOT, Results, Study, add_scenes, table

_STUDY = ROOT / "scenes" / "study.toml"


def _study_of(scenes: Sequence[Path]) -> str:
    """The text of the study of another list of scenes, without timed algorithms."""
    names = ", ".join(f'"{scene.resolve()}"' for scene in scenes)
    lines = [
        f"scenes = [{names}]" if line.startswith("scenes = ") else line
        for line in _STUDY.read_text("utf-8").splitlines()
        if line != "time = true"
    ]
    return "\n".join(lines)


def measure(scenes: Sequence[Path], workers: int) -> dict[str, Any]:
    """Seconds of a sweep and of its validations, and the peak memory of its largest process."""
    from pyarrow.parquet import read_table

    with tempfile.TemporaryDirectory() as folder:
        study, out = Path(folder, "study.toml"), Path(folder, "out")
        study.write_text(_study_of(scenes), "utf-8")
        words = ["inim", "sweep", str(study), "--workers", str(workers), "-o", str(out)]
        variables = {**os.environ, FOLDER_VARIABLE: str(Path(folder, "cache"))}
        first, again = (run_validation(words, variables, "sweep") for _ in range(2))
        rows = read_table(out / TABLE).to_pylist()
    units = {row["unit"]: row["unit_seconds"] for row in rows if row["status"] == "ok"}
    if any(row["status"] != "ok" for row in rows):
        raise WorkerError("sweep: a validation failed; see its page")
    return {
        "workers": workers,
        "units": len(units),
        "scored": len({(row["unit"], row["algorithm"]) for row in rows}),
        "seconds": first["seconds"],
        "seconds_again": again["seconds"],
        "inside": sum(units.values()),
        "peak_bytes": first["peak_bytes"],
    }


def page(results: Results) -> tuple[list[str], list[PagePart]]:
    """The table of the numbers of workers."""

    def start(row: dict[str, Any]) -> float:
        working = row["workers"] * (row["seconds"] - row["seconds_again"])
        return float((working - row["inside"]) / row["units"])

    columns = {
        "workers": lambda r: str(r["workers"]),
        "validations": lambda r: str(r["units"]),
        "EIAs scored": lambda r: str(r["scored"]),
        "seconds": lambda r: number(r["seconds"], 0),
        "per validation": lambda r: number(r["seconds"] / r["units"], 1),
        "useful share": lambda r: per_cent(r["inside"] / (r["workers"] * r["seconds"]), 0),
        "start of a validation, s": lambda r: number(start(r), 2),
        "again, s": lambda r: number(r["seconds_again"], 1),
        "MiB per worker": lambda r: f"{r['peak_bytes'] / 2**20:.0f}",
    }
    lead = "MiB: peak of the largest process, which is a worker. Again: all results are cached."
    tables = [table("Sweeps with an empty result cache", results.values(), columns)]
    return [], [PagePart("sweep", "Sweeps", lead, tables)]


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the scenes and the numbers of workers."""
    add_scenes(parser)
    parser.add_argument("--workers", default="1,2", help="numbers of workers (1,2)")


def cases(args: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """One case for each number of workers."""
    numbers = map(int, args.workers.split(","))
    return {f"{count} workers": {"scenes": args.scenes, "workers": count} for count in numbers}


STUDY = Study(
    "reports.bench.sweep.run", "Bench: sweeps", __doc__, arguments, cases, measure, page,
    stem="bench", code=(*CODE, "inim/apps/sweep"), doubts=doubts,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(STUDY.main())
