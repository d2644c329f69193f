"""Pictures with layers, made of pictures without: for what only `layered` can show."""

from __future__ import annotations

import numpy as np

from inim.display import Display
from inim.rgbd import RGBD, Layer, LayeredRGBD

__all__ = ["solids_of"]

# A pixel and its neighbours: (rows, columns) away. Mirrored and transposed they are the same set.
_AROUND = ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0))
_MOST = 4


def solids_of(rgbd: RGBD, display: Display) -> LayeredRGBD:
    """Three solids in each pixel, between the depths of itself and its neighbours in order.

    A depth at which a ray leaves a pixel is that at which it enters the next one, so a picture of
    ties is one of ties at fronts and backs. The last solid goes all the way back. Deeper layers are
    covered where most neighbours are, and have colours of their own.
    """
    low = np.float32(display.depth_range_mm[0])
    held = np.where(rgbd.covered, rgbd.depth_mm, low)
    depths = np.sort(np.stack([np.roll(held, by, axis=(0, 1)) for by in _AROUND]), axis=0)[::-1]
    around = np.stack([np.roll(rgbd.covered, by, axis=(0, 1)) for by in _AROUND]).sum(axis=0)
    inside = rgbd.covered & (around >= _MOST)
    nothing = np.full(rgbd.shape, -np.inf, np.float32)
    colours = [(rgbd.color * share).astype(np.float32) for share in (1.0, 0.5, 0.25)]
    return LayeredRGBD(
        colours[0], depths[0], rgbd.covered, rgbd.pixel_mm, depths[1],
        (
            Layer(colours[1], depths[2], depths[3], inside),
            Layer(colours[2], depths[4], nothing, inside),
        ),
    )  # fmt: skip
