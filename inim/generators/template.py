"""`template`: the exact first hit of every panel pixel's ray in the picture's columns.

docs/theory/templates.md has the definition. Two implementations give the same sources, bit for bit,
on separable displays:

* if the picture has a whole number of pixels per lens pitch, strips of neighbouring lenses follow
  the same lists of cells over the picture's phases, without a gather (`raycast.strips`);
* otherwise, and for the few pixels of a sparse mask, each ray is followed separately
  (`raycast.ray_by_ray`).

The second also serves hexagonal, rotated and tilted arrays, in float64, exact except for ties.
"""

from dataclasses import dataclass, replace

from inim.display import Display
from inim.generators.base import PanelRays, PictureShape, SourceFinder, SourceGenerator
from inim.generators.options import choice
from inim.generators.registry import algorithm


@dataclass(frozen=True)
class TemplateOptions:
    """Options of `template`."""

    columns: str = choice(
        "surface", "columns as thick as the picture's surface, or without a back",
        "surface", "solid",
    )  # fmt: skip


@algorithm(
    TemplateOptions, exact=True, portable=True, samples="auto", colour="smooth", fill="auto",
    color="#0072b2", marker="o",
)  # fmt: skip
def prepare(rays: PanelRays, options: TemplateOptions) -> SourceFinder:
    """Exact first hits in the columns of one picture; the recommended algorithm."""
    from inim.generators.raycast.columns import SEEN, SURFACE
    from inim.generators.raycast.strips import first_hits

    hides = rays.leave_holes and options.columns == SURFACE
    return first_hits("template", rays, SEEN if hides else options.columns)


def ray_by_ray(display: Display, shape: PictureShape, pixel_mm: float) -> SourceGenerator:
    """Exact first hits without tables, to check the tables on separable displays."""
    from inim.generators.raycast.columns import SURFACE
    from inim.generators.raycast.ray_by_ray import RayByRay
    from inim.generators.registry import parse_algorithm
    from inim.generators.steps import RayGenerator

    nearest = parse_algorithm("template:samples=centre:colour=nearest")
    single = replace(nearest, prepare=lambda rays, _: RayByRay(rays, SURFACE).take)
    return RayGenerator(single, display, shape, pixel_mm)
