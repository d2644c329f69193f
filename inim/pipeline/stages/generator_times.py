"""Times of a validation's generators, in multiples of the reference kernel."""

from __future__ import annotations

from collections.abc import Sequence

from inim.pipeline.stages.capture import Capture
from inim.pipeline.stages.method import Method
from inim.pipeline.stages.stage import Run
from inim.regression import is_steady, log_ratios
from inim.timing import YARDSTICK, Rounds, display_ready, prepare_method, time_methods

# More than the nine that a verdict needs: at this many, one interrupted round in ten does not
# widen the interval to where 30 % more time could hide in it.
_ROUNDS = 31
# While other programs work beside this one, ratios scatter tenfold. So many times the rounds make
# up for twice the scatter that is allowed; what is not steady by then fails, and says so.
_MOST_TURNS = 5


def generator_times(
    methods: Sequence[Method], capture: Capture, *, run: Run
) -> dict[str, tuple[float, ...]]:
    """`inim.regression.log_ratios` of each generator, on the run's display-ready picture.

    Rounds are added until `inim.regression.is_steady` holds for all, or `_MOST_TURNS` are done.
    """
    wanted = [method for method in methods if method.times]
    times: dict[str, tuple[float, ...]] = {method.name: () for method in wanted}
    display = capture.camera.scene.display
    with run.observer.timed("time"):
        rgbd = display_ready(capture.rgbd)
        layered = rgbd if capture.layered is None else display_ready(capture.layered)
        prepared = [
            prepare_method(m.name, layered if m.reads_layers else rgbd, display) for m in wanted
        ]
        for _ in range(_MOST_TURNS):
            taken = time_methods(prepared, rgbd, display, Rounds(runs=_ROUNDS))
            kernel = taken[YARDSTICK].times_s
            times = {n: times[n] + log_ratios(taken[n].times_s, kernel) for n in times}
            if all(map(is_steady, times.values())):
                break
    return times
