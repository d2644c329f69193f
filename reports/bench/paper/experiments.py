"""The paper's three timing experiments, in plain Python and compiled, on two synthetic spheres.

Wang et al., Heritage Science 2024, doi 10.1186/s40494-024-01462-4, measure time against the number
of scene pixels (Fig. 12), of pixels of one elemental image (Fig. 13) and of elemental images
(Fig. 14). The paper used plain Python on one thread. A child process reproduces this
(`plain_python`). The paper's algorithm runs in all readings of its equations (`claims`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import inim
from inim.display import Display
from inim.display.lens import white_exposure
from inim.display.viewpoint import parse_viewpoints
from inim.generators import find_sources
from inim.image.rgbd import RGBD
from inim.pipeline.timing import (
    REFERENCE_KERNEL,
    Rounds,
    TimedMethod,
    Timing,
    linear_picture,
    prepare_method,
    time_methods,
)
from inim.render.scene_files.two_spheres import two_spheres_eia, two_spheres_view
from inim.scores import metrics
from reports.bench.paper.claims import claims
from reports.bench.paper.plain_python import PLAIN_PYTHON, time_plain_python
from reports.bench.paper.steps import depth_steps
from reports.bench.study import (
    EIAWithViews,
    compare,
    method_data,
    picture_of,
    source_errors,
    square_display,
)

#: The paper's algorithms, timed in plain Python and compiled.
PAPER = (
    "li2012",
    "gu2020",
    "wang2024",
    "wang2024:step_pixel=scene",
    "wang2024:matching=ray:step_pixel=scene",
)
NAMES = (*PAPER, "template")
#: Further algorithms on the common input: other rounding, other matching and four samples.
VARIANTS = (
    "wang2024:rounding=up",
    "wang2024:matching=ray",
    "template:samples=4",
)
#: SSIM of the middle view in the paper, for its own scenes.
PUBLISHED_SSIM = {"wang2024": 0.78, "gu2020": 0.74, "li2012": 0.67}


@dataclass(frozen=True)
class Sizes:
    """Sizes of the experiments. With the defaults, plain Python takes a few minutes in total."""

    scene_lenses: int = 10  #: Lenses along a side in the experiment on scene pixels.
    scene_pixels: Sequence[int] = (1, 2, 3, 4, 5, 6)  #: Picture pixels per lens pitch.
    #: Pixels along a side of the single elemental image.
    elemental_pixels: Sequence[int] = (9, 17, 25, 33, 49, 65)
    #: Lenses along a side in the experiment on elemental images.
    lens_counts: Sequence[int] = (1, 2, 4, 6, 8, 10, 12)
    same_lenses: int = 32  #: Lenses along a side of the common input.
    pixels_per_pitch: int = 5  #: Picture pixels per lens pitch where they do not vary.


def bench_paper(rounds: Rounds, sizes: Sizes | None = None) -> dict[str, Any]:
    """Run the three experiments and the comparison on a common input, and check the claims."""
    sizes = sizes or Sizes()
    experiments = [_experiment(*experiment, rounds) for experiment in _inputs(sizes)]
    same, steps = _same_input(sizes, rounds), depth_steps()
    return {
        "experiments": experiments,
        "same_input": same,
        "steps": steps,
        "claims": claims(experiments, same, steps),
    }


#: Each display with its picture pixels per pitch.
_Displays = list[tuple[Display, int]]


def _inputs(sizes: Sizes) -> Iterator[tuple[str, str, str, str, _Displays]]:
    """Figure, name, varied size, constants and displays of each experiment."""
    n, per_pitch = sizes.scene_lenses, sizes.pixels_per_pitch
    low, high = square_display(1).depth_range_mm
    yield (
        "Fig. 12", "scene pixels", "scene_pixels", f"{n} × {n} lenses of 17 × 17 pixels",
        [(square_display(n), count) for count in sizes.scene_pixels],
    )  # fmt: skip
    yield (
        "Fig. 13", "pixels of one elemental image", "elemental_pixels",
        f"one lens, {per_pitch} picture pixels per pitch",
        [(square_display(1, pixels, depth_min_mm=low, depth_max_mm=high), per_pitch)
         for pixels in sizes.elemental_pixels],
    )  # fmt: skip
    yield (
        "Fig. 14", "elemental images", "lenses",
        f"lenses of 17 × 17 pixels, {per_pitch} picture pixels per pitch",
        [(square_display(count), per_pitch) for count in sizes.lens_counts],
    )  # fmt: skip


def _experiment(
    figure: str, name: str, size: str, constants: str, displays: _Displays, rounds: Rounds
) -> dict[str, Any]:
    points = []
    for display, pixels_per_pitch in displays:
        methods, times, rgbd = _time_all(NAMES, display, pixels_per_pitch, rounds)
        results = {"algorithms": [method_data(m, times, display) for m in methods]}
        points.append(_point(display, rgbd, times) | results)
    return {"name": name, "figure": figure, "kept": constants, "size": size, "points": points}


def _point(display: Display, rgbd: RGBD, times: Mapping[str, Timing]) -> dict[str, Any]:
    """Sizes of an input, and the time of the reference kernel."""
    return {
        "scene_pixels": math.prod(rgbd.shape),
        "display_pixels": math.prod(display.eia_shape),
        "elemental_pixels": (display.eia_shape[0] // display.lens_rows) ** 2,
        "lenses": display.lens_rows * display.lens_columns,
        "yardstick": times[REFERENCE_KERNEL].as_data(),
    }


def _time_all(
    names: Sequence[str], display: Display, pixels_per_pitch: int, rounds: Rounds
) -> tuple[list[TimedMethod], dict[str, Timing], RGBD]:
    """Time all methods compiled and the paper's in plain Python, which come first in the list."""
    rgbd = picture_of(display, pixels_per_pitch)
    methods = [prepare_method(name, rgbd, display) for name in names]
    times = time_methods(methods, rgbd, display, rounds)
    paper_methods = [method for method in methods if method.name in PAPER]
    plain, plain_times = time_plain_python(paper_methods, display, pixels_per_pitch, rounds)
    return [*plain, *methods], {**times, **plain_times}, rgbd


def _same_input(sizes: Sizes, rounds: Rounds) -> dict[str, Any]:
    """Time and errors of all methods on a common input, and SSIM of the middle view."""
    display = square_display(sizes.same_lenses)
    names = (*NAMES, *VARIANTS)
    methods, times, rgbd = _time_all(names, display, sizes.pixels_per_pitch, rounds)
    (eye,) = parse_viewpoints("centre", display)
    exposure, exact = white_exposure(display, "thick"), find_sources(rgbd, display)

    def show(eia: np.ndarray) -> EIAWithViews:
        return EIAWithViews(eia, [inim.reconstruct(eia, display, eye, "thick") * exposure])

    reference = show(two_spheres_eia(display))
    view_rows = len(reference.views[0])
    truth = two_spheres_view(display, eye, view_rows // display.lens_rows)
    results = []
    for method in methods:
        eia = show(linear_picture(method.out))
        results.append(
            method_data(method, times, display)
            | source_errors(method, exact, display)
            | compare(reference, eia)
            | {
                "middle_view_ssim": metrics.ssim(truth, eia.views[0]),
                "published_ssim": PUBLISHED_SSIM.get(method.name.removesuffix(PLAIN_PYTHON)),
            }
        )
    return _point(display, rgbd, times) | {
        "reference_ssim": metrics.ssim(truth, reference.views[0]),
        "algorithms": results,
    }
