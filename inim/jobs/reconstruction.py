"""What the viewer sees of an EIA, from every viewpoint of a run."""

from __future__ import annotations

from typing import Any

import numpy as np

from inim.jobs.ledger import Ledger
from inim.lens import white_exposure

__all__ = ["reconstruct_views"]


def reconstruct_views(job: Ledger, eia: Any, name: str) -> dict[str, Any]:
    """Look at an EIA from every viewpoint, exposed so that the panel's white looks white.

    Each half of the EIA is looked at with half of the samples and a seed of its own, so that the
    halves of a view share no random number; being linear, their mean is the view of the EIA.

    Parameters
    ----------
    job : Ledger
    eia : Truth
        Two halves, (rows, columns, 3) float32, linear RGB.
    name : str
        The views are written to ``views/NAME/``.

    Returns
    -------
    dict of str to Truth
        Linear RGB, by viewpoint.
    """
    from inim.kernel.ground_truth import Truth

    halves = [_seen(job, half, number) for number, half in enumerate((eia.first, eia.second))]
    seen = {view: Truth(first, halves[1][view]) for view, first in halves[0].items()}
    with job.stage("write pictures"):
        for view, picture in seen.items():
            job.save(f"views/{name}/{view}", picture.image)
    return seen


def _seen(job: Ledger, eia: np.ndarray, half: int) -> dict[str, np.ndarray]:
    """Half of the samples of every view."""
    from inim.kernel.reconstruct import DisplayScene

    plan, s = job.plan, job.plan.settings
    exposure = white_exposure(plan.mounted, s.lens_model)
    with job.stage("reconstruct views"):
        shown = DisplayScene(eia, plan.mounted, s.lens_model)
        return {
            viewpoint.name: exposure
            * shown.view(
                viewpoint,
                pixels_per_lens=s.view_pixels_per_lens,
                spp=max(1, s.reconstruction_spp // 2),
                seed=2 * s.seed + half,
                clock=job.clock,
                progress=job.listener.rays,
            )
            for viewpoint in plan.viewpoints
        }
