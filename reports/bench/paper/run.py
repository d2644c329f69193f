"""Growth of time, the paper's three experiments and claims, and readings of its equations.

    python -m reports.bench.paper.run -o reports/bench/paper

The study takes several minutes: plain Python is slow.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from inim.pipeline.timing import Rounds
from reports.bench.paper.experiments import bench_paper
from reports.bench.paper.readings import bench_readings
from reports.bench.paper.report import parts_of
from reports.bench.paper.scaling import bench_scaling
from reports.bench.study import new_parser, run_study


def main() -> int:
    """Run the study and return the exit code."""
    args = new_parser(__doc__, "bench-paper").parse_args()
    module = "reports.bench.paper.run"
    return run_study(args, module, "Bench: synthetic pictures", _measure, parts_of)


def _measure(rounds: Rounds, listener: Any, folder: Path) -> dict[str, Any]:  # noqa: ARG001
    scaling, paper = bench_scaling(rounds, listener), bench_paper(rounds, listener)
    paper["readings"] = bench_readings(listener)
    for claim in paper["claims"]:
        listener.line(f"{'yes' if claim['holds'] else 'NO '}  {claim['claim']}")
    return {"scaling": scaling, "paper": paper}


if __name__ == "__main__":
    sys.exit(main())
