"""Times of a validation's generators, in yardsticks, as the bench takes them."""

from __future__ import annotations

from typing import Any

from inim.jobs.contenders import Generated, reads_layers
from inim.jobs.ledger import Ledger
from inim.jobs.truth import GroundTruth
from inim.regression import log_ratios

__all__ = ["generator_times"]

# More than the nine that a verdict needs: at this many, one interrupted round in ten does not
# widen the interval to where 30 % more time could hide in it.
_ROUNDS = 31


def generator_times(job: Ledger, truth: GroundTruth) -> dict[str, tuple[float, ...]]:
    """`inim.regression.log_ratios` of each generator, on the run's display-ready picture."""
    from inim.jobs.bench.contenders import display_ready, prepared
    from inim.jobs.bench.scene import YARDSTICK, timed
    from inim.jobs.bench.timing import Rounds

    names = [c.name for c in job.plan.contenders if isinstance(c, Generated)]
    with job.stage("time"):
        display = job.plan.display
        rgbd = display_ready(truth.rgbd)
        layered = rgbd if truth.layered is None else display_ready(truth.layered)
        contenders = [
            prepared(name, layered if reads_layers(name) else rgbd, display) for name in names
        ]
        times: Any = timed(contenders, rgbd, display, Rounds(runs=_ROUNDS))
    yardstick = times[YARDSTICK].times_s
    return {name: log_ratios(times[name].times_s, yardstick) for name in names}
