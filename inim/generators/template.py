"""`template`: the exact first hit of every panel pixel's ray in the picture's columns.

Definition. A depth image is a set of columns, one per covered pixel, solid from far up to its
depth. A panel pixel's ray X(z) = x0 + (x0 - x) z / g (the paper's Eq. 1) is followed from z_max
towards z_min, cell by cell; the first covered cell whose depth is at least the ray's z where it
leaves that cell (or z_min, where the ray ends) gives the source. No such cell: a hole.

A ray that runs exactly along a border between cells belongs to the cell of the larger row or
column; one that crosses exactly at a corner passes to the diagonal neighbour.

With `columns=surface` a column ends where the surface that its pixel shows does, by the rule of
`raycast.surfaces`, and a ray that enters a cell below the column's back passes on behind it.

Three ways lead to the same sources, bit for bit, on displays that are separable:

* where co-located pixels of all lenses are parallel and the picture has a whole number of pixels
  per pitch, one list of cells per direction serves all lenses (`raycast.direction_lists`), and runs
  over the picture's phases without a gather (`raycast.polyphase`);
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
from inim.errors import UsageError
from inim.generators.base import (
    PictureShape,
    PixelList,
    SourceGenerator,
    for_mask,
)
from inim.generators.raycast.cells import Aside, check_ray_length
from inim.generators.registry import algorithm, one_of

__all__ = ["prepare", "ray_by_ray"]


@algorithm(
    exact=True, portable=True, color="#0072b2", marker="o", inexact_with={"columns": "surface"}
)
def prepare(
    display: Display,
    shape: PictureShape,
    pixel_mm: float,
    *,
    samples: int | str = 1,
    columns: str = "solid",
    mask: np.ndarray | None = None,
) -> SourceGenerator:
    """Exact first hits: the columns of one picture. The one to take if unsure.

    Parameters
    ----------
    display, shape, pixel_mm, mask :
        See `inim.generators.prepare`.
    samples : {1, 2, 4}
        Rays per panel pixel, or per sub-pixel where it has some: through its centre; through two
        points on its diagonal; through the centres of its quarters, or of those of its shining part
        (`Display.pixel_fill`). Colours are averaged in linear light, a hole counting as black.
    columns : {"solid", "surface"}
        Solid all the way back, or as thick as the surface that a pixel shows
        (`inim.generators.raycast.surfaces`).

    Raises
    ------
    UsageError
        Another number of samples, or rays so long that they are a slip.
    """
    from inim.generators.raycast.direction_lists import shares_directions
    from inim.generators.raycast.non_integer_pitch import NonIntegerPitch
    from inim.generators.raycast.polyphase import SharedDirections, fits_tables
    from inim.generators.raycast.ray_by_ray import NonSeparable, RayByRay
    from inim.generators.raycast.supersampling import averaged

    if str(samples) not in ("1", "2", "4"):
        raise UsageError(f"template: samples = {samples!r}; use 1, 2 or 4")
    check_ray_length("template", display, shape, pixel_mm)
    if one_of("template: columns", columns, ("solid", "surface")) == "surface":
        from inim.generators.raycast.solids import first_hits_in_solids
        from inim.generators.raycast.surfaces import Surfaces

        solids = first_hits_in_solids(display, shape, pixel_mm, int(samples), mask, layers=1)
        return Surfaces(solids)
    tables = fits_tables(display, shape, pixel_mm)

    def first_hits(pixels: PixelList | None) -> SourceGenerator:
        def through(aside: Aside) -> SourceGenerator:
            if not display.is_separable:
                return NonSeparable(display, shape, pixel_mm, aside, pixels)
            if pixels is not None or not tables:
                return RayByRay(display, shape, pixel_mm, aside, pixels)
            if shares_directions(display):
                return SharedDirections(display, shape, pixel_mm, aside)
            return NonIntegerPitch(display, shape, pixel_mm, aside)

        return averaged(display, int(samples), through)

    return for_mask(mask, display, first_hits, dense_in_full=tables)


def ray_by_ray(display: Display, shape: PictureShape, pixel_mm: float) -> SourceGenerator:
    """The same first hits without tables: what those are held against, on separable displays."""
    from inim.generators.raycast.ray_by_ray import RayByRay

    return RayByRay(display, shape, pixel_mm)
