"""Times of a validation's generators, in yardsticks, as the bench takes them."""

from __future__ import annotations

from typing import Any

from inim.pipeline.ledger import Ledger
from inim.pipeline.method import Generated, reads_layers
from inim.pipeline.timing import (
    YARDSTICK,
    Rounds,
    display_ready,
    prepare_method,
    time_methods,
)
from inim.pipeline.truth import GroundTruth
from inim.regression import is_steady, log_ratios

__all__ = ["generator_times"]

# More than the nine that a verdict needs: at this many, one interrupted round in ten does not
# widen the interval to where 30 % more time could hide in it.
_ROUNDS = 31
# While other programs work beside this one, ratios scatter tenfold. So many times the rounds make
# up for twice the scatter that is allowed; what is not steady by then fails, and says so.
_MOST_TURNS = 5


def generator_times(job: Ledger, truth: GroundTruth) -> dict[str, tuple[float, ...]]:
    """`inim.regression.log_ratios` of each generator, on the run's display-ready picture.

    Rounds are added until `inim.regression.is_steady` holds for all, or `_MOST_TURNS` are done.
    """
    names = [c.name for c in job.plan.contenders if isinstance(c, Generated)]
    found: dict[str, tuple[float, ...]] = dict.fromkeys(names, ())
    with job.stage("time"):
        display = job.plan.display
        rgbd = display_ready(truth.rgbd)
        layered = rgbd if truth.layered is None else display_ready(truth.layered)
        methods = [
            prepare_method(name, layered if reads_layers(name) else rgbd, display) for name in names
        ]
        for _ in range(_MOST_TURNS):
            times: Any = time_methods(methods, rgbd, display, Rounds(runs=_ROUNDS))
            yardstick = times[YARDSTICK].times_s
            found = {n: found[n] + log_ratios(times[n].times_s, yardstick) for n in names}
            if all(map(is_steady, found.values())):
                break
    return found
