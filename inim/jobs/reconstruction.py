"""What the viewer sees of an EIA, from every viewpoint of a run."""

from __future__ import annotations

import numpy as np

from inim.jobs.ledger import Ledger
from inim.lens import white_exposure

__all__ = ["reconstruct_views"]


def reconstruct_views(job: Ledger, eia: np.ndarray, name: str) -> dict[str, np.ndarray]:
    """Look at an EIA from every viewpoint, exposed so that the panel's white looks white.

    Parameters
    ----------
    job : Ledger
    eia : (rows, columns, 3) float32, linear RGB
    name : str
        The views are written to ``views/NAME/``.

    Returns
    -------
    dict of str to (rows, columns, 3) float32
        Linear RGB, by viewpoint.
    """
    from inim.kernel.reconstruct import DisplayScene

    plan, s = job.plan, job.plan.settings
    exposure = white_exposure(plan.mounted, s.lens_model)
    seen: dict[str, np.ndarray] = {}
    with job.stage("reconstruct views"):
        shown = DisplayScene(eia, plan.mounted, s.lens_model)
        for viewpoint in plan.viewpoints:
            view = shown.view(
                viewpoint,
                pixels_per_lens=s.view_pixels_per_lens,
                spp=s.reconstruction_spp,
                seed=s.seed,
                clock=job.clock,
                progress=job.listener.rays,
            )
            seen[viewpoint.name] = view * exposure
    with job.stage("write pictures"):
        for view_name, view in seen.items():
            job.save(f"views/{name}/{view_name}", view)
    return seen
