"""The ground truth of a run: everything that methods are compared with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from inim.buffers import HalfBuffers
from inim.pipeline.capture import Capture
from inim.pipeline.checks import BLACK, CLIPPED_SHARE, any_colour, check, share_outside
from inim.pipeline.ground_truth import Finite, TrueView
from inim.pipeline.reconstruct import ReconstructedView

__all__ = ["GroundTruth", "collect_truth"]


@dataclass(frozen=True)
class GroundTruth:
    """Everything that methods are compared with.

    Attributes
    ----------
    eia : HalfBuffers
        Finite; black where the run observes nothing of it.
    whole : bool
        Whether all of it was made.
    clipped : float
        Share of its pixels that no panel shows.
    views : dict of str to HalfBuffers
        The scene itself, by viewpoint; finite.
    relic : dict of str to (rows, columns) bool
        Where the relic is in each view.
    ceiling : dict of str to ReconstructedView
        Views of the ground-truth EIA.
    checks : tuple of dict
    warnings : tuple of str
    """

    eia: HalfBuffers
    whole: bool
    clipped: float
    views: dict[str, HalfBuffers]
    relic: dict[str, np.ndarray]
    ceiling: dict[str, ReconstructedView]
    checks: tuple[dict[str, Any], ...] = ()
    warnings: tuple[str, ...] = ()


def collect_truth(
    capture: Capture,
    eia: Finite,
    views: dict[str, TrueView],
    ceiling: dict[str, ReconstructedView],
    *,
    whole: bool,
) -> GroundTruth:
    """The ground truth from what was rendered, checked.

    A ground truth that shows nothing is a failure to report, not a picture to score.
    """
    image = eia.image  # of an 8K panel 0.4 GB: made once
    true = {name: Finite.of(f"truth/{name}", one.view) for name, one in views.items()}
    covered = float(capture.rgbd.covered.mean())
    checks = [*eia.checks, *(row for one in true.values() for row in one.checks)]
    checks.append(check("RGB-D: covered share", covered, ">=", 1e-6, "the relic is seen"))
    images = {"truth/eia": image, **{f"truth/{n}": one.image for n, one in true.items()}}
    for name, one in images.items():
        row = check(f"{name}: brightest value", float(one.max()), ">=", BLACK, "not black")
        checks.append(row)
    clipped = {name: float(any_colour(one > 1).mean()) for name, one in images.items()}
    worst = max(clipped, key=lambda name: clipped[name])
    warnings = []
    if clipped[worst] > CLIPPED_SHARE:
        warnings.append(
            f"{worst}: {clipped[worst]:.1%} of the pixels are brighter than the panel's white and "
            "clipped; dim the scene's lights"
        )
    return GroundTruth(
        eia.halves,
        whole,
        share_outside(image),
        {name: one.halves for name, one in true.items()},
        {name: one.relic for name, one in views.items()},
        ceiling,
        tuple(checks),
        tuple(warnings),
    )
