"""Settling in fractions what the float64 oracle leaves open."""

from __future__ import annotations

import numpy as np

from inim.display import Display
from inim.jobs.stress.first_hits import exact_hits
from inim.jobs.stress.oracle import answer
from inim.jobs.stress.rays import Rays
from inim.rgbd import RGBD

__all__ = ["settle"]

# More pixels than this are not settled in fractions: only where rounding would decide.
_MOST_EXACT = 400


def settle(
    truth: np.ndarray, shown: np.ndarray, rays: Rays, rgbd: RGBD, display: Display
) -> tuple[np.ndarray, int]:
    """First hits by fractions wherever float64 may have decided, or what is shown differs.

    Parameters
    ----------
    truth, shown : (n,) int64
        Sources of the float64 oracle, and of a generator.

    Returns
    -------
    (n,) int64, and how many are exact
    """
    fine = answer("layered", rays, rgbd, display, np.float64).uncertain
    differ = np.flatnonzero(shown != truth)
    doubt = np.flatnonzero(fine | (shown != truth))
    step = max(1, len(doubt) // _MOST_EXACT)
    which = np.unique(np.concatenate([doubt[::step], differ]))
    settled = truth.copy()
    settled[which] = exact_hits(rays, rgbd, display, which)
    return settled, len(which)
