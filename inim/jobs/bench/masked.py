"""The bench of part of an EIA: the panel pixels that some eyes observe, against all of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from inim.errors import DisplayError
from inim.jobs.bench.contenders import prepared
from inim.jobs.bench.scene import YARDSTICK, contender_data, timed
from inim.jobs.bench.timing import Rounds, ratios
from inim.jobs.plan import Plan
from inim.jobs.reconstruction import half_of, look_seeds
from inim.lens import check_lens_model
from inim.rgbd import RGBD
from inim.viewpoint import Viewpoint

__all__ = ["bench_masked"]

_ALGORITHM = "template"
# `full` scatters rays between the lenses: all of the EIA may be observed.
_MODELS = ("pinhole", "thin", "thick")
_ALL = "whole EIA"


def bench_masked(
    plan: Plan, rgbd: RGBD, viewpoints: Sequence[Viewpoint], rounds: Rounds, listener: Any
) -> dict[str, Any]:
    """Time `template` for what the viewpoints observe through each lens model, and for all.

    Parameters
    ----------
    plan : Plan
        Its display, and how it looks at EIAs.
    rgbd : RGBD
        Display-ready.
    viewpoints : sequence of Viewpoint
    rounds : Rounds
    listener : Listener

    Returns
    -------
    dict
        Under the names of bench.json: the yardstick, and a contender for the whole EIA and for
        each lens model, whose `share` is its time over that of the whole EIA, `observed_share`
        that of the panel, and `same` whether each pixel made is the whole EIA's.
    """
    masks = _masks(plan, viewpoints)
    contenders = {_ALL: prepared(_ALGORITHM, rgbd, plan.display, label=_ALL)}
    for model, mask in masks.items():
        contenders[model] = prepared(_ALGORITHM, rgbd, plan.display, mask, label=model)
    times = timed(list(contenders.values()), rgbd, plan.display, rounds)
    rows = []
    for name, contender in contenders.items():
        asked = masks.get(name)
        of_whole = ratios(times[name], times[_ALL])
        row = contender_data(contender, times, plan.display) | {
            "share": of_whole["ratio"],
            "share_min": of_whole["ratio_min"],
            "observed_share": 1.0 if asked is None else float(asked.mean()),
            "same": asked is None or _same(contenders[_ALL].out, contender.out, asked),
        }
        rows.append(row)
        listener.line(
            f"{name:10} {row['observed_share']:6.1%} observed  {row['median_ms']:8.2f} ms  "
            f"{row['ratio']:6.2f} yardsticks  {row['share']:.1%} of the whole EIA"
        )
    return {
        "algorithm": _ALGORITHM,
        "viewpoints": [v.name for v in viewpoints],
        "yardstick": times[YARDSTICK].as_data(),
        "contenders": rows,
    }


def _masks(plan: Plan, viewpoints: Sequence[Viewpoint]) -> dict[str, np.ndarray]:
    """Panel pixels that a validation from these viewpoints observes, by lens model."""
    from inim.kernel import reconstruct

    s, masks = plan.settings, {}
    for model in _MODELS:
        try:
            check_lens_model(model, plan.mounted)
        except DisplayError:  # such a lens cannot be ground
            continue
        found = reconstruct.observed_pixels(
            plan.mounted,
            viewpoints,
            model,
            pixels_per_lens=s.view_pixels_per_lens,
            spp=half_of(s.reconstruction_spp),
            seeds=look_seeds(s.seed),
        )
        if found is not None:
            masks[model] = found
    return masks


def _same(whole: np.ndarray, part: np.ndarray, mask: np.ndarray) -> bool:
    """Whether what was asked for is as in the whole EIA, and the rest is black."""
    return bool(np.array_equal(whole[mask], part[mask]) and not part[~mask].any())
