"""What the viewer sees of an EIA, from every viewpoint of a run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from inim.jobs.ledger import Ledger
from inim.lens import white_exposure

__all__ = ["Seen", "reconstruct_views"]


@dataclass(frozen=True)
class Seen:
    """A view, and by how much noise could have made it another.

    Attributes
    ----------
    image : (rows, columns, 3) float32, linear RGB
        Depends on the EIA and the seed only: equal EIAs look equal.
    noise : (rows, columns, 3) float32
        Half of the difference of what two halves of the samples yield, those of the EIA and those
        of the look at it.
    """

    image: np.ndarray
    noise: np.ndarray

    @property
    def first(self) -> np.ndarray:
        """The view by one half of the samples."""
        half: np.ndarray = self.image + self.noise
        return half

    @property
    def second(self) -> np.ndarray:
        """The view by the other half."""
        half: np.ndarray = self.image - self.noise
        return half


def reconstruct_views(
    job: Ledger, eia: np.ndarray, noise: np.ndarray | None, name: str
) -> dict[str, Seen]:
    """Look at an EIA from every viewpoint, exposed so that the panel's white looks white.

    Two looks of half of the samples each make a view. A view is linear in its EIA; so what the
    EIA's noise does to it is a third look, with the first one's random numbers, less the first.

    Parameters
    ----------
    job : Ledger
    eia : (rows, columns, 3) float32, linear RGB
    noise : (rows, columns, 3) float32, or None
        Half of the difference of two halves of the EIA's samples; None where it has no noise.
    name : str
        The views are written to ``views/NAME/``.

    Returns
    -------
    dict of str to Seen
        By viewpoint.
    """
    first, second = (_look(job, eia, half) for half in (0, 1))
    moved = first if noise is None else _look(job, eia + noise, 0)
    seen = {
        view: Seen(
            np.float32(0.5) * (one + second[view]),
            np.float32(0.5) * (one - second[view]) + (moved[view] - one),
        )
        for view, one in first.items()
    }
    with job.stage("write pictures"):
        for view, picture in seen.items():
            job.save(f"views/{name}/{view}", picture.image)
    return seen


def _look(job: Ledger, eia: np.ndarray, half: int) -> dict[str, np.ndarray]:
    """Every view by half of the samples."""
    from inim.kernel.reconstruct import DisplayScene

    plan, s = job.plan, job.plan.settings
    exposure = np.float32(white_exposure(plan.mounted, s.lens_model))
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
