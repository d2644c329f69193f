"""First hits of every panel pixel's ray in a picture's columns, by the fastest way there is.

A ray is in a cell between the depths at which it enters and leaves it; the first cell, and in it
the nearest layer, whose column reaches into that span is hit: ``front >= exit`` and
``back <= entry``. The last cell ends at z_min.
"""

from __future__ import annotations

import numpy as np

from inim.display import Display
from inim.errors import UsageError
from inim.generators.base import PictureShape, PixelList, SourceGenerator, for_mask
from inim.generators.raycast.cells import Aside, check_ray_length
from inim.generators.raycast.columns import LAYERS
from inim.generators.raycast.direction_lists import shares_directions
from inim.generators.raycast.polyphase import fits_tables
from inim.generators.raycast.ray_by_ray import NonSeparable, RayByRay
from inim.generators.raycast.shared_directions import SharedDirections
from inim.generators.raycast.supersampling import averaged

# Of usual pictures, with sides: what tables are made for is not known before a picture comes.
_LAYERS = 12


def first_hits(
    name: str,
    display: Display,
    shape: PictureShape,
    pixel_mm: float,
    rule: str,
    samples: int | str,
    mask: np.ndarray | None,
) -> SourceGenerator:
    """The generator of first hits in the columns of pictures.

    Parameters
    ----------
    name : str
        Of the algorithm, for errors.
    display, shape, pixel_mm, mask :
        See `inim.generators.prepare`.
    rule : str
        What the columns are; see `raycast.columns`.
    samples : {1, 2, 4}

    Raises
    ------
    UsageError
        Another number of samples, or rays so long that they are a slip.
    """
    if str(samples) not in ("1", "2", "4"):
        raise UsageError(f"{name}: samples = {samples!r}; use 1, 2 or 4")
    check_ray_length(name, display, shape, pixel_mm)
    layers = _LAYERS if rule == LAYERS else 1
    tables = shares_directions(display) and fits_tables(display, shape, pixel_mm, layers)

    def made(pixels: PixelList | None) -> SourceGenerator:
        def through(aside: Aside) -> SourceGenerator:
            if not display.is_separable:
                return NonSeparable(display, shape, pixel_mm, rule, aside, pixels)
            if pixels is not None or not tables:
                return RayByRay(display, shape, pixel_mm, rule, aside, pixels)
            return SharedDirections(display, shape, pixel_mm, rule, aside)

        return averaged(display, int(samples), through)

    return for_mask(mask, display, made, dense_in_full=tables)
