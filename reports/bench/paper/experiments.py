"""The paper's three timing experiments, in plain Python and compiled, on two synthetic spheres.

Wang et al., Heritage Science 2024, doi 10.1186/s40494-024-01462-4, measure time against the number
of scene pixels (Fig. 12), of pixels of one elemental image (Fig. 13) and of elemental images
(Fig. 14). The paper used plain Python on one thread. A child process reproduces this
(`plain_python`). The paper's algorithm runs in all readings of its equations (`claims`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from inim.apps.bench.evaluate import available_algorithms, evaluate, make_reference, method_data
from inim.display import Display
from inim.display.viewpoint import parse_viewpoints
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
from reports.bench.study import picture_of, square_display, views_of

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
    """Sizes of the experiments.

    Attributes
    ----------
    scene_lenses : int
        Lenses along a side in the experiment on scene pixels.
    scene_pixels : sequence of int
        Picture pixels per lens pitch.
    elemental_pixels : sequence of int
        Pixels along a side of the single elemental image.
    lens_counts : sequence of int
        Lenses along a side in the experiment on elemental images.
    same_lenses : int
        Lenses along a side of the common input.
    pixels_per_pitch : int
        Picture pixels per lens pitch where they do not vary.
    """

    scene_lenses: int = 10
    scene_pixels: Sequence[int] = (1, 2, 3, 4, 5, 6)
    elemental_pixels: Sequence[int] = (9, 17, 25, 33, 49, 65)
    lens_counts: Sequence[int] = (1, 2, 4, 6, 8, 10, 12)
    same_lenses: int = 32
    pixels_per_pitch: int = 5


#: Sizes for which plain Python takes a few minutes in total.
FULL = Sizes()


def bench_paper(rounds: Rounds, sizes: Sizes = FULL) -> dict[str, Any]:
    """Run the three experiments and the comparison on a common input, and check the claims.

    Returns
    -------
    dict
        ``experiments`` [{``name``, ``figure``, ``kept``, ``size``, ``points``}], ``same_input``,
        ``steps`` (`depth_steps`), ``claims``, ``notes``.
    """
    names, notes = available_algorithms(NAMES)
    experiments = [
        _experiment(*experiment, names, rounds)
        for experiment in (
            ("Fig. 12", "scene pixels", "scene_pixels", _scene_inputs(sizes)),
            ("Fig. 13", "pixels of one elemental image", "elemental_pixels", _one_lens(sizes)),
            ("Fig. 14", "elemental images", "lenses", _lens_inputs(sizes)),
        )
    ]
    same = _same_input(sizes, [*names, *available_algorithms(VARIANTS)[0]], rounds)
    steps = depth_steps()
    return {
        "experiments": experiments,
        "same_input": same,
        "steps": steps,
        "claims": claims(experiments, same, steps),
        "notes": notes,
    }


#: Description of the constant sizes, and each display with its picture pixels per pitch.
_Inputs = tuple[str, list[tuple[Display, int]]]


def _scene_inputs(sizes: Sizes) -> _Inputs:
    n = sizes.scene_lenses
    constants = f"{n} × {n} lenses of 17 × 17 pixels"
    return constants, [(square_display(n), count) for count in sizes.scene_pixels]


def _one_lens(sizes: Sizes) -> _Inputs:
    """Inputs with one elemental image of different sizes; pitch, gap and depth range are equal."""
    low, high = square_display(1).depth_range_mm
    depth_range = {"depth_min_mm": low, "depth_max_mm": high}
    constants = f"one lens, {sizes.pixels_per_pitch} picture pixels per pitch"
    return constants, [
        (square_display(1, pixels, **depth_range), sizes.pixels_per_pitch)
        for pixels in sizes.elemental_pixels
    ]


def _lens_inputs(sizes: Sizes) -> _Inputs:
    constants = f"lenses of 17 × 17 pixels, {sizes.pixels_per_pitch} picture pixels per pitch"
    per_pitch = sizes.pixels_per_pitch
    return constants, [(square_display(count), per_pitch) for count in sizes.lens_counts]


def _experiment(
    figure: str,
    name: str,
    size: str,
    inputs: _Inputs,
    names: Sequence[str],
    rounds: Rounds,
) -> dict[str, Any]:
    points = []
    constants, displays = inputs
    for display, pixels_per_pitch in displays:
        rgbd = picture_of(display, pixels_per_pitch)
        methods = [prepare_method(method_name, rgbd, display) for method_name in names]
        rows = display.eia_shape[0]
        sizes = {
            "scene_pixels": rgbd.shape[0] * rgbd.shape[1],
            "elemental_pixels": (rows // display.lens_rows) ** 2,
            "lenses": display.lens_rows * display.lens_columns,
        }
        methods, times = _time_all(methods, rgbd, display, pixels_per_pitch, rounds)
        results = [method_data(m, times, display) for m in methods]
        points.append(
            {**sizes, "yardstick": times[REFERENCE_KERNEL].as_data(), "algorithms": results}
        )
    return {"name": name, "figure": figure, "kept": constants, "size": size, "points": points}


def _time_all(
    methods: list[TimedMethod], rgbd: RGBD, display: Display, pixels_per_pitch: int, rounds: Rounds
) -> tuple[list[TimedMethod], dict[str, Timing]]:
    """Time all methods compiled and the paper's in plain Python, which come first in the list."""
    times = time_methods(methods, rgbd, display, rounds)
    paper_methods = [method for method in methods if method.name in PAPER]
    plain, plain_times = time_plain_python(paper_methods, display, pixels_per_pitch, rounds)
    return [*plain, *methods], {**times, **plain_times}


def _same_input(sizes: Sizes, names: Sequence[str], rounds: Rounds) -> dict[str, Any]:
    """Time and errors of all methods on a common input, and SSIM of the middle view."""
    display = square_display(sizes.same_lenses)
    rgbd = picture_of(display, sizes.pixels_per_pitch)
    methods = [prepare_method(name, rgbd, display) for name in names]
    methods, times = _time_all(methods, rgbd, display, sizes.pixels_per_pitch, rounds)
    eye = parse_viewpoints("centre", display)
    reference = make_reference(rgbd, two_spheres_eia(display), display, views_of(display, eye))
    pixels_per_lens = len(reference.reference_views[0]) // display.lens_rows
    truth = two_spheres_view(display, eye[0], pixels_per_lens)
    results = []
    for method in methods:
        view = reference.views_of(linear_picture(method.out))[0]
        errors = evaluate(method, reference)
        results.append(
            method_data(method, times, display)
            | errors.pop("scores")
            | errors
            | {
                "middle_view_ssim": metrics.ssim(truth, view),
                "published_ssim": PUBLISHED_SSIM.get(method.name.removesuffix(PLAIN_PYTHON)),
            }
        )
    return {
        "lenses": display.lens_rows * display.lens_columns,
        "display_pixels": display.eia_shape[0] * display.eia_shape[1],
        "scene_pixels": rgbd.shape[0] * rgbd.shape[1],
        "yardstick": times[REFERENCE_KERNEL].as_data(),
        "reference_ssim": metrics.ssim(truth, reference.reference_views[0]),
        "algorithms": results,
    }
