"""Times of part of an EIA: the panel pixels that some viewpoints observe, against all of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from inim.display import Display, Viewpoint
from inim.errors import DisplayError
from inim.generators import prepare
from inim.image.rgbd import RGBD
from inim.lens import check_lens_model
from inim.pipeline.plan import Plan
from inim.pipeline.stages.generation import run_generator
from inim.timing import (
    REFERENCE_KERNEL,
    Rounds,
    display_ready,
    prepare_method,
    ratios,
    threads,
    time_calls,
)

_ALGORITHM = "template"
# `full` scatters rays between the lenses: all of the EIA may be observed.
_MODELS = ("pinhole", "thin", "thick")
_ALL = "whole EIA"

Make = Callable[[], np.ndarray]


def bench_masked(
    plan: Plan, rgbd: RGBD, viewpoints: Sequence[Viewpoint], rounds: Rounds, listener: Any
) -> dict[str, Any]:
    """Time `template` for what the viewpoints observe through each lens model, and for all.

    Parameters
    ----------
    plan : Plan
        Its display, and how it reconstructs views.
    rgbd : RGBD
        Linear.
    viewpoints : sequence of Viewpoint
    rounds : Rounds
    listener : Observer

    Returns
    -------
    dict
        Under the names of bench.json: the yardstick, and for each `form` of the picture an entry
        for the whole EIA and one for each lens model, whose `share` is its time over that of the
        whole EIA, `observed_share` that of the panel, and `same` whether each pixel made is the
        whole EIA's. The forms are display-ready, 8-bit into place, and linear as a validation has
        it, where a whole EIA is made by way of its sources.
    """
    from inim.render.reference_kernel import ReferenceKernel

    masks: dict[str, np.ndarray | None] = {_ALL: None, **_masks(plan, viewpoints)}
    forms = {"display-ready": _display_ready, "linear": _linear}
    makes = {
        (form, name): make(plan.display, rgbd, mask)
        for form, make in forms.items()
        for name, mask in masks.items()
    }
    ready = display_ready(rgbd)
    calls: dict[str, Callable[[], Any]] = {
        REFERENCE_KERNEL: ReferenceKernel(ready.color, plan.display, rgbd.pixel_mm).run
    }
    calls |= {f"{form}: {name}": make for (form, name), make in makes.items()}
    with threads(rounds.threads):
        times = time_calls(calls, rounds)
    rows = []
    for (form, name), make in makes.items():
        mask = masks[name]
        timing, whole = times[f"{form}: {name}"], times[f"{form}: {_ALL}"]
        of_whole = ratios(timing, whole)
        row = {
            "form": form,
            "name": name,
            **timing.as_data(),
            **ratios(timing, times[REFERENCE_KERNEL]),
            "share": of_whole["ratio"],
            "share_min": of_whole["ratio_min"],
            "observed_share": 1.0 if mask is None else float(mask.mean()),
            "same": mask is None or _same(makes[form, _ALL](), make(), mask),
        }
        rows.append(row)
        listener.line(
            f"{form:13}  {name:9}  {row['observed_share']:6.1%} observed  "
            f"{row['median_ms']:8.2f} ms  {row['ratio']:6.2f} yardsticks  "
            f"{row['share']:.1%} of the whole EIA"
        )
    return {
        "algorithm": _ALGORITHM,
        "viewpoints": [v.name for v in viewpoints],
        "yardstick": times[REFERENCE_KERNEL].as_data(),
        "algorithms": rows,
    }


def _display_ready(display: Display, rgbd: RGBD, mask: np.ndarray | None) -> Make:
    method = prepare_method(_ALGORITHM, display_ready(rgbd), display, mask)

    def make() -> np.ndarray:
        method.run()
        return method.out

    return make


def _linear(display: Display, rgbd: RGBD, mask: np.ndarray | None) -> Make:
    """What a validation counts as the seconds of an algorithm."""
    made = prepare(display, _ALGORITHM, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm, mask=mask)
    if mask is None:
        return lambda: run_generator(_ALGORITHM, made, rgbd, display)[0]
    return lambda: made.generate(rgbd)


def _masks(plan: Plan, viewpoints: Sequence[Viewpoint]) -> dict[str, np.ndarray]:
    """Panel pixels that a validation from these viewpoints observes, by lens model."""
    from inim.render import reconstruct

    s, masks = plan.settings, {}
    for model in _MODELS:
        try:
            check_lens_model(model, plan.misaligned_display)
        except DisplayError:  # such a lens cannot be ground
            continue
        found = reconstruct.observed_pixels(
            plan.misaligned_display,
            viewpoints,
            model,
            pixels_per_lens=s.view_pixels_per_lens,
            spp=plan.optics.half_spp,
            seeds=plan.optics.half_seeds,
        )
        if found is not None:
            masks[model] = found
    return masks


def _same(whole: np.ndarray, part: np.ndarray, mask: np.ndarray) -> bool:
    """Whether the pixels of the mask are as in the whole EIA, and the rest is black."""
    return bool(np.array_equal(whole[mask], part[mask]) and not part[~mask].any())
