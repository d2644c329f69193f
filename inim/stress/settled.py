"""Settling in fractions what the float64 oracle leaves open."""

from __future__ import annotations

import numpy as np

from inim.display import Display
from inim.rgbd import RGBD
from inim.stress.first_hits import exact_hits
from inim.stress.oracle import Answer
from inim.stress.rays import Rays

__all__ = ["settle"]

# More pixels than this are not settled in fractions: only where rounding would decide.
_MOST_EXACT = 400


def settle(
    known: Answer, shown: np.ndarray, rays: Rays, rgbd: RGBD, display: Display
) -> tuple[np.ndarray, int]:
    """First hits by fractions wherever float64 may have decided, or what is shown differs.

    Parameters
    ----------
    known : Answer
        Of the float64 oracle, for arithmetic in float64.
    shown : (n,) int64
        A generator's sources.

    Returns
    -------
    (n,) int64, and how many are exact
    """
    differ = np.flatnonzero(shown != known.sources)
    doubt = np.flatnonzero(known.uncertain | (shown != known.sources))
    step = max(1, len(doubt) // _MOST_EXACT)
    which = np.unique(np.concatenate([doubt[::step], differ]))
    settled = known.sources.copy()
    settled[which] = exact_hits(rays, rgbd, display, which)
    return settled, len(which)
