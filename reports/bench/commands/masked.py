"""Times of a partial EIA, restricted to the panel pixels that some viewpoints observe."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from inim.display import Display, Viewpoint
from inim.display.lens import check_lens_model
from inim.generators import prepare
from inim.image.rgbd import RGBD
from inim.pipeline.plan import Plan
from inim.pipeline.stages.generation import run_generator
from inim.pipeline.timing import (
    REFERENCE_KERNEL,
    Rounds,
    prepare_method,
    ratios,
    threads,
    time_calls,
    to_srgb_rgba,
)
from inim.system.errors import DisplayError

_ALGORITHM = "template"
# Without `full`: it scatters rays between the lenses, so views may observe the whole EIA.
_MODELS = ("pinhole", "thin", "thick")
_ALL = "whole EIA"

Generate = Callable[[], np.ndarray]


def bench_masked(
    plan: Plan, rgbd: RGBD, viewpoints: Sequence[Viewpoint], rounds: Rounds, listener: Any
) -> dict[str, Any]:
    """Time `template` for the observed pixels of each lens model and for the whole EIA.

    Parameters
    ----------
    plan : Plan
        The display and the settings of the reconstruction.
    rgbd : RGBD
        Linear picture.
    viewpoints : sequence of Viewpoint
    rounds : Rounds
    listener : Observer

    Returns
    -------
    dict
        Under the names of bench.json: the reference kernel's time, and entries for the whole EIA
        and for each lens model, for each `form` of the picture. `share`: time divided by that of
        the whole EIA. `observed_share`: share of the panel. `same`: True if the pixels are equal to
        those of the whole EIA. The forms are display-ready, written to an 8-bit buffer, and linear
        as in a validation, which computes a whole EIA from its source map.
    """
    from inim.render.reference_kernel import ReferenceKernel

    masks: dict[str, np.ndarray | None] = {_ALL: None, **_masks(plan, viewpoints)}
    forms = {"display-ready": _display_ready, "linear": _linear}
    generations = {
        (form, name): prepare_form(plan.display, rgbd, mask)
        for form, prepare_form in forms.items()
        for name, mask in masks.items()
    }
    ready = to_srgb_rgba(rgbd)
    calls: dict[str, Callable[[], Any]] = {
        REFERENCE_KERNEL: ReferenceKernel(ready.color, plan.display, rgbd.pixel_mm).run
    }
    calls |= {f"{form}: {name}": generate for (form, name), generate in generations.items()}
    with threads(rounds.threads):
        times = time_calls(calls, rounds)
    rows = []
    for (form, name), generate in generations.items():
        mask = masks[name]
        timing, whole = times[f"{form}: {name}"], times[f"{form}: {_ALL}"]
        to_whole = ratios(timing, whole)
        row = {
            "form": form,
            "name": name,
            **timing.as_data(),
            **ratios(timing, times[REFERENCE_KERNEL]),
            "share": to_whole["ratio"],
            "share_min": to_whole["ratio_min"],
            "observed_share": 1.0 if mask is None else float(mask.mean()),
            "same": mask is None or _is_same(generations[form, _ALL](), generate(), mask),
        }
        rows.append(row)
        listener.line(
            f"{form:13}  {name:9}  {row['observed_share']:6.1%} observed  "
            f"{row['median_ms']:8.2f} ms  {row['ratio']:6.2f} kernel times  "
            f"{row['share']:.1%} of the whole EIA"
        )
    return {
        "algorithm": _ALGORITHM,
        "viewpoints": [v.name for v in viewpoints],
        "yardstick": times[REFERENCE_KERNEL].as_data(),
        "algorithms": rows,
    }


def _display_ready(display: Display, rgbd: RGBD, mask: np.ndarray | None) -> Generate:
    method = prepare_method(_ALGORITHM, to_srgb_rgba(rgbd), display, mask)

    def generate() -> np.ndarray:
        method.run()
        return method.out

    return generate


def _linear(display: Display, rgbd: RGBD, mask: np.ndarray | None) -> Generate:
    """Prepare the computation that a validation reports as the seconds of an algorithm."""
    generator = prepare(display, _ALGORITHM, shape=rgbd.shape, pixel_mm=rgbd.pixel_mm, mask=mask)
    if mask is None:
        return lambda: run_generator(_ALGORITHM, generator, rgbd, display)[0]
    return lambda: generator.generate(rgbd)


def _masks(plan: Plan, viewpoints: Sequence[Viewpoint]) -> dict[str, np.ndarray]:
    """Panel pixels that a validation from these viewpoints observes, by lens model."""
    from inim.render import reconstruct

    s, masks = plan.settings, {}
    for model in _MODELS:
        try:
            check_lens_model(model, plan.misaligned_display)
        except DisplayError:  # the lens cannot be manufactured
            continue
        mask = reconstruct.observed_pixels(
            plan.misaligned_display,
            viewpoints,
            model,
            pixels_per_lens=s.view_pixels_per_lens,
            spp=plan.optics.half_spp,
            seeds=plan.optics.half_seeds,
        )
        if mask is not None:
            masks[model] = mask
    return masks


def _is_same(whole: np.ndarray, part: np.ndarray, mask: np.ndarray) -> bool:
    """True if the pixels in the mask are equal to the whole EIA's and all others are black."""
    return bool(np.array_equal(whole[mask], part[mask]) and not part[~mask].any())
