"""`template`: the exact first hit of every panel pixel's ray in the picture's columns.

Definition. A depth image is a set of columns, one per covered pixel, each from its depth, its
front, down to its back. A panel pixel's ray X(z) = x0 + (x0 - x) z / g (the paper's Eq. 1) is
followed from z_max towards z_min, cell by cell; the first covered cell whose front is at least the
ray's z where it leaves that cell (or z_min, where the ray ends), and whose back is at most the
ray's z where it enters it, gives the source. No such cell: a hole, unless the ray passed behind a
column; then the last cell that it passed over, if that is covered, gives the source.

With `columns=surface` a column ends where the surface that its pixel shows does, and with
`columns=solid` nowhere: see `raycast.columns`.

A ray that runs exactly along a border between cells belongs to the cell of the larger row or
column; one that crosses exactly at a corner passes to the diagonal neighbour.

Three ways lead to the same sources, bit for bit, on displays that are separable:

* where co-located pixels of all lenses are parallel and the picture has a whole number of pixels
  per pitch, one list of cells per direction serves all lenses (`raycast.polyphase`), and runs
  over the picture's phases without a gather (`raycast.shared_directions`);
* where only the picture is so (15.7 pixels per lens, an elemental-image pitch of its own), strips
  of lenses share cells but not exit depths (`raycast.non_integer_pitch`);
* anywhere else, and for the few pixels of a sparse mask, each ray is walked by itself
  (`raycast.ray_by_ray.RayByRay`).

A fourth serves the others, hexagonal lattices and arrays that are turned or tilted: each ray by
itself, in float64, exact but for ties (`raycast.ray_by_ray.NonSeparable`).

Where a pixel's colours shine from places of their own (`Display.subpixels`), each colour's rays
start there (`raycast.supersampling`); sources are those of the pixel's centre.
"""

from __future__ import annotations

import numpy as np

from inim.display import Display
from inim.generators.base import PictureShape, SourceGenerator
from inim.generators.registry import algorithm, one_of


@algorithm(exact=True, portable=True, color="#0072b2", marker="o")
def prepare(
    display: Display,
    shape: PictureShape,
    pixel_mm: float,
    *,
    samples: int | str = 1,
    columns: str = "surface",
    mask: np.ndarray | None = None,
    leave_holes: bool = False,
) -> SourceGenerator:
    """Exact first hits: the columns of one picture. The one to take if unsure.

    Parameters
    ----------
    display, shape, pixel_mm, mask :
        See `inim.generators.prepare`.
    leave_holes : bool
        What a surface hides stays a hole, to be filled.
    samples : {1, 2, 4}
        Rays per panel pixel, or per sub-pixel where it has some: through its centre; through two
        points on its diagonal; through the centres of its quarters, or of those of its shining part
        (`Display.pixel_fill`). Colours are averaged in linear light, a hole counting as black.
    columns : {"surface", "solid"}
        As thick as the surface that a pixel shows, or solid all the way back
        (`inim.generators.raycast.columns`).

    Raises
    ------
    UsageError
        Another number of samples, or rays so long that they are a slip.
    """
    from inim.generators.raycast.columns import SEEN, SURFACE
    from inim.generators.raycast.shared_directions import first_hits

    rule = one_of("template: columns", columns, ("surface", "solid"))
    if leave_holes and rule == SURFACE:
        rule = SEEN
    return first_hits("template", display, shape, pixel_mm, rule, samples, mask)


def ray_by_ray(display: Display, shape: PictureShape, pixel_mm: float) -> SourceGenerator:
    """The same first hits without tables: what those are held against, on separable displays."""
    from inim.generators.raycast.columns import SURFACE
    from inim.generators.raycast.ray_by_ray import RayByRay

    return RayByRay(display, shape, pixel_mm, SURFACE)
