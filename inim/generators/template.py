"""`template`: the exact first hit of every panel pixel's ray in the picture's columns.

docs/theory/templates.md has the definition. Two implementations give the same sources, bit for bit,
on separable displays:

* if the picture has a whole number of pixels per lens pitch, strips of neighbouring lenses follow
  the same lists of cells over the picture's phases, without a gather (`raycast.strips`);
* otherwise, and for the few pixels of a sparse mask, each ray is followed separately
  (`raycast.ray_by_ray`).

The second also serves hexagonal, rotated and tilted arrays, in float64, exact except for ties.
"""

from __future__ import annotations

import numpy as np

from inim.display import Display
from inim.generators.base import PictureShape, SourceGenerator
from inim.generators.registry import algorithm, one_of


@algorithm(exact=True, portable=True, colour="smooth", fill="auto", color="#0072b2", marker="o")
def prepare(
    display: Display,
    shape: PictureShape,
    pixel_mm: float,
    *,
    samples: int | str = "auto",
    columns: str = "surface",
    mask: np.ndarray | None = None,
    leave_holes: bool = False,
) -> SourceGenerator:
    """Exact first hits in the columns of one picture; the recommended algorithm.

    Parameters
    ----------
    display, shape, pixel_mm, mask :
        See `inim.generators.prepare`.
    leave_holes : bool
        Leave hidden regions as holes, for a later fill.
    samples : {"auto", 1, 2, 4}
        Rays per panel pixel or sub-pixel: through its centre; through two points on its diagonal;
        or through the centres of its quarters, or of those of its emitting area
        (`Display.pixel_fill`). "auto": as many as suit the layout (`Layout.samples`). Colours are
        averaged in linear light, and a hole counts as black.
    columns : {"surface", "solid"}
        Columns as thick as the pixel's surface, or without a back
        (`inim.generators.raycast.columns`).

    Raises
    ------
    UsageError
        An invalid number of samples, or rays of implausible length.
    """
    from inim.generators.raycast.columns import SEEN, SURFACE
    from inim.generators.raycast.strips import first_hits

    rule = one_of("template: columns", columns, ("surface", "solid"))
    if leave_holes and rule == SURFACE:
        rule = SEEN
    return first_hits("template", display, shape, pixel_mm, rule, samples, mask)


def ray_by_ray(display: Display, shape: PictureShape, pixel_mm: float) -> SourceGenerator:
    """Exact first hits without tables, to check the tables on separable displays."""
    from inim.generators.raycast.columns import SURFACE
    from inim.generators.raycast.ray_by_ray import RayByRay

    return RayByRay(display, shape, pixel_mm, SURFACE).rays()[0]
