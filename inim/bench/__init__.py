"""Run time against error: the time and the errors of each algorithm on a scene.

All methods and a reference kernel run alternately in one loop (`inim.timing`), on display-ready
pictures. Times are given in milliseconds and in kernel times: multiples of the reference kernel's
time, one 4-byte gather per display pixel. `inim bench SCENE` runs all of it. Public functions for
further studies:

* `bench_scene`: render a scene, time methods on it, evaluate their EIAs;
* `method_data`, with `inim.timing`: times of methods on any display-ready picture;
* `make_reference`, `evaluate`, `noise_floor`: errors of the timed EIAs;
* `record`, and `inim.report.bench.write_bench`: further content of bench.json, and its pages.
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

__all__ = [
    "available",
    "bench_scene",
    "evaluate",
    "load_average",
    "make_reference",
    "mark_fronts",
    "method_data",
    "noise_floor",
    "record",
]
