"""First hits of every panel pixel's ray in a picture's columns, by the fastest way there is.

A ray is in a cell between the depths at which it enters and leaves it; the first cell, and in it
the nearest layer, whose column reaches into that span is hit: ``front >= exit`` and
``back <= entry``. The last cell ends at z_min.
"""

from __future__ import annotations

import numpy as np

from inim.display import Display
from inim.generators.base import PictureShape, PixelList, SourceGenerator, for_mask
from inim.generators.raycast.cells import Aside
from inim.generators.raycast.columns import LAYERS
from inim.generators.raycast.direction_lists import shares_directions
from inim.generators.raycast.non_integer_pitch import NonIntegerPitch
from inim.generators.raycast.polyphase import fits_tables
from inim.generators.raycast.ray_by_ray import NonSeparable, RayByRay
from inim.generators.raycast.shared_directions import SharedDirections
from inim.generators.raycast.supersampling import averaged

__all__ = ["first_hits"]

# Of usual pictures, with sides: what tables are made for is not known before a picture comes.
_LAYERS = 12


def first_hits(
    display: Display,
    shape: PictureShape,
    pixel_mm: float,
    rule: str,
    samples: int,
    mask: np.ndarray | None,
) -> SourceGenerator:
    """The generator of first hits in the columns of pictures.

    Parameters
    ----------
    display, shape, pixel_mm, mask :
        See `inim.generators.prepare`.
    rule : str
        What the columns are; see `raycast.columns`.
    samples : {1, 2, 4}
    """
    layers = _LAYERS if rule == LAYERS else 1
    shared = shares_directions(display)
    # Deeper layers are laid out for shared directions alone.
    tables = (shared or rule != LAYERS) and fits_tables(display, shape, pixel_mm, layers)

    def made(pixels: PixelList | None) -> SourceGenerator:
        def through(aside: Aside) -> SourceGenerator:
            if not display.is_separable:
                return NonSeparable(display, shape, pixel_mm, rule, aside, pixels)
            if pixels is not None or not tables:
                return RayByRay(display, shape, pixel_mm, rule, aside, pixels)
            if shared:
                return SharedDirections(display, shape, pixel_mm, rule, aside)
            return NonIntegerPitch(display, shape, pixel_mm, rule, aside)

        return averaged(display, samples, through)

    return for_mask(mask, display, made, dense_in_full=tables)
