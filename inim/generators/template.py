"""`template`: the exact first hit of every panel pixel's ray in the picture's columns.

Definition. A depth image is a set of columns, one per covered pixel, each from its depth, its
front, down to its back. A panel pixel's ray X(z) = x0 + (x0 - x) z / g (the paper's Eq. 1) is
followed from z_max towards z_min, cell by cell; the first covered cell whose front is at least the
ray's z at its exit from that cell (or z_min at the end of the ray), and whose back is at most the
ray's z at its entry, is the source. Without such a cell the pixel is a hole, with one exception: if
the ray passed behind a column, the last cell on its path is the source, if it is covered.

With `columns=surface` a column is as thick as its pixel's surface; with `columns=solid` it has no
back: see `raycast.columns`.

A ray that runs exactly along a border between cells belongs to the cell of the larger row or
column; one that crosses exactly at a corner passes to the diagonal neighbour.

Two implementations give the same sources, bit for bit, on separable displays:

* if the picture has a whole number of pixels per lens pitch, strips of neighbouring lenses follow
  the same lists of cells over the picture's phases, without a gather (`raycast.strips`);
* otherwise, and for the few pixels of a sparse mask, each ray is followed separately
  (`raycast.ray_by_ray`).

The second also serves hexagonal, rotated and tilted arrays, in float64, exact except for ties.

With sub-pixels (`Display.subpixels`) each colour's rays start at its sub-pixel
(`raycast.supersampling`); sources are those of the pixel's centre.
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
    samples: int | str = 4,
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
    samples : {1, 2, 4}
        Rays per panel pixel or sub-pixel: through its centre; through two points on its diagonal;
        or through the centres of its quarters, or of those of its emitting area
        (`Display.pixel_fill`). Colours are averaged in linear light, and a hole counts as black.
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

    return RayByRay(display, shape, pixel_mm, SURFACE)
