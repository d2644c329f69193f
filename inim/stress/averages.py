"""Colours of several rays per pixel against the mean of the oracle's, in float64."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

from inim.display import Display
from inim.display.pixel_axis import stated
from inim.rgbd import RGBD
from inim.stress.free_rays import rays_over
from inim.stress.oracle import answer
from inim.stress.rays import Aside
from inim.stress.settled import settle

__all__ = ["compare_colours"]

_QUARTER = Fraction(1, 4)
_LEFT_AND_UP = (-_QUARTER, -_QUARTER)
_PLACES: dict[int, tuple[Aside, ...]] = {
    2: (_LEFT_AND_UP, (_QUARTER, _QUARTER)),
    4: (_LEFT_AND_UP, (-_QUARTER, _QUARTER), (_QUARTER, -_QUARTER), (_QUARTER, _QUARTER)),
}
# Roundings of a mean of four float32 colours: a sum's three, each by half an ulp of at most 4.
_ROUNDINGS = 2


def compare_colours(
    oracle: tuple[str, int], found: np.ndarray, pixels: np.ndarray, rgbd: RGBD, display: Display
) -> dict[str, Any]:
    """How many panel pixels show another colour than the mean of their rays.

    Parameters
    ----------
    oracle : (name, samples)
    found : (rows, columns, 3) float32
        A generator's EIA, linear RGB.
    pixels : (n, 2) int
        Panel pixels to look at.
    """
    name, samples = oracle
    shown = found[pixels[:, 0], pixels[:, 1]].astype(float)
    mean, uncertain, settled = np.zeros(shown.shape), np.zeros(len(pixels), bool), 0
    palette = rgbd.palette.reshape(-1, 3).astype(float)
    fill = stated(display.pixel_fill)
    for down, right in _PLACES[samples]:
        rays = rays_over(display, rgbd, pixels, (down * fill, right * fill))
        known = answer(name, rays, rgbd, display, np.float64)
        # What is shown has no source to differ by: all that rounding may have decided is settled.
        sources, exact = settle(known, known.sources, rays, rgbd, display)
        settled += exact
        uncertain |= known.uncertain
        mean += np.where((sources >= 0)[:, None], palette[np.maximum(sources, 0)], 0) / samples
    off = np.abs(shown - mean)
    eps = float(np.finfo(np.float32).eps)
    changed = (off > _ROUNDINGS * eps).any(axis=1)
    ulps = off[~changed] / np.spacing(np.maximum(mean[~changed], eps).astype(np.float32))
    return {
        "pixels": len(shown),
        "changed": int(changed.sum()),
        "uncertain": int(uncertain.sum()),
        "outside": int((changed & ~uncertain).sum()),
        "settled_exactly": settled,
        "ssim_loss": None,
        "worst_ulp": float(ulps.max(initial=0.0)),
        "mean_ulp": float(ulps.mean()) if ulps.size else 0.0,
    }
