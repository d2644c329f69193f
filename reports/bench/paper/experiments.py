"""Times of all readings and rivals, in all forms, in alternation.

Wang et al., Heritage Science 2024, doi 10.1186/s40494-024-01462-4, measure time against the number
of scene pixels (Fig. 12), of pixels of one elemental image (Fig. 13) and of elemental images
(Fig. 14), in plain Python. Every round runs every method once, so that a change of the machine's
speed affects all. Times are compared within a round only.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

from inim.display import Display
from inim.generators import colour_of, li2012
from inim.generators.base import HOLE
from inim.generators.registry import DEFAULT
from inim.image.rgbd import RGBD
from inim.pipeline.timing import prepare_method, to_srgb_rgba
from inim.system.process.garbage import no_garbage_collection
from reports.bench.paper import readings
from reports.bench.paper.inputs import DISPLAY, EMPTY, WAVES, spheres, waves
from reports.bench.paper.readings import ALGORITHMS, READINGS, STRICT, Reading, Search
from reports.bench.study import square_display

#: Forms of an algorithm. Compiled ones run on all threads, for all lenses.
LOOPS, NUMPY, COMPILED = "loops", "NumPy", "compiled"
GU, LI, TEMPLATE = "gu2020", "li2012", "template:samples=1:colour=nearest"
#: Rows and columns of the lenses of `DISPLAY` that uncompiled forms search.
SAMPLE = slice(8, None, 16)
# A call is repeated until it takes this long.
_LEAST_S = 0.02
#: Pictures of the figures: any size of them can be computed.
PICTURES: Mapping[str, Callable[[Display, float], RGBD]] = {WAVES: waves, EMPTY: spheres}
_SIZES = "scene pixels", "pixels of one elemental image", "elemental images"
FIGURES = dict(zip(("Fig. 12", "Fig. 13", "Fig. 14"), _SIZES, strict=True))


def figure_points(figure: str) -> Iterator[tuple[Display, float]]:
    """Displays and picture pixels per pitch of a figure, by increasing size."""
    if figure == "Fig. 12":
        yield from ((square_display(4), count) for count in (1, 2, 3, 4, 6))
    elif figure == "Fig. 13":
        low, high = DISPLAY.depth_range_mm
        for pixels in (9, 17, 33, 65):
            yield square_display(1, pixels, depth_min_mm=low, depth_max_mm=high), 5
    else:
        yield from ((square_display(count), 2.5) for count in (1, 2, 3, 5))


def time_figure(figure: str, picture: str, runs: int) -> list[dict[str, Any]]:
    """Time all methods at each size of a figure, on a picture of `PICTURES`."""
    points = []
    for display, pixels_per_pitch in figure_points(figure):
        rgbd = PICTURES[picture](display, pixels_per_pitch)
        pixels, times = math.prod(display.eia_shape), time_all(display, rgbd, slice(None), runs)
        sizes = math.prod(rgbd.shape), pixels, display.lens_rows * display.lens_columns
        points.append({
            "size": sizes[_SIZES.index(FIGURES[figure])], "pixels": pixels,
            "covered": float(rgbd.covered.mean()), "times": times,
        })  # fmt: skip
    return points


def time_all(display: Display, rgbd: RGBD, lenses: slice, runs: int) -> dict[str, Any]:
    """Microseconds per panel pixel by method, form and round.

    Uncompiled forms search the lenses of a slice only.
    """
    methods = {**_calls(display, rgbd, lenses), **_compiled_calls(display, rgbd)}
    counts = {}
    for key, (call, _) in methods.items():
        if key[1] == COMPILED:
            call()  # compiles
        started = perf_counter()
        call()
        counts[key] = max(1, math.ceil(_LEAST_S / (perf_counter() - started)))
    times: dict[str, dict[str, list[float]]] = {}
    with no_garbage_collection():
        for _ in range(runs):
            for (name, form), (call, pixels) in methods.items():
                count = counts[name, form]
                started = perf_counter()
                for _ in range(count):
                    call()
                us = 1e6 * (perf_counter() - started) / (count * pixels)
                times.setdefault(name, {}).setdefault(form, []).append(float(f"{us:.4g}"))
    return times


# Call, and number of panel pixels that it finds, by method and form.
_Calls = dict[tuple[str, str], tuple[Callable[[], Any], int]]


def _calls(display: Display, rgbd: RGBD, lenses: slice) -> _Calls:
    """Calls that find the sources under some lenses, in plain Python and with NumPy."""
    calls: _Calls = {}
    for name, reading in {**READINGS, GU: Reading(reverse=True)}.items():
        search = Search.of(display, rgbd, lenses, reading), readings.surface_depth(rgbd), reading
        pixels = math.prod(search[0].shape)
        calls[name, LOOPS] = readings.plain_python(*search), pixels
        calls[name, NUMPY] = partial(readings.search_arrays, *search), pixels
    calls[LI, LOOPS] = _forward_loops(display, rgbd, lenses), pixels
    return calls


def _compiled_calls(display: Display, rgbd: RGBD) -> _Calls:
    """Calls that generate whole EIAs: inim's algorithms, and the reading that is none of them."""
    ready, pixels = to_srgb_rgba(rgbd), math.prod(display.eia_shape)
    algorithms = {**ALGORITHMS, **{name: name for name in (GU, LI, TEMPLATE, DEFAULT)}}
    calls: _Calls = {
        (name, COMPILED): (prepare_method(algorithm, ready, display).run, pixels)
        for name, algorithm in algorithms.items()
    }
    calls[STRICT, COMPILED] = (
        lambda: colour_of(readings.sources_of(READINGS[STRICT], display, ready), ready), pixels
    )  # fmt: skip
    return calls


def _forward_loops(display: Display, rgbd: RGBD, lenses: slice) -> Callable[[], list[int]]:
    """Call that maps a picture through some lenses by the loops of `li2012`, in plain Python."""
    depth = np.where(rgbd.covered, rgbd.depth_mm.astype(np.float64), 0.0)
    ends = float(depth[rgbd.covered].min()), float(depth.max())
    axes = li2012.forward_axes(display, rgbd.shape, rgbd.pixel_mm, ends)
    x, y = map(readings.with_lists, axes)
    send: Any = li2012._map_through_lens
    flat = depth.ravel().tolist()
    rows, columns = (range(n)[lenses] for n in (display.lens_rows, display.lens_columns))

    def run() -> list[int]:
        size = math.prod(display.eia_shape)
        nearest, miss, sources = [-math.inf] * size, [math.inf] * size, [HOLE] * size
        for m in rows:
            for n in columns:
                send(flat, x, y, m, n, nearest, miss, sources)
        return sources

    return run
