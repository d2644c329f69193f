"""Time of a sweep and the share of it that is spent in validations, by the number of workers.

    python -m reports.bench.sweep.run scenes/study.toml --workers 1,2 -o reports/bench/sweep

Every sweep starts with an empty result cache. The share of useful work is the sum of the times of
all validations, measured inside each process from its first step to its result, divided by the
duration of the sweep times its workers. The rest is the start of processes, the scheduler and
waiting. Workers beyond the number of cores share them, so only their overhead can be measured.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from inim.cache import FOLDER_VARIABLE
from inim.process.machine import cpu_count
from inim.report.labels import number, per_cent
from inim.report.study import PagePart, Table
from inim.timing import Rounds
from reports.bench.parts import items
from reports.bench.study import new_parser, run_study, run_validation


def bench_workers(
    study: Path, workers: Sequence[int], listener: Any, folder: Path, variables: Mapping[str, str]
) -> list[dict[str, Any]]:
    """Run a sweep once for each number of workers.

    Returns
    -------
    list of dict
        One entry per number of workers, under the names of bench.json: `validations` and `results`,
        their numbers; `seconds`, the duration of the sweep; `inside_s` and `rendering_s`, the sums
        over all validations; `useful_share`, a share of the workers' time.
    """
    from pyarrow.parquet import read_table

    rows = []
    for count in workers:
        listener.stage(f"{count} workers")
        out = folder / "sweep"
        cache = {FOLDER_VARIABLE: str(folder / "cache")}
        words = ["inim", "sweep", str(study), "--workers", str(count), "-o", str(out), "--quiet"]
        run = run_validation(words, {**variables, **cache}, f"{count} workers")
        table = read_table(out / "sweep.parquet").to_pylist()
        units = {row["unit"]: row for row in table if row["status"] == "ok"}
        inside = sum(row["unit_seconds"] for row in units.values())
        for path in (out, folder / "cache"):
            shutil.rmtree(path, ignore_errors=True)
        rows.append(
            {
                "workers": count,
                "cores": cpu_count(),
                "validations": len(units),
                "results": len({(row["unit"], row["algorithm"]) for row in table}),
                "failures": sum(row["status"] != "ok" for row in table),
                "seconds": run["seconds"],
                "inside_s": inside,
                "rendering_s": sum(row["render_seconds"] for row in units.values()),
                "useful_share": inside / (count * run["seconds"]),
            }
        )
    return rows


def parts_of(data: Mapping[str, Any]) -> list[PagePart]:
    """Part of the page: the table of workers."""
    lead = (
        "Sweeps with an empty result cache. A validation computes the ground truth of a scene on a "
        "display once, for all algorithms."
    )
    heads = [
        "workers", "cores", "validations", "results", "failed rows", "seconds",
        "seconds per validation", "inside validations", "of it rendering", "useful share",
    ]  # fmt: skip
    rows = [
        [
            *(str(row[key]) for key in ("workers", "cores", "validations", "results", "failures")),
            number(row["seconds"], 1),
            number(row["seconds"] / row["validations"], 2),
            number(row["inside_s"], 1),
            number(row["rendering_s"], 1),
            per_cent(row["useful_share"], 1),
        ]
        for row in items(data, "sweeps")
    ]
    tables = [Table("Time by number of workers", heads, rows)]
    return [PagePart("sweeps", "Sweeps", lead, tables)]


def main() -> int:
    """Run the study and return the exit code."""
    variables = dict(os.environ)  # copied before the backend adds its variables
    parser = new_parser(__doc__, "bench-sweep")
    parser.add_argument("study", type=Path, metavar="STUDY", help="study of a sweep (.toml)")
    parser.add_argument(
        "--workers", default="1,2", help="numbers of workers, separated by commas (default: 1,2)"
    )
    args = parser.parse_args()
    workers = [int(word) for word in args.workers.split(",")]

    def measure(_: Rounds, listener: Any, folder: Path) -> dict[str, Any]:
        return {"sweeps": bench_workers(args.study, workers, listener, folder, variables)}

    return run_study(args, "reports.bench.sweep.run", "Bench: sweeps", measure, parts_of)


if __name__ == "__main__":
    sys.exit(main())
