# Kernels have no types of their own.
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
"""`gu2020`: reverse search along each ray in equal steps of depth, "one search one".

The method of Gu et al. (2020) as described by Wang et al., Heritage Science 2024, doi
10.1186/s40494-024-01462-4. A panel pixel's ray is sampled from z_max down to z_min in steps of one
scene pixel at the central depth plane, P_I = |D| P_D / g (Eq. 3). The first sample at which the
picture's surface is at least as near as the ray, depth >= z, gives the source.

docs/theory/paper.md describes what a fixed step misses, and the choices that the description leaves
open. Uncovered pixels have no surface.
"""

import math
from dataclasses import dataclass

import numpy as np

from inim.display import Display
from inim.display.pixels import PixelOffset, exact_ratio
from inim.generators.base import HOLE, PanelRays, SourceFinder, Sources, each_ray
from inim.generators.options import option, positive_mm
from inim.generators.raycast.cells import search_rays
from inim.generators.registry import algorithm
from inim.image.rgbd import RGBD
from inim.system.errors import UsageError

# Ten thousand times finer than the default on usual displays: more is a slip of the keyboard.
_MOST_STEPS = 1_000_000


@dataclass(frozen=True)
class Gu2020Options:
    """Options of `gu2020`."""

    step_mm: float | None = option(
        None, "depth between two samples of a ray, in mm; by default P_I", positive_mm
    )


@algorithm(Gu2020Options, samples="1", color="#009e73", marker="^")
def prepare(rays: PanelRays, options: Gu2020Options) -> SourceFinder:
    """Reverse search: each ray in steps, from near to far (Gu et al. 2020)."""
    step_mm = options.step_mm
    if step_mm is None:
        focused = math.isinf(rays.display.scene_pixel_mm)
        step_mm = rays.pixel_mm if focused else rays.display.scene_pixel_mm
    depths = _sampled_depths(rays.display, step_mm)

    def find(rgbd: RGBD, pixel_offset: PixelOffset) -> Sources:
        # An uncovered cell is a column without height: it never reaches a ray.
        depth = np.where(rgbd.covered, rgbd.depth_mm.astype(np.float64), -np.inf)
        return search_rays(_search, rays, pixel_offset, depth.ravel(), *rays.shape, depths)

    return each_ray(rays, find)


def _sampled_depths(display: Display, step_mm: float) -> np.ndarray:
    """Depths from z_max down to z_min, in exact steps, each rounded once."""
    (low, high), step = display.exact_depth_range, display.exact_mm(step_mm)
    steps = math.ceil(exact_ratio((high - low) / step))
    if steps > _MOST_STEPS:
        raise UsageError(
            f"step_mm = {step_mm:g}: {steps} steps over the depth range of {float(high - low):g} "
            f"mm; at most {_MOST_STEPS} make sense"
        )
    # Whole numbers of a common part: their quotient is rounded once, as a fraction's is, and soon.
    parts = math.lcm(high.denominator, step.denominator)
    top, down = int(high * parts), int(step * parts)
    return np.array([*((top - k * down) / parts for k in range(steps)), display.traced_range_mm[0]])


def _search(begin, end, u0, du, v0, dv, selected, depth, rows, columns, depths, sources):
    """Search the rays of panel pixels; u and v are columns and rows of the picture."""
    width = u0.shape[1]
    for i in range(begin, end):
        u, u_slope, v, v_slope, is_selected = u0[i], du[i], v0[i], dv[i], selected[i]
        for j in range(width):
            if is_selected[j]:
                sources[i * width + j] = _first_crossing(
                    depth, rows, columns, u[j], u_slope[j], v[j], v_slope[j], depths
                )


def _first_crossing(depth, rows, columns, u0, du, v0, dv, depths):
    """The pixel under the first sample that is not in front of the picture's surface."""
    for k in range(len(depths)):
        z = depths[k]
        u = math.floor(u0 + du * z)
        v = math.floor(v0 + dv * z)
        if 0 <= u < columns and 0 <= v < rows and depth[v * columns + u] >= z:
            return v * columns + u
    return HOLE
