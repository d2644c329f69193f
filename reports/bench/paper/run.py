"""Growth of time, the paper's three experiments and claims, and readings of its equations.

    python -m reports.bench.paper.run -o reports/bench/paper

The study takes several minutes: plain Python is slow.
"""

from __future__ import annotations

import sys
from typing import Any

from inim.pipeline.timing import Rounds
from reports.bench.paper.experiments import bench_paper
from reports.bench.paper.page import page
from reports.bench.paper.readings import bench_readings
from reports.bench.paper.scaling import bench_scaling
from reports.bench.study import add_rounds, doubts, rounds_of
from reports.study import Study


def measure(part: str, **options: Any) -> dict[str, Any]:
    """Measure the growth of time, or the paper's experiments."""
    from inim.render import variant

    variant.use("llvm")
    rounds = Rounds(**options)
    if part == "scaling":
        return bench_scaling(rounds)
    return {**bench_paper(rounds), "readings": bench_readings()}


STUDY = Study(
    "reports.bench.paper.run", "Bench: synthetic pictures", __doc__, add_rounds,
    lambda args: {part: {"part": part, **rounds_of(args)} for part in ("scaling", "paper")},
    measure, page, stem="bench", doubts=doubts,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(STUDY.main())
