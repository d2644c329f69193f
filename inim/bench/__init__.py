"""Run time against error: what each algorithm takes on a scene, and what it gets for it.

All methods and a reference kernel take turns in one loop (`inim.timing`), on display-ready
pictures. A time is given in milliseconds and in yardsticks: as a multiple of the reference kernel,
one 4-byte gather per display pixel. `inim bench SCENE` does all of it. For a study of
one's own, these functions are public:

* `bench_scene`: render a scene, time methods on it, evaluate their EIAs;
* `prepare_method`, `time_methods`, `method_data`: methods on any display-ready picture;
* `time_calls`, `ratios`: any other calls;
* `make_reference`, `evaluate`, `noise_floor`: errors of the EIAs that were timed;
* `record`, and `inim.report.bench.write_bench`: what else a bench.json says, and its forms.
"""

from inim.bench.evaluate import (
    available,
    bench_scene,
    evaluate,
    make_reference,
    mark_fronts,
    method_data,
    noise_floor,
)
from inim.bench.job import load_average, record
from inim.timing import (
    REFERENCE_KERNEL,
    Rounds,
    TimedMethod,
    Timing,
    display_ready,
    linear_picture,
    prepare_method,
    ratios,
    threads,
    time_calls,
    time_methods,
)

__all__ = [
    "REFERENCE_KERNEL",
    "Rounds",
    "TimedMethod",
    "Timing",
    "available",
    "bench_scene",
    "display_ready",
    "evaluate",
    "linear_picture",
    "load_average",
    "make_reference",
    "mark_fronts",
    "method_data",
    "noise_floor",
    "prepare_method",
    "ratios",
    "record",
    "threads",
    "time_calls",
    "time_methods",
]
